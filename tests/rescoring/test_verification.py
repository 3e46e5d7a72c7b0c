"""Sheets are recomputed from the uploads, and every bit must come again."""

from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session
from tests.rescoring.application import Organizer, Serve

from exceptiondrive_records.boards.boards import current_board, entry_ids
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.rescoring.changes import start_verification
from exceptiondrive_records.rescoring.verification import (
    finish_recheck,
    rechecks_of,
    verification_view,
)
from exceptiondrive_records.submissions.tables import SimilarityRow
from exceptiondrive_records.work.dispatch import kinds_due
from exceptiondrive_records.work.lease import claim_oldest
from exceptiondrive_records.work.tables import Recheck
from exceptiondrive_schemas.api.rescoring import RunAction, RunKind, VerificationView, VerifyState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_scoring import SCORER_VERSION, challenge
from exceptiondrive_worker import stages
from exceptiondrive_worker.splits.admin import publish_split_file
from exceptiondrive_worker.splits.private_store import Shelf

Stage = Any


def verified(stage: Stage, sample: int | None = None, *, spoil: bool = False) -> VerificationView:
    with stage.database.write() as session:
        started = start_verification(
            session, "dev", sample=sample, reason="to be sure", actor="organizer"
        )
    if spoil:
        with stage.owner.write() as session:
            item = session.scalars(select(Recheck).limit(1)).one()
            item.expected_digest = "sha256:" + "0" * 64
    stage.verify_all()
    with stage.database.read() as session:
        return verification_view(session, started.id)


def test_every_sheet_comes_again_bit_for_bit(stage: Stage) -> None:
    found = verified(stage)
    assert (found.n_sheets, found.n_equal, found.problems) == (3, 3, ())
    assert found.finished_at is not None


def test_a_sample_recomputes_only_so_many(stage: Stage) -> None:
    assert verified(stage, 2).n_sheets == 2


@pytest.mark.row("I30")
def test_a_sheet_that_differs_is_named(stage: Stage) -> None:
    found = verified(stage, spoil=True)
    assert (found.n_equal, found.n_different) == (2, 1)
    assert found.problems[0].found_digest != found.problems[0].expected_digest


