"""The status machine: fenced compare-and-set steps, on both databases."""

from datetime import UTC, datetime
from typing import Any

import pytest
from sqlalchemy import select, update
from sqlalchemy.exc import IntegrityError
from tests.support.records import count_audit_lines
from tests.support.work import claim_this

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.scoring_keys import ScoringKey
from exceptiondrive_records.rescoring.progress import count_sheets, left_out, scored_left_out
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.profiles import ask_for_profile
from exceptiondrive_records.work.tables import (
    NEEDED,
    BoardRequest,
    Job,
    Profile,
    WorkItem,
    WorkState,
)
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.faults import CheckReport, FaultCode, FaultGroup

REVISION = "sha256:" + "5" * 64

LEASE_S = 120
World = Any


def take(world: World, job_id: str, max_attempts: int = 4) -> Job | None:
    with world.database.write() as session:
        return claim_this(session, job_id, LEASE_S, max_attempts)


def must_take(world: World, job_id: str, max_attempts: int = 4) -> Job:
    claim = take(world, job_id, max_attempts)
    assert claim is not None
    return claim


def score(world: World, claim: Job, exact_digest: str = "sha256:exact") -> bool:
    with world.database.write() as session:
        return jobs.finish_scored(
            session,
            claim,
            world.sheet(),
            exact_digest=exact_digest,
            measurement_key="m",
            scorer_version="1",
        )


def expire_lease(world: World, job_id: str) -> None:
    with world.database.write() as session:
        job = session.get(Job, job_id)
        job.lease_until = job.lease_until.replace(year=2020)


def state_of(world: World, submission_id: str) -> tuple[SubmissionStatus, WorkState]:
    with world.database.read() as session:
        job = session.query(Job).filter_by(submission_id=submission_id, is_first=True).one()
        return session.get(Submission, submission_id).status, job.state


def test_a_claim_says_all_that_scoring_needs(world: World) -> None:
    accepted = world.submit("file")
    claim = must_take(world, accepted.job_id)
    assert claim.submission_id == accepted.submission.id
    assert (claim.fence, claim.attempts, claim.is_first) == (1, 1, True)
    assert (claim.protocol_digest, claim.split_revision) == (world.protocol_digest, REVISION)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.SCORING, WorkState.LEASED)


def test_scoring_leaves_sheet_status_audit_line_and_board_request_together(world: World) -> None:
    claim = must_take(world, world.submit("file").job_id)
    assert score(world, claim)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.SCORED, WorkState.DONE)
    with world.database.read() as session:
        key = (claim.submission_id, claim.protocol_digest, claim.split_revision)
        assert session.get(ScoreSheetRow, key).sheet == world.sheet()
        assert session.query(BoardRequest).one().asked == 2
        assert count_audit_lines(session, "submission scored") == 1
        assert verify_audit(session).is_whole


def test_a_duplicate_delivery_gets_no_claim(world: World) -> None:
    job_id = world.submit("file").job_id
    claim = must_take(world, job_id)
    assert take(world, job_id) is None
    score(world, claim)
    assert take(world, job_id) is None


def test_an_unknown_job_gets_no_claim(world: World) -> None:
    assert take(world, "no-such-job") is None


def test_an_expired_lease_is_claimed_again_and_the_late_answer_is_refused(world: World) -> None:
    job_id = world.submit("file").job_id
    frozen = must_take(world, job_id)
    expire_lease(world, job_id)
    fresh = must_take(world, job_id)
    assert (fresh.fence, fresh.attempts) == (2, 2)
    assert not score(world, frozen, "sha256:late")
    assert score(world, fresh, "sha256:right")
    assert not score(world, frozen, "sha256:late")
    with world.database.read() as session:
        assert [row.exact_digest for row in session.query(ScoreSheetRow)] == ["sha256:right"]
        assert count_audit_lines(session, "stale fence rejected") == 2
        assert count_audit_lines(session, "submission scored") == 1


def test_attempts_end_at_the_limit(world: World) -> None:
    job_id = world.submit("file").job_id
    for _ in range(4):
        must_take(world, job_id)
        expire_lease(world, job_id)
    assert take(world, job_id) is None


def test_a_rejected_file_keeps_its_report_and_makes_no_sheet(world: World) -> None:
    report = CheckReport(
        challenge=PLANNING.id,
        split="sample",
        n_predictions=1,
        digest="sha256:x",
        size_bytes=1,
        faults=(FaultGroup(code=FaultCode.NOT_JSON, message="Not JSON.", count=1, examples=()),),
    )
    claim = must_take(world, world.submit("file").job_id)
    with world.database.write() as session:
        assert jobs.finish_rejected(session, claim, report)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.REJECTED, WorkState.DONE)
    with world.database.read() as session:
        assert session.get(Submission, claim.submission_id).report == report
        assert session.query(ScoreSheetRow).count() == 0


