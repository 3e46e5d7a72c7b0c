"""What others do at the moment of a flip or a step: it is as if they had come before it, or after it."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import pytest
from sqlalchemy import event, func, select, update
from tests.records.test_at_once import interrupted
from tests.support.databases import POSTGRES_ALONE, wait_until_it_waits
from tests.support.work import unfinished

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.notifications.tables import Notification
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.participation.forgetting import forget_team
from exceptiondrive_records.phases.scoring_keys import is_of_key, new_key
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus

Stage = Any
Ready = tuple[Stage, str]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


def whole(stage: Stage) -> bool:
    with stage.database.read() as session:
        return violations(session) == unfinished(session) == []


@POSTGRES_ALONE
@pytest.mark.parametrize(("flips", "n_sheets"), [("apply", 2), ("rollback", 1)])
def test_an_upload_that_waits_for_its_team_during_a_flip_is_scored_as_after_it_and_shown(
    ready: Ready, flips: str, n_sheets: int
) -> None:
    stage, run_id = ready
    with stage.database.write() as session:
        gamma = create_team(session, "gamma", "Gamma", actor="test").id
    if flips == "rollback":
        stage.apply(run_id)
    with ThreadPoolExecutor() as pool:
        with stage.database.write() as other:
            hold_team(other, gamma)
            upload = pool.submit(stage.submit, 3.0, "newcomer", "gamma")
            wait_until_it_waits(stage.database, upload.done)
            getattr(stage, flips)(run_id)
        newcomer = upload.result()
    stage.work()
    assert newcomer in stage.board()
    with stage.database.read() as session:
        sheets = select(func.count()).where(ScoreSheetRow.submission_id == newcomer)
        assert session.scalar(sheets) == n_sheets
    assert whole(stage)


@POSTGRES_ALONE
@pytest.mark.parametrize("moment", ["FOR KEY SHARE", "INSERT INTO notifications"])
def test_a_team_that_is_forgotten_while_an_update_is_applied_is_told_under_no_old_name(
    ready: Ready, moment: str
) -> None:
    stage, run_id = ready
    with interrupted(
        stage.database,
        moment,
        lambda session: forget_team(session, "alpha", reason="They asked us to.", actor="test"),
    ):
        stage.apply(run_id)
    with stage.database.read() as session:
        told = session.scalars(select(Notification.body)).all()
    assert told
    assert not any("Alpha" in body for body in told)


@POSTGRES_ALONE
def test_what_is_withdrawn_while_an_update_is_applied_waits_for_it(ready: Ready) -> None:
    stage, run_id = ready
    preview = stage.preview(run_id).digest
    fresh = stage.submit(3.0, "fresh")
    with stage.owner.write() as session:  # the flip changes the earlier protocol's job first
        to = new_key(find_run(session, run_id))
        own = Job.submission_id == fresh
        session.execute(update(Job).where(own, is_of_key(Job, to)).values(id="a"))
        session.execute(update(Job).where(own, ~is_of_key(Job, to)).values(id="z"))

    def withdraw_it() -> None:
        with stage.database.write() as session:
            withdraw(session, fresh, actor="team")

    with ThreadPoolExecutor() as pool:
        withdrawals: list[Future[None]] = []

        def withdraw_after(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
            if statement.startswith("UPDATE work ") and not withdrawals:
                withdrawals.append(pool.submit(withdraw_it))
                wait_until_it_waits(stage.owner, withdrawals[0].done)

        event.listen(stage.database.engine, "after_cursor_execute", withdraw_after)
        stage.apply(run_id, preview)
        withdrawals[0].result()
    with stage.database.read() as session:
        assert find_submission(session, fresh).status is SubmissionStatus.WITHDRAWN
    stage.work()
    assert whole(stage)


@POSTGRES_ALONE
def test_an_upload_that_began_while_a_run_was_paused_holds_up_no_run_that_goes_on(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    stage.step("pause", run_id)
    resumed: list[str] = []

    def resume_before(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("INSERT INTO submissions") and not resumed:
            resumed.append(run_id)
            stage.step("resume", run_id)

    event.listen(stage.database.engine, "before_cursor_execute", resume_before)
    stage.submit(3.0, "newcomer")
    stage.work()
    assert resumed
    assert stage.view(run_id).state.value == "ready"
    assert whole(stage)


@POSTGRES_ALONE
@pytest.mark.parametrize("what", ["pause", "cancel"])
def test_a_step_of_a_run_takes_its_jobs_in_the_order_of_all_others(
    stage: Stage, make_protocol: Callable[..., str], what: str
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    stage.step("start", run_id)
    tend_runs(stage.reconciler, 4)
    waiting = select(Job.id).where(Job.state == WorkState.QUEUED)
    with stage.owner.write() as session:
        lie = session.scalars(waiting).all()
        assert len(lie) == 3
        session.execute(update(Job).where(Job.id == lie[-1]).values(id="0"))  # lies last now

    def take(session: Any, job_id: str) -> None:
        session.execute(select(Job.id).where(Job.id == job_id).with_for_update())

    with ThreadPoolExecutor() as pool:
        with stage.owner.write() as other:  # as a merge of teams takes them
            take(other, "0")
            step = pool.submit(stage.step, what, run_id)
            wait_until_it_waits(stage.owner, step.done)
            take(other, max(lie[:-1]))
        step.result()