def test_a_sheet_of_another_scorer_says_so_and_a_run_to_the_next_version_makes_it_anew(
    stage: Stage, make_protocol: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(challenge, "SCORER_VERSION", "99")
    monkeypatch.setattr(stages, "SCORER_VERSION", "99")
    found = verified(stage)
    said = f"made by scorer {SCORER_VERSION}, recomputed by 99: the published numbers agree"
    assert {one.note for one in found.problems} == {said}
    assert found.n_different == 3
    stage.apply(stage.ready(make_protocol("1.1")))  # the same numbers under the next version
    assert verified(stage).n_equal == 3


@pytest.mark.publishes_regions
def test_of_a_split_that_became_public_sheets_of_another_scorer_agree_as_they_were_published(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sheets of a public split tell more, such as the clearance curve."""
    context = stage.context
    publish_split_file(
        context.database,
        context.files,
        context.splits,
        "tiny",
        packaged_protocol(),
        while_open=True,
    )
    stage.submit(3.0, "later")
    stage.work()
    monkeypatch.setattr(challenge, "SCORER_VERSION", "99")
    found = verified(stage)
    assert [one.note is not None and one.note[-5:] for one in found.problems] == ["agree"] * 4


def test_what_a_verification_came_to_is_shown_later_too(
    stage: Stage, serve: Serve, tmp_path: Path
) -> None:
    """Who is interrupted while it goes on asks for its status."""
    organizer, found = Organizer(*serve(stage), tmp_path), verified(stage, spoil=True)
    said = organizer.say("rescore", "status", found.id)
    assert said.startswith("3 of 3 sheets recomputed: 2 equal bit for bit, 1 DIFFER\n")
    assert f"  {found.problems[0].submission_id}  differs" in said
    assert organizer.rescore("status", found.id)["verification"]["n_equal"] == 2


def test_the_private_store_is_not_looked_at(stage: Stage) -> None:
    kept = sorted((stage.settings.private_dir / "settled").iterdir())
    assert len(kept) == 4, "three submissions and FREEZE"
    settled = [file.read_bytes() for file in kept]
    for file, that_of_another in zip(kept, [*settled[1:], settled[0]], strict=True):
        file.write_bytes(that_of_another)  # whole and readable, and wrong
    assert verified(stage).n_equal == 3


def test_an_upload_that_is_gone_is_a_failure_and_no_agreement(stage: Stage) -> None:
    for path in (stage.settings.private_dir.parent / "uploads").glob("*/*"):
        path.unlink()
    found = verified(stage)
    assert (found.n_equal, found.n_failed) == (0, 3)


def test_while_the_store_is_away_a_verification_waits(stage: Stage) -> None:
    uploads = stage.settings.private_dir.parent / "uploads"
    away = uploads.rename(uploads.with_name("elsewhere"))
    found = verified(stage)
    assert (found.n_sheets, found.n_equal, found.n_failed) == (3, 0, 0)
    away.rename(uploads)
    with stage.owner.write() as session:
        session.execute(update(Recheck).values(available_at=database_now(session)))
    stage.verify_all()
    with stage.database.read() as session:
        assert verification_view(session, found.id).n_equal == 3


def test_a_file_accepted_under_older_bounds_verifies_under_tighter_ones(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.submit(20.0, "rushing")
    stage.work()
    run_id = stage.ready(make_protocol("1.1", "max_step_m = 30.0", "max_step_m = 5.0"))
    stage.apply(run_id)
    assert verified(stage).n_equal == 4


def test_a_board_of_files_accepted_under_older_bounds_is_built_where_nothing_of_them_is_kept(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    rushing = stage.submit(20.0, "rushing")
    stage.work()
    run_id = stage.ready(make_protocol("1.1", "max_step_m = 30.0", "max_step_m = 5.0"))
    stage.apply(run_id)
    for shelf in Shelf:  # as for a worker on another machine
        for file in (stage.settings.private_dir / shelf).iterdir():
            file.unlink()
    with stage.owner.write() as session:
        session.execute(delete(SimilarityRow))
    fresh = stage.submit(2.5, "fresh")
    stage.work()
    with stage.database.read() as session:
        row = current_board(session, "dev")
        assert row is not None
        assert {rushing, fresh} <= entry_ids(session, row.id)
        compared = set(session.scalars(select(SimilarityRow.submission_id)))
    assert {rushing, fresh} <= compared
    assert len(list((stage.settings.private_dir / Shelf.FINGERPRINTS).iterdir())) == 5


def test_a_verification_is_a_run_that_can_only_be_cancelled(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    with stage.database.write() as session:
        run_id = start_verification(
            session, "dev", sample=None, reason="to be sure", actor="organizer"
        ).id
    assert stage.view(run_id).kind is RunKind.VERIFICATION
    assert stage.view(run_id).actions == (RunAction.CANCEL,)
    for step in ("start", "pause", "resume", "close"):
        with pytest.raises(Conflict, match="verifies sheets"):
            stage.step(step, run_id)
    with pytest.raises(Conflict, match="verifies sheets"):
        stage.apply(run_id, "x")
    with pytest.raises(Conflict, match="verifies sheets"):
        stage.rollback(run_id)
    stage.submit(2.5, "late")
    stage.ready(make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 4.5"))  # both go their way
    with stage.owner.write() as session:  # one has been tried, and given back
        session.execute(
            update(Recheck).where(Recheck.submission_id == stage.submitted[0]).values(note="x")
        )
    stage.step("cancel", run_id)
    stage.verify_all()
    with stage.database.read() as session:
        found = verification_view(session, run_id)
        told = rechecks_of(session, stage.submitted[0])
    assert (found.n_sheets, found.n_equal, found.n_failed) == (3, 0, 0)
    assert (found.problems, told) == ((), ()), (
        "what was cancelled came to nothing, not to a failure"
    )
    assert found.finished_at is not None


def end_lease(session: Session) -> None:
    """End the lease of the only sheet that is verified, a moment ago by the database's clock."""
    one = session.scalars(select(Recheck)).one()
    one.lease_until = database_now(session) - timedelta(seconds=1)


@pytest.mark.parametrize("max_attempts", [2, 6])
def test_a_sheet_that_no_attempt_answers_is_named(stage: Stage, max_attempts: int) -> None:
    few = stage.settings.model_copy(update={"max_attempts": max_attempts})
    stage.settings, stage.context = few, replace(stage.context, settings=few)
    with stage.database.write() as session:
        run_id = start_verification(
            session, "dev", sample=1, reason="to be sure", actor="organizer"
        ).id
    for _ in range(max_attempts):
        with stage.database.read() as session:
            assert kinds_due(session, Lane.RESCORE, max_attempts) == {Recheck}
        with stage.context.database.write() as session:
            assert claim_oldest(session, Recheck, 30, max_attempts) is not None
        with stage.owner.write() as session:
            end_lease(session)
    stage.verify_all()
    with stage.database.read() as session:
        found = verification_view(session, run_id)
    assert (found.n_failed, found.finished_at is not None) == (1, True)
    assert found.problems[0].note == "recomputing did not finish in any of its attempts"


def test_who_lost_the_lease_records_nothing(stage: Stage) -> None:
    with stage.database.write() as session:
        start_verification(session, "dev", sample=1, reason="to be sure", actor="organizer")
    with stage.context.database.write() as session:
        late = claim_oldest(session, Recheck, 30, 4)
    assert late is not None
    with stage.owner.write() as session:
        end_lease(session)
    with stage.context.database.write() as session:
        assert claim_oldest(session, Recheck, 30, 4) is not None
        assert not finish_recheck(session, late, VerifyState.EQUAL, late.expected_digest)
