"""What a scored file looks like is told to who asks, after the scores, which wait for nothing."""

from collections.abc import Callable
from datetime import timedelta
from typing import Any

from sqlalchemy import select, update

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.work.lease import give_up, new_item
from exceptiondrive_records.work.profiles import ask_for_profile
from exceptiondrive_records.work.tables import Job, Profile, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.profile_run import describe_next
from exceptiondrive_worker.work import work

World = Any
MakeFile = Callable[..., bytes]


def profile_of(world: World, submission_id: str) -> Profile:
    with world.database.read() as session:
        item: Profile = session.scalars(select(Profile).where(Profile.key == submission_id)).one()
        return item


def ask(world: World, submission_id: str) -> None:
    with world.database.write() as session:
        ask_for_profile(session, submission_id)


def awaits_profile(world: World, submission_id: str) -> bool:
    with world.database.read() as session:
        return view(session, world.submission(submission_id)).awaits_profile


def test_a_scored_file_is_described_once_for_its_team(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED
    assert not describe_next(phase.context), "nobody asked"
    assert not awaits_profile(phase, submission_id)
    ask(phase, submission_id)
    ask(phase, submission_id)
    assert phase.submission(submission_id).report is None
    assert awaits_profile(phase, submission_id)
    assert describe_next(phase.context)
    report = phase.submission(submission_id).report
    assert report.is_valid
    assert report.n_predictions == len(tiny.samples)
    assert report.profile.source_speed_mps == 4.0
    assert not awaits_profile(phase, submission_id)
    assert profile_of(phase, submission_id).state is WorkState.DONE
    assert not describe_next(phase.context)


def test_scores_come_before_profiles(phase: World, tiny: Split, planning_file: MakeFile) -> None:
    for n, team in enumerate(("alpha", "beta", "gamma"), 1):
        submission_id, _ = phase.submit(planning_file(tiny, edited_mps=float(n)), team=team)
        ask(phase, submission_id)
    while work(phase.context, Lane.LIVE):
        pass
    with phase.database.read() as session:
        scored = [job.finished_at for job in session.scalars(select(Job))]
        described = [item.leased_at for item in session.scalars(select(Profile))]
    assert len(described) == 3
    assert max(scored) <= min(described)


def test_a_rescored_file_is_looked_at_once(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    team_id = phase.submission(submission_id).team_id
    with phase.database.write() as session:
        again = new_item(
            Job,
            "again",
            database_now(session),
            lane=Lane.RESCORE,
            submission_id=submission_id,
            team_id=team_id,
            protocol_digest=packaged_protocol().digest,
            split_revision=tiny.revision,
            is_first=False,
        )
        session.add(again)
    ask(phase, submission_id)
    assert profile_of(phase, submission_id).protocol_digest == packaged_protocol().digest
    assert describe_next(phase.context)
    assert phase.submission(submission_id).report.profile is not None
    assert not describe_next(phase.context)


def test_a_withdrawn_submission_is_told_nothing(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    ask(phase, submission_id)
    with phase.database.write() as session:
        withdraw(session, submission_id, actor="alpha")
    assert describe_next(phase.context)
    assert phase.submission(submission_id).report is None


def test_a_file_that_cannot_be_described_stays_scored(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    ask(phase, submission_id)
    (phase.settings.splits_dir / tiny.name / "split.json").unlink()
    phase.reopen_context()
    for _ in range(phase.settings.max_attempts):
        assert describe_next(phase.context)
        with phase.database.write() as session:
            session.execute(update(Profile).values(available_at=database_now(session)))
    assert profile_of(phase, submission_id).state is WorkState.FAILED
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED
    assert not awaits_profile(phase, submission_id)


def test_a_file_that_ends_its_worker_each_time_is_given_up(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    ask(phase, submission_id)
    with phase.database.write() as session:
        past = database_now(session) - timedelta(hours=1)
        session.execute(
            update(Profile).values(
                state=WorkState.LEASED, lease_until=past, attempts=phase.settings.max_attempts
            )
        )
    assert not describe_next(phase.context)
    assert awaits_profile(phase, submission_id)
    with phase.database.write() as session:
        give_up(session, Profile, phase.settings.max_attempts)
    assert profile_of(phase, submission_id).state is WorkState.DEAD
    assert not awaits_profile(phase, submission_id)