def fail(world: World, claim: Job, *, retry: bool, max_attempts: int = 4) -> bool:
    with world.database.write() as session:
        return jobs.finish_failed(
            session, claim, "internal", "We failed.", retry=retry, max_attempts=max_attempts
        )


def test_a_failure_that_may_pass_is_queued_again_after_a_wait(world: World) -> None:
    job_id = world.submit("file").job_id
    claim = must_take(world, job_id)
    assert fail(world, claim, retry=True)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.QUEUED, WorkState.QUEUED)
    assert take(world, job_id) is None  # not before its time
    with world.database.write() as session:
        session.execute(update(Job).values(available_at=Job.created_at))
    assert must_take(world, job_id).attempts == 2


def test_a_failure_on_the_last_attempt_is_final(world: World) -> None:
    claim = must_take(world, world.submit("file").job_id, max_attempts=1)
    assert fail(world, claim, retry=True, max_attempts=1)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.FAILED, WorkState.DEAD)


def test_a_failure_that_cannot_pass_is_final_and_says_why(world: World) -> None:
    claim = must_take(world, world.submit("file").job_id)
    assert fail(world, claim, retry=False)
    assert state_of(world, claim.submission_id) == (SubmissionStatus.FAILED, WorkState.FAILED)
    with world.database.read() as session:
        submission = session.get(Submission, claim.submission_id)
        assert (submission.failure_code, submission.failure_message) == ("internal", "We failed.")


def test_a_score_that_differs_for_one_key_is_an_alarm_and_never_an_overwrite(world: World) -> None:
    job_id = world.submit("file").job_id
    score(world, must_take(world, job_id), "sha256:first")
    with world.database.write() as session:  # an organizer queues the finished job again
        session.execute(update(Job).values(state=WorkState.QUEUED))
    score(world, must_take(world, job_id), "sha256:second")
    with world.database.read() as session:
        assert [row.exact_digest for row in session.query(ScoreSheetRow)] == ["sha256:first"]
        assert count_audit_lines(session, "scores differ for one key") == 1


def test_a_rescoring_job_leaves_the_status_of_the_submission_alone(world: World) -> None:
    accepted = world.submit("file")
    score(world, must_take(world, accepted.job_id))
    with world.database.write() as session:
        session.execute(update(Job).values(state=WorkState.QUEUED, is_first=False))
    claim = must_take(world, accepted.job_id)
    with world.database.read() as session:
        assert session.get(Submission, claim.submission_id).status is SubmissionStatus.SCORED
    assert fail(world, claim, retry=False)
    with world.database.read() as session:
        assert session.get(Submission, claim.submission_id).status is SubmissionStatus.SCORED


@pytest.mark.parametrize(
    ("kind", "column"), [(kind, column) for kind, columns in NEEDED.items() for column in columns]
)
def test_an_item_without_what_its_kind_needs_is_refused(
    database: Database, kind: str, column: str
) -> None:
    given: dict[str, object] = {"team_id": 1, "is_first": True}
    now = datetime.now(UTC)
    values = {name: given.get(name, "x") for name in NEEDED[kind] if name != column}
    values |= {"id": "w", "kind": kind, "key": "k", "state": WorkState.QUEUED}
    values |= {"asked": 1, "attempts": 0, "fence": 0, "created_at": now, "available_at": now}
    with (
        pytest.raises(IntegrityError, match=f"needed_for_{kind}"),
        database.write() as session,
    ):
        session.execute(WorkItem.metadata.tables["work"].insert().values(values))


def test_a_submission_with_a_sheet_or_a_job_under_a_key_is_not_left_out(world: World) -> None:
    accepted = world.submit("file")
    shown = ScoringKey(world.protocol_digest, must_take(world, accepted.job_id).split_revision)
    with world.database.read() as session:
        assert session.scalars(left_out(world.phase_id, shown)).all() == [], "it has a job"
    expire_lease(world, accepted.job_id)
    world.score(accepted.job_id)
    with world.database.write() as session:
        session.delete(session.get_one(Job, accepted.job_id))
        session.flush()
        assert session.scalars(left_out(world.phase_id, shown)).all() == [], "it has a sheet"


def test_a_file_that_is_looked_at_has_no_job_by_that(world: World) -> None:
    accepted = world.submit("file")
    key, again = (ScoringKey(world.protocol_digest, revision) for revision in ("r2", "r3"))
    with world.database.write() as session:
        ask_for_profile(session, accepted.submission.id)
        profile = session.scalars(select(Profile)).one()
        profile.split_revision = key.split_revision
    with world.database.read() as session:
        for each in (key, again):
            waiting = session.scalars(left_out(world.phase_id, each)).all()
            assert [one.id for one in waiting] == [accepted.submission.id], each
    world.score(accepted.job_id)
    with world.database.read() as session:
        missing = session.scalars(scored_left_out(world.phase_id, key, 9)).all()
        assert [one.id for one in missing] == [accepted.submission.id]
        assert count_sheets(session, world.phase_id, key).failed == 0
