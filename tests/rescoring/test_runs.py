"""A protocol update from draft to apply to rollback, on both databases."""

import json
import re
import threading
from collections.abc import Callable
from datetime import timedelta
from io import StringIO
from typing import Any

import pytest
from rich.console import Console
from sqlalchemy import delete, func, select, update

from exceptiondrive.cli.tables import notices_view
from exceptiondrive_records.audit.log import audit_page, verify_audit
from exceptiondrive_records.boards.boards import board_at, find_board
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.participation.forgetting import forget_team
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring import changes, fan_out
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.views import board_history, preview_of, public_run
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import parse_protocol

Stage = Any
Ready = tuple[Stage, str]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")
REDUCE_THE_LOAD = "Give the workers more time, or reduce the load; then resume the run."
MORE_MEMORY = "Give the workers more memory; then resume the run."
WIDER = ("footprint_width_m = 1.85", "footprint_width_m = 1.95")


def entries_of(stage: Stage) -> list[str]:
    """The submissions on the board that readers see."""
    rows = json.loads(stage.board())["entries"]
    return [row["submission_id"] for row in rows if row["submission_id"]]


def sheets(stage: Stage) -> int:
    with stage.database.read() as session:
        return session.scalar(select(func.count()).select_from(ScoreSheetRow)) or 0


def fanned_out(stage: Stage, make_protocol: Callable[..., str]) -> str:
    """Begin a run of a new d_safe, of which no sheet is made yet; return its id."""
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id: str = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    tend_runs(stage.reconciler, 4)
    return run_id


def begun(stage: Stage, make_protocol: Callable[..., str]) -> str:
    """Begin a run of a new d_safe, of which one sheet is made; return its id."""
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id: str = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    stage.work(most=1)
    return run_id


