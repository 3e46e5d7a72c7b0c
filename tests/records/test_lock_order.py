"""Whoever changes the same rows takes their locks in one order, or waits for none: no deadlock."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import select, text, update
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from tests.records.world import World
from tests.support.databases import POSTGRES_ALONE, wait_until_it_waits

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.participation.changes import merge_teams
from exceptiondrive_records.phases.phases import create_phase, lock_phase
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.edits import edit_submission
from exceptiondrive_records.submissions.similarity import keep_alike
from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team, find_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.board_requests import claim_board, want_board
from exceptiondrive_records.work.tables import BoardRequest, Job, WorkState
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import SubmissionChange


@pytest.mark.parametrize("action", ["withdrawal", "merge"])
def test_who_changes_a_submission_waits_for_the_scoring_run_that_ends(
    world: World, action: str
) -> None:
    accepted = world.submit("file")
    with world.database.write() as session:
        create_team(session, "beta", "Beta", actor="test")
    claim = world.claim(accepted.job_id)
    errors: list[OperationalError] = []

    def change_it() -> None:
        try:
            with world.database.write() as session:
                if action == "withdrawal":
                    withdraw(session, accepted.submission.id, actor="test")
                else:
                    merge_teams(session, "alpha", "beta", reason="one lab", actor="test")
        except OperationalError as error:
            errors.append(error)

    with world.database.write() as session:
        held = select(Job.id).where(Job.id == accepted.job_id).with_for_update()
        session.execute(held)  # as in the middle of `finish_scored`
        change = threading.Thread(target=change_it)
        change.start()
        wait_until_it_waits(world.database, lambda: not change.is_alive())
        finish = jobs.finish_scored(
            session,
            claim,
            world.sheet(),
            exact_digest="sha256:1",
            measurement_key="m",
            scorer_version="1",
        )
    change.join()

    assert errors == []
    assert finish
    ends = {"withdrawal": SubmissionStatus.WITHDRAWN, "merge": SubmissionStatus.SCORED}
    with world.database.read() as session:
        assert session.get_one(Job, accepted.job_id).state is WorkState.DONE
        assert session.get_one(Submission, accepted.submission.id).status is ends[action]


def test_a_change_of_the_phase_waits_for_no_board_that_waits_for_it(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None
    errors: list[OperationalError] = []

    def publish_it() -> None:
        try:
            with world.database.write() as session:
                publish_board(session, claim, world.board())
        except OperationalError as error:
            errors.append(error)

    with world.database.write() as session:
        phase = lock_phase(session, "dev")
        publishing = threading.Thread(target=publish_it)
        publishing.start()
        wait_until_it_waits(world.database, lambda: not publishing.is_alive())
        renew_boards(session, phase)  # as after every change of what a board may say
    publishing.join()

    assert errors == []


@POSTGRES_ALONE
def test_who_merges_teams_takes_their_jobs_in_the_order_of_all_others(world: World) -> None:
    for content in ("one", "two"):
        world.submit(content)
    of_team = select(Job.id).where(Job.team_id == world.team_id)
    with world.database.write() as session:
        create_team(session, "beta", "Beta", actor="test")
        while (lie := session.scalars(of_team).all())[0] == min(lie):  # in the order of their ids
            session.execute(update(Job).where(Job.id == lie[-1]).values(id=f"0{min(lie)}"))

    def merge() -> None:
        with world.database.write() as session:
            merge_teams(session, "alpha", "beta", reason="one lab", actor="test")

    with ThreadPoolExecutor() as pool:
        with world.database.write() as session:
            session.execute(select(Job.id).where(Job.id == min(lie)).with_for_update())
            merging = pool.submit(merge)
            wait_until_it_waits(world.database, merging.done)
            session.execute(select(Job.id).where(Job.id == max(lie)).with_for_update())
        merging.result()


@POSTGRES_ALONE
def test_who_tries_a_submission_again_takes_its_jobs_first(world: World) -> None:
    accepted = world.submit("file")
    claim = world.claim(accepted.job_id)
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)

    def retry() -> None:
        with world.database.write() as session:
            retry_submission(session, accepted.submission.id, actor="test")

    with ThreadPoolExecutor() as pool:
        with world.database.write() as session:
            session.execute(select(Job.id).where(Job.id == accepted.job_id).with_for_update())
            retrying = pool.submit(retry)
            wait_until_it_waits(world.database, retrying.done)
            find_submission(session, accepted.submission.id, lock=True)  # as `withdraw`
        retrying.result()


@POSTGRES_ALONE
def test_a_team_is_told_something_while_it_uploads(world: World) -> None:
    with world.database.write() as upload, world.database.write() as session:
        hold_team(upload, world.team_id)
        find_team(upload, "alpha", lock=True)
        session.execute(text("SET LOCAL lock_timeout = '2s'"))
        tell_team(session, session.get_one(Team, world.team_id), "message", "Hello.", ())


@POSTGRES_ALONE
def test_a_comparison_is_recorded_while_a_team_edits_the_submission(world: World) -> None:
    """It records many at once, in another order than an edit locks the runs of a method."""
    one = world.submit("file").submission.id
    with world.database.write() as editing, world.database.write() as session:
        edit_submission(editing, one, SubmissionChange(method="Renamed"), actor="test")
        session.execute(text("SET LOCAL lock_timeout = '2s'"))
        keep_alike(session, one, ())


@POSTGRES_ALONE
def test_a_score_and_its_board_request_wait_for_nobody_who_holds_the_phase(world: World) -> None:
    with world.database.write() as holder, world.database.write() as session:
        lock_phase(holder, "dev")
        session.execute(text("SET LOCAL lock_timeout = '2s'"))
        want_board(session, "dev", world.protocol_digest)
        want_board(session, "dev", world.protocol_digest)  # the row is written a second time


@POSTGRES_ALONE
def test_who_asks_for_several_boards_asks_in_the_order_of_all_others(world: World) -> None:
    with world.database.write() as session:
        create_phase(
            session,
            NewPhase(id="other", challenge=PLANNING.id, title="O", split="sample", protocol="1.0"),
            actor="test",
        )

    def ask(*phase_ids: str) -> None:
        with world.database.write() as session:
            for phase_id in phase_ids:
                want_board(session, phase_id, world.protocol_digest)

    def hold(session: Session, phase_id: str) -> None:
        of_phase = select(BoardRequest.id).where(BoardRequest.phase_id == phase_id)
        session.execute(of_phase.with_for_update())

    with ThreadPoolExecutor() as pool:
        with world.database.write() as of_other:
            hold(of_other, "other")
            with world.database.write() as of_dev:
                hold(of_dev, "dev")
                asking = [pool.submit(ask, "dev", "other"), pool.submit(ask, "other", "dev")]
                wait_until_it_waits(world.database, lambda: False, n_waiting=2)
        for each in asking:
            each.result()


@POSTGRES_ALONE
def test_who_builds_boards_waits_for_no_request_that_another_holds(world: World) -> None:
    with world.database.write() as session:
        create_phase(
            session,
            NewPhase(
                id="other",
                challenge=PLANNING.id,
                title="Other",
                split="sample",
                protocol="1.0",
            ),
            actor="test",
        )
    with world.database.write() as held, world.database.write() as session:
        of_other = update(BoardRequest).where(BoardRequest.phase_id == "other")
        held.execute(of_other.values(attempts=BoardRequest.attempts))
        session.execute(text("SET LOCAL lock_timeout = '2s'"))
        taken = claim_board(session, Lane.LIVE, 30)
        assert taken is not None
        assert taken.phase_id == "dev"
        assert claim_board(session, Lane.LIVE, 30) is None


@POSTGRES_ALONE
def test_who_claims_waits_for_no_job_that_another_holds(world: World) -> None:
    held, free = world.submit("held"), world.submit("free")
    with world.database.write() as holder, world.database.write() as session:
        holder.execute(update(Job).where(Job.id == held.job_id).values(attempts=Job.attempts))
        session.execute(text("SET LOCAL lock_timeout = '2s'"))
        taken = jobs.claim_job(session, Lane.LIVE, 30, 4)
        assert taken is not None
        assert taken.id == free.job_id
        assert jobs.claim_job(session, Lane.LIVE, 30, 4) is None
