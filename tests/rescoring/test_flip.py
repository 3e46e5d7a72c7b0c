"""What the transaction of a flip does, and what it leaves to others."""

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import Mock

import pytest
from sqlalchemy import delete, func, select
from tests.support.work import claim_this
from tests.support.worker import build_board_of, due_jobs, score_submission

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.boards.tables import BoardFlip
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring import comparison, flip
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Job, WorkState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker import work

Stage = Any
Ready = tuple[Stage, str]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


def test_boards_are_compared_before_the_transaction_and_not_in_it(
    ready: Ready, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, run_id = ready
    preview = stage.preview(run_id).digest
    compare = Mock(wraps=comparison.compare_boards)
    monkeypatch.setattr(comparison, "compare_boards", compare)
    monkeypatch.setattr(comparison, "_COMPARED", Memory(4))
    made = []
    for step in (partial(stage.apply, run_id, preview), partial(stage.rollback, run_id)):
        flip.work_out(stage.database, run_id)
        made.append(compare.call_count)
        step()
        made.append(compare.call_count)
    assert made == [1, 1, 2, 2]


def test_what_was_worked_out_does_not_hide_what_came_since(ready: Ready) -> None:
    stage, run_id = ready
    preview = stage.preview(run_id).digest
    flip.work_out(stage.database, run_id)
    stage.submit(3.0, "newcomer")
    stage.work()
    with pytest.raises(Conflict, match="stale"):
        stage.apply(run_id, preview)


def test_the_board_of_a_draft_is_built_behind_the_live_ones(ready: Ready) -> None:
    stage, run_id = ready
    draft = stage.view(run_id).to_protocol.digest
    with stage.database.write() as session:
        shown = session.get_one(Phase, "dev").protocol_digest
        for digest in (shown, draft):
            want_board(session, "dev", digest)
    with stage.database.read() as session:
        wanted = select(BoardRequest).where(BoardRequest.state.in_(OPEN_STATES))
        lanes = {row.protocol_digest: row.lane for row in session.scalars(wanted)}
    assert lanes == {shown: Lane.LIVE, draft: Lane.RESCORE}


def test_a_board_that_is_shown_says_where_each_stood_on_the_one_before_it(ready: Ready) -> None:
    """Also where it was built before that one, as by one worker while another is late."""
    stage, run_id = ready
    stage.apply(run_id)
    stage.submit(3.0, "newcomer", "beta")
    for job_id in due_jobs(stage.database):
        score_submission(stage.context, job_id)
    tend_runs(stage.reconciler, 3)
    build_board_of(stage.context, "dev", stage.view(run_id).from_protocol.digest)
    assert stage.view(run_id).new_board == 3
    assert "newcomer" not in stage.board()
    stage.work()
    before = json.loads(stage.board())["entries"]
    stage.rollback(run_id)
    entries = json.loads(stage.board())["entries"]
    assert {each["method"]: each["previous_rank"] for each in entries} == {
        each["method"]: each["rank"] for each in before
    }


@pytest.mark.parametrize("flips", ["apply", "rollback"])
def test_a_flip_that_breaks_off_at_its_last_step_changes_nothing(
    ready: Ready, monkeypatch: pytest.MonkeyPatch, flips: str
) -> None:
    stage, run_id = ready
    if flips == "rollback":
        stage.apply(run_id)
    before = everything_shown(stage, run_id)

    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(flip, "notify_teams", killed)
    with pytest.raises(KeyboardInterrupt):
        getattr(stage, flips)(run_id)
    assert everything_shown(stage, run_id) == before


def everything_shown(stage: Stage, run_id: str) -> tuple[object, ...]:
    with stage.database.read() as session:
        phase = session.get_one(Phase, "dev")
        shown = (phase.protocol_digest, phase.split_revision, phase.current_board_id)
        verdict = verify_audit(session)
        n_flips = session.scalar(select(func.count()).select_from(BoardFlip))
    return (*shown, stage.board(), stage.view(run_id).state, verdict, n_flips)


def test_the_jobs_of_a_run_wait_in_the_lane_behind_the_live_one(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    fresh = stage.submit(3.0, "fresh")
    tend_runs(stage.database, 4)
    with stage.database.read() as session:
        waiting = list(session.scalars(select(Job).where(Job.state == WorkState.QUEUED)))
    lanes = {(job.submission_id, job.is_first): job.lane for job in waiting}
    assert lanes.pop((fresh, True)) is Lane.LIVE
    assert lanes == {(key, False): Lane.RESCORE for key in stage.submitted}


def test_the_background_waits_while_other_workers_have_live_work(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "_MOST_PATIENCE_S", 60.0)
    stage.submit(3.0, "fresh")
    work.let_live_work_pass(stage.context)  # serves the live lane itself: does not wait
    background = replace(stage.context, lanes=frozenset({Lane.RESCORE}))
    waiting = threading.Thread(target=work.let_live_work_pass, args=(background,))
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive()
    stage.work()
    waiting.join()


def test_a_lost_job_of_the_earlier_protocol_is_made_again_after_apply(ready: Ready) -> None:
    stage, run_id = ready
    stage.apply(run_id)
    after = stage.submit(3.5, "after")
    with stage.database.write() as session:  # as from a backup
        lost = delete(Job).where(Job.submission_id == after, Job.is_first.is_(False))
        session.execute(lost)
    stage.work()
    with stage.database.read() as session:
        kept = select(ScoreSheetRow).where(ScoreSheetRow.submission_id == after)
        assert len(session.scalars(kept).all()) == 2


def test_a_sheet_whose_job_is_gone_is_not_made_again(ready: Ready) -> None:
    stage, run_id = ready
    stage.step("cancel", run_id)
    with stage.database.write() as session:
        session.execute(delete(Job).where(Job.is_first.is_(False)))
    again = stage.draft(protocol="1.1")
    stage.step("start", again)
    assert stage.work() == 0
    assert stage.view(again).state.value == "ready"


def test_what_failed_before_an_update_stands_on_the_board_when_it_is_tried_again_after_it(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    failed = stage.submit(2.5, "Failing")
    claim = _claimed(stage, failed)
    with stage.context.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    stage.apply(run_id)
    stage.step("close", run_id)
    with stage.database.write() as session:
        retry_submission(session, failed, actor="test")
    stage.work()
    assert failed in stage.board()


def test_what_is_scored_while_an_update_is_applied_and_closed_stands_on_the_board(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    slow = stage.submit(2.5, "Slow")
    claim = _claimed(stage, slow)
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    stage.apply(run_id)
    stage.step("close", run_id)
    with stage.context.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=True, backoff_s=0)
    stage.work()
    assert slow in stage.board()


def test_what_is_scored_between_the_apply_and_the_close_stands_on_the_board(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    slow = stage.submit(2.5, "Slow")
    claim = _claimed(stage, slow)
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    stage.apply(run_id)
    with stage.owner.write() as session:
        session.get_one(Job, claim.id).state = WorkState.QUEUED
    score_submission(stage.context, claim.id)  # under the protocol that the phase has left
    stage.step("close", run_id)  # before the reconciler has come by
    stage.work()
    assert slow in stage.board()


def _claimed(stage: Stage, submission_id: str) -> Job:
    with stage.database.read() as session:
        job_id = session.scalars(select(Job.id).where(Job.submission_id == submission_id)).one()
    with stage.context.database.write() as session:
        claim = claim_this(session, job_id, 120, 4)
    assert claim is not None
    return claim