def test_a_draft_scores_in_the_background_while_the_board_keeps_every_byte(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    before = stage.board()
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    assert stage.board() == before
    view = stage.view(run_id)
    assert (view.progress.done, view.progress.total, view.progress.failed) == (3, 3, 0)
    assert view.blockers == ()
    assert sheets(stage) == 6


def test_apply_shows_the_previewed_board_and_rollback_the_exact_earlier_bytes(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    before = stage.board()
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    comparison = stage.preview(run_id).comparison
    stage.apply(run_id)
    after = json.loads(stage.board())
    assert (after["board"], after["protocol"]["version"]) == (comparison.new_board, "1.1")
    with stage.database.read() as session:
        unfrozen_at = session.get_one(Phase, "dev").unfrozen_at
    assert unfrozen_at is None, "an update of a board that moves reveals nothing"
    stage.rollback(run_id)
    assert stage.board() == before
    assert stage.view(run_id).state.value == "rolled_back"


def test_a_second_run_to_the_same_protocol_makes_no_job(ready: Ready) -> None:
    stage, run_id = ready
    stage.step("cancel", run_id)
    again = stage.draft(protocol="1.1")
    stage.step("start", again)
    assert stage.work() == 0
    assert stage.view(again).state.value == "ready"


def test_an_unchanged_protocol_reproduces_every_number_and_tells_nobody(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1"))
    assert stage.view(run_id).difference.stage.value == "none"
    stage.apply(run_id)
    with stage.database.read() as session:
        comparison = public_run(session, run_id).comparison
        assert {entry.change for entry in comparison.entries} == {"none"}
        assert list_notifications(session, find_team(session, "alpha").id) == []


def test_nothing_can_be_drafted_that_changes_nothing_or_gives_no_reason(stage: Stage) -> None:
    with pytest.raises(InvalidRecord, match="already"):
        stage.draft(protocol="1.0")
    with pytest.raises(InvalidRecord, match="reason"), stage.database.write() as session:
        changes.create_run(session, "dev", protocol="1.0", reason=" ", actor="me")


@pytest.mark.parametrize("state", [WorkState.FAILED, WorkState.QUEUED])
def test_apply_is_refused_while_a_sheet_is_failed_or_missing(
    stage: Stage, make_protocol: Callable[..., str], state: WorkState
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    stage.work(most=2)
    if state is WorkState.FAILED:
        with stage.database.write() as session:
            session.execute(update(Job).where(Job.state == WorkState.QUEUED).values(state=state))
    (blocker,) = stage.view(run_id).blockers
    assert "1 sheet" in blocker
    with pytest.raises(Conflict, match="1 sheet"):
        stage.apply(run_id, "sha256:any")
    stage.step("resume", run_id)  # tries the failed one again
    stage.work()
    stage.apply(run_id)


def test_every_sheet_that_could_not_be_made_is_told_with_its_reason_and_five_by_name(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    for number in range(3):
        stage.submit(3.0 + number / 4, f"more {number}")
    stage.work()
    run_id = fanned_out(stage, make_protocol)
    failed = []
    for code in ("time_limit", *["out_of_memory"] * 5):
        with stage.context.database.write() as session:
            claim = jobs.claim_job(session, Lane.RESCORE, 120, 4)
            assert claim is not None
            jobs.finish_failed(session, claim, code, "We failed.", retry=False)
        failed.append(claim.submission_id)
    slow = failed[0]
    others = ", ".join(one for one in stage.submitted if one != slow)
    assert set(stage.view(run_id).blockers) == {
        f"1 sheet could not be made (time_limit): of {slow}. {REDUCE_THE_LOAD}",
        f"5 sheets could not be made (out_of_memory): of {others}. {MORE_MEMORY}",
    }


def test_a_failed_sheet_that_is_tried_again_waits_like_any_other(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = fanned_out(stage, make_protocol)
    with stage.context.database.write() as session:
        claim = jobs.claim_job(session, Lane.RESCORE, 120, 4)
        assert claim is not None
        jobs.finish_failed(session, claim, "time_limit", "We failed.", retry=False)
    stage.step("resume", run_id)
    with stage.database.read() as session:
        again = session.get_one(Job, claim.id)
    assert (again.state, again.attempts, again.note) == (WorkState.QUEUED, 0, None)
    assert again.fence > claim.fence


def test_a_preview_is_stale_once_a_submission_has_come(ready: Ready) -> None:
    stage, run_id = ready
    seen = stage.preview(run_id).digest
    stage.submit(3.0, "newcomer")
    stage.work(2)
    assert stage.preview(run_id).is_stale, "a board with the newcomer is to be built"
    stage.work()
    with stage.database.read() as session:
        asked = [preview_of(session, run_id, digest).is_stale for digest in (None, seen)]
    assert asked == [False, True]
    with pytest.raises(Conflict, match="stale"):
        stage.apply(run_id, seen)
    stage.apply(run_id)
    assert len(entries_of(stage)) == 4


def test_what_an_applied_run_compared_names_no_team_that_was_forgotten(ready: Ready) -> None:
    stage, run_id = ready
    stage.apply(run_id)
    with stage.database.write() as session:
        alias = forget_team(session, "alpha", reason="asked for", actor="test").name
    with stage.database.read() as session:
        told = public_run(session, run_id).comparison
        kept = find_run(session, run_id).comparison
    assert [entry.team for entry in told.entries] == [alias, alias, "Beta"]
    assert kept is not None
    assert kept.entries[0].team == "Alpha", "as docs/privacy.md says of what was recorded"
    stage.work()
    stage.rollback(run_id)
    with stage.database.read() as session:
        assert "Alpha" not in public_run(session, run_id).model_dump_json()
    assert "Alpha" not in stage.preview(run_id).model_dump_json()


def test_submissions_during_and_after_apply_are_scored_under_both(ready: Ready) -> None:
    stage, run_id = ready
    during = stage.submit(3.0, "during")
    stage.work()
    stage.apply(run_id)
    after = stage.submit(3.5, "after")
    stage.work()
    with stage.database.read() as session:
        for submission_id in (during, after):
            query = select(ScoreSheetRow).where(ScoreSheetRow.submission_id == submission_id)
            assert len(session.scalars(query).all()) == 2
    stage.rollback(run_id)
    board = json.loads(stage.board())
    assert board["protocol"]["version"] == "1.0"
    assert {entry["method"] for entry in board["entries"]} >= {"during", "after"}


def test_a_submission_that_waits_during_the_flip_is_scored_once_under_each(ready: Ready) -> None:
    stage, run_id = ready
    waiting = stage.submit(3.0, "waiting")
    stage.apply(run_id)
    stage.work()
    with stage.database.read() as session:
        assert session.get_one(Submission, waiting).status.value == "scored"
        shown = session.get_one(Phase, "dev").protocol_digest
        jobs = session.scalars(select(Job).where(Job.submission_id == waiting)).all()
    first, second = sorted(jobs, key=lambda job: job.is_first, reverse=True)
    assert (first.is_first, first.lane, first.protocol_digest) == (True, Lane.LIVE, shown)
    assert (second.is_first, second.lane) == (False, Lane.RESCORE), "it waits behind live work"
    assert "waiting" in {entry["method"] for entry in json.loads(stage.board())["entries"]}


def test_a_closed_run_scores_only_the_new_protocol_and_cannot_go_back(ready: Ready) -> None:
    stage, run_id = ready
    stage.apply(run_id)
    stage.step("close", run_id)
    before = sheets(stage)
    stage.submit(3.0, "later")
    stage.work()
    assert sheets(stage) == before + 1
    with pytest.raises(Conflict, match="closed"):
        stage.rollback(run_id)


def test_a_paused_run_scores_nothing_until_it_is_resumed(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = begun(stage, make_protocol)
    stage.step("pause", run_id)
    assert stage.work() == 0
    assert stage.view(run_id).progress.done == 1
    stage.step("resume", run_id)
    assert stage.work() == 2


def test_what_is_given_back_while_a_run_is_paused_waits_until_it_is_resumed(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = fanned_out(stage, make_protocol)
    with stage.context.database.write() as session:
        claim = jobs.claim_job(session, Lane.RESCORE, 120, 4)
    assert claim is not None
    stage.step("pause", run_id)
    with stage.context.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=True, backoff_s=0)
    assert stage.work() == 0
    stage.step("resume", run_id)
    assert stage.work() == 3


def test_a_run_never_floods_the_queue(
    stage: Stage, make_protocol: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fan_out, "BATCH", 2)
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    stage.step("start", stage.draft(protocol="1.1"))
    made = [tend_runs(stage.reconciler, 4) for _ in range(3)]
    assert made == [2, 0, 0], "no more until one of them is done"
    monkeypatch.setattr(fan_out, "BATCH", 1)
    assert tend_runs(stage.reconciler, 4) == 0, "more wait than it lets wait"
    monkeypatch.setattr(fan_out, "BATCH", 2)
    stage.work(most=1)
    assert tend_runs(stage.reconciler, 4) == 1


@pytest.mark.parametrize(
    ("resumed_s_ago", "made_s_ago", "is_counted"),
    [(100, 2, True), (100, 50, False), (10, 20, False)],
    ids=["of the last half minute", "older", "before scoring went on"],
)
def test_the_rate_of_a_run_is_that_of_the_last_half_minute_since_scoring_went_on(
    stage: Stage,
    make_protocol: Callable[..., str],
    resumed_s_ago: float,
    made_s_ago: float,
    is_counted: bool,
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    with stage.owner.write() as session:
        now, run = database_now(session), find_run(session, run_id)
        run.resumed_at = now - timedelta(seconds=resumed_s_ago)
        session.add(
            ScoreSheetRow(
                submission_id=stage.submitted[0],
                protocol_digest=run.to_protocol_digest,
                split_revision=run.to_split_revision,
                sheet=session.scalars(select(ScoreSheetRow.sheet).limit(1)).one(),
                exact_digest="sha256:exact",
                measurement_key="m",
                scorer_version="1",
                created_at=now - timedelta(seconds=made_s_ago),
            )
        )
    progress = stage.view(run_id).progress
    assert progress.done == 1
    assert (progress.sheets_per_s is not None, progress.remaining_s is not None) == (
        (is_counted, is_counted)
    )


def test_no_remaining_time_is_told_once_every_sheet_is_begun(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    """The last may wait for the lease of a worker that is lost, however fast the others came."""
    run_id = begun(stage, make_protocol)
    assert stage.view(run_id).progress.remaining_s is not None
    with stage.owner.write() as session:
        waiting = update(Job).where(Job.state == WorkState.QUEUED)
        until = database_now(session) + timedelta(minutes=2)
        session.execute(waiting.values(state=WorkState.LEASED, lease_until=until))
    progress = stage.view(run_id).progress
    assert (progress.done, progress.sheets_per_s is None) == (1, False)
    assert progress.remaining_s is None


def test_a_run_resumes_after_any_crash_without_losing_or_doubling_a_sheet(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.add_protocol(make_protocol("1.1", *WIDER))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    stage.work(most=1)
    with stage.database.write() as session:  # jobs that were made are lost, as from a backup
        session.execute(delete(Job).where(Job.state == WorkState.QUEUED))
    stage.work()
    assert stage.view(run_id).state.value == "ready"
    assert sheets(stage) == 6


def test_a_cancelled_run_leaves_the_board_and_no_waiting_job(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    before = stage.board()
    run_id = begun(stage, make_protocol)
    stage.step("cancel", run_id)
    assert stage.work() == 0
    assert stage.board() == before


def test_what_is_scored_later_is_none_of_the_work_of_a_run_that_ended(ready: Ready) -> None:
    stage, run_id = ready
    stage.step("cancel", run_id)
    stage.submit(3.0, "later")
    stage.work()
    progress = stage.view(run_id).progress
    assert (progress.done, progress.total) == (3, 3)


def test_what_is_withdrawn_later_changes_no_count_of_a_run_that_ended(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    rolled_back = stage.ready(make_protocol("1.1", *D_SAFE))
    stage.apply(rolled_back)
    stage.rollback(rolled_back)
    stage.add_protocol(make_protocol("1.2", *WIDER))
    cancelled = stage.draft(protocol="1.2")
    stage.step("start", cancelled)
    stage.work(most=1)
    stage.step("cancel", cancelled)
    before = [stage.view(run_id).progress for run_id in (rolled_back, cancelled)]
    assert [(one.done, one.total, one.failed) for one in before] == [(3, 3, 0), (1, 3, 0)]
    with stage.database.write() as session:
        withdraw(session, stage.submitted[0], actor="test")
    assert [stage.view(run_id).progress for run_id in (rolled_back, cancelled)] == before


def test_one_run_of_a_phase_is_open_at_a_time(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.ready(make_protocol("1.1", *D_SAFE))
    stage.add_protocol(make_protocol("1.2", *WIDER))
    with pytest.raises(Conflict, match="open run"):
        stage.draft(protocol="1.2")


def test_a_withdrawn_submission_blocks_nothing(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    stage.work(most=2)
    with stage.database.write() as session:
        withdraw(session, stage.submitted[2], actor="test")
    stage.work()
    stage.apply(run_id)
    assert len(entries_of(stage)) == 2


def test_a_split_revision_goes_the_same_way(stage: Stage, make_split: Callable[..., Any]) -> None:
    before = stage.board()
    old_split = make_split()
    new_revision = stage.put_split(make_split(7.0))
    stage.put_split(old_split, "split-old.json")
    run_id = stage.draft(split_revision=new_revision)
    assert stage.view(run_id).difference.stage.value == "measure"
    stage.step("start", run_id)
    stage.work()
    assert stage.view(run_id).state.value == "ready"
    assert stage.board() == before, "nobody sees it before it is applied"
    stage.apply(run_id)
    assert json.loads(stage.board())["split"]["revision"] == new_revision
    stage.rollback(run_id)
    assert stage.board() == before


def test_every_board_that_was_public_keeps_its_address_and_drafts_have_none(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    first = stage.board()
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    draft = stage.preview(run_id).comparison.new_board
    with stage.database.read() as session, pytest.raises(NotFound):
        find_board(session, "dev", draft)
    with stage.database.read() as session:
        moment = database_now(session)
    stage.apply(run_id)
    with stage.database.read() as session:
        assert find_board(session, "dev", json.loads(first)["board"]).body == first
        shown_then = board_at(session, "dev", moment)
        assert shown_then is not None
        assert shown_then.body == first
        newest = board_history(session, "dev")[0]
    assert newest.board == draft
    assert newest.comparison == f"/api/v1/rescoring/{run_id}"
    assert newest.what_changed == (
        parse_protocol(make_protocol("1.1", *D_SAFE)).changes,
        "required clearance of task SE1 (occluded pedestrian) 2.0 -> 4.5 m",
    )


def test_readers_see_wholly_the_old_or_wholly_the_new_board_during_the_flip(ready: Ready) -> None:
    stage, run_id = ready
    old, seen, stop = stage.board(), set(), threading.Event()

    def read() -> None:
        while not stop.is_set():
            seen.add(stage.board())

    readers = [threading.Thread(target=read) for _ in range(4)]
    for reader in readers:
        reader.start()
    stage.apply(run_id)
    new = stage.board()
    for _ in range(20):
        seen.add(stage.board())
    stop.set()
    for reader in readers:
        reader.join()
    assert seen <= {old, new}
    assert new in seen


def test_every_step_is_in_the_audit_log_with_actor_and_reason(ready: Ready) -> None:
    stage, run_id = ready
    stage.apply(run_id)
    stage.rollback(run_id)
    with stage.database.read() as session:
        lines = [line for line in audit_page(session, limit=500) if line.subject == run_id]
        assert verify_audit(session).is_whole
    by_organizer = {line.action for line in lines if line.actor == "organizer"}
    assert by_organizer == {
        "rescoring drafted",
        "rescoring started",
        "rescoring applied",
        "rescoring rolled back",
    }
    assert all(line.detail["reason"] for line in lines if line.actor == "organizer")


def test_a_team_is_told_when_only_its_rank_range_moves(
    even_stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = even_stage.ready(make_protocol("1.1", *D_SAFE))
    even_stage.apply(run_id)
    with even_stage.database.read() as session:
        (told,) = list_notifications(session, find_team(session, "beta").id)
    (entry,) = told.entries
    assert entry.old is not None
    assert entry.new is not None
    assert entry.old.metrics == entry.new.metrics
    assert entry.old.rank_interval != entry.new.rank_interval


def test_only_teams_whose_published_numbers_change_are_told_old_and_new(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 3.0"))
    comparison = stage.preview(run_id).comparison
    changed = {(entry.team, entry.change) for entry in comparison.entries}
    assert changed == {("Alpha", "numbers"), ("Beta", "none")}
    stage.apply(run_id)
    with stage.database.read() as session:
        (told,) = list_notifications(session, find_team(session, "alpha").id)
        assert list_notifications(session, find_team(session, "beta").id) == []
    for entry in told.entries:
        assert entry.old is not None
        assert entry.new is not None
        assert entry.old.metrics != entry.new.metrics
    page = Console(width=200, record=True, file=StringIO())
    page.print(*notices_view([told]))
    assert re.search(
        r"slow: rank 1.*, HCC [\d.]+ %.* -> rank 1.*, HCC [\d.]+ %", page.export_text()
    )


def test_while_a_phase_is_hidden_no_team_is_told_of_an_update(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 3.0"))
    for step, visibility, n_told in (
        (stage.apply, "hidden", 0),
        (stage.rollback, "shown", 1),
    ):
        with stage.owner.write() as session:
            session.get_one(Phase, "dev").visibility = visibility
        step(run_id)
        with stage.database.read() as session:
            assert len(list_notifications(session, find_team(session, "alpha").id)) == n_told
