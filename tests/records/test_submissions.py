"""Accepting, withdrawing, listing and retrying submissions."""

from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import update
from tests.support.records import count_audit_lines

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound, PhaseClosed
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.submissions import (
    accept,
    find_submission,
    submission_page,
    withdraw,
)
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.tables import BoardRequest, Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.method_facts import Links

REVISION = "sha256:" + "5" * 64

World = Any


def accept_with(world: World, **changes: Any) -> Any:
    values = {
        "team_id": world.team_id,
        "phase_id": "dev",
        "method": "method",
        "file_digest": "sha256:" + "a" * 64,
        "size_bytes": 1,
        **changes,
    }
    with world.database.write() as session:
        return accept(session, **values)


def test_an_accepted_upload_is_a_submission_and_a_queued_job(world: World) -> None:
    accepted = world.submit("file")
    with world.database.read() as session:
        submission = session.get(Submission, accepted.submission.id)
        job = session.get(Job, accepted.job_id)
        assert submission.status is SubmissionStatus.RECEIVED
        assert (job.state, job.is_first, job.attempts) == (WorkState.QUEUED, True, 0)
        assert job.submission_id == submission.id
        assert count_audit_lines(session, "submission received") == 1


def test_the_same_bytes_again_give_the_first_submission(world: World) -> None:
    first = world.submit("file")
    again = world.submit("file")
    assert again.is_duplicate
    assert again.job_id is None
    assert again.submission.id == first.submission.id
    with world.database.read() as session:
        assert session.query(Job).count() == 1


def test_the_same_bytes_under_another_name_are_refused_and_change_nothing(world: World) -> None:
    first = world.submit("file")
    with pytest.raises(Conflict, match=f"exceptiondrive edit {first.submission.id}"):
        world.submit("file", method="other name")
    with world.database.read() as session:
        assert [row.method for row in session.query(Submission)] == ["method"]
        assert session.query(Job).count() == 1


def test_a_rejected_file_again_under_another_name_leads_to_its_faults(world: World) -> None:
    first = world.submit("file")
    rejected = update(Submission).values(status=SubmissionStatus.REJECTED)
    with world.database.write() as session:
        session.execute(rejected)
    again = world.submit("file", method="other name")
    assert (again.submission.id, again.is_duplicate) == (first.submission.id, True)
    with world.database.write() as session:
        until = database_now(session) + timedelta(hours=1)
        session.execute(rejected.values(confirm_until=until))
    same = {"file_digest": first.submission.file_digest, "asks_first": True}
    with pytest.raises(Conflict, match="exceptiondrive edit"):
        accept_with(world, method="other name", **same)


def test_the_same_bytes_of_another_team_are_another_submission(world: World) -> None:
    with world.database.write() as session:
        other = create_team(session, "beta", "Beta", actor="test").id
    first = world.submit("file")
    assert world.submit("file", team_id=other).submission.id != first.submission.id


def test_the_same_bytes_after_a_withdrawal_are_a_new_submission(world: World) -> None:
    first = world.submit("file")
    with world.database.write() as session:
        withdraw(session, first.submission.id, actor="test")
    assert not world.submit("file").is_duplicate


@pytest.mark.parametrize(
    ("opens_in_h", "closes_in_h", "words"), [(1, None, "opens at"), (-2, -1, "closed at")]
)
def test_a_phase_that_is_not_open_refuses(
    world: World, opens_in_h: int, closes_in_h: int | None, words: str
) -> None:
    with world.database.write() as session:
        phase = session.get(Phase, "dev")
        phase.opens_at = phase.created_at + timedelta(hours=opens_in_h)
        if closes_in_h is not None:
            phase.closes_at = phase.created_at + timedelta(hours=closes_in_h)
    with pytest.raises(PhaseClosed, match=words):
        world.submit("file")
    with world.database.read() as session:
        assert session.query(Submission).count() == 0


def test_an_unknown_phase_is_not_found(world: World) -> None:
    with pytest.raises(NotFound):
        accept_with(world, phase_id="nowhere")


@pytest.mark.parametrize(
    "changes",
    [
        {"method": "  "},
        {"method": "x" * 81},
        {"method": "zero\u200bwidth"},
        {"method": "bell\x07"},
        {"description": "x" * 2001},
        {"links": Links(paper="http://example.org")},
        {"links": Links(code="javascript:alert(1)")},
        {"links": Links(code="https://user@example.org/")},
        {"links": Links(code='https://example.org/" onclick="')},
    ],
)
def test_texts_and_links_that_cannot_be_shown_safely_are_refused(
    world: World, changes: dict[str, Any]
) -> None:
    with pytest.raises(InvalidRecord):
        accept_with(world, **changes)
    with world.database.read() as session:
        assert session.query(Submission).count() == 0


def test_withdrawing_a_waiting_submission_ends_its_job_and_a_late_answer_is_refused(
    world: World,
) -> None:
    accepted = world.submit("file")
    claim = world.claim(accepted.job_id)
    with world.database.write() as session:
        withdraw(session, accepted.submission.id, actor="test")
    assert not world.finish(claim)
    with world.database.read() as session:
        assert session.get(Job, accepted.job_id).state is WorkState.CANCELLED
        assert session.get(Submission, accepted.submission.id).status is SubmissionStatus.WITHDRAWN


def test_withdrawing_a_scored_submission_asks_for_a_new_board(world: World) -> None:
    submission_id = world.scored("file")
    with world.database.write() as session:
        before = session.query(BoardRequest).one().asked
        withdraw(session, submission_id, actor="test")
        withdraw(session, submission_id, actor="test")  # twice does nothing
    with world.database.read() as session:
        assert session.query(BoardRequest).one().asked == before + 1
        assert count_audit_lines(session, "submission withdrawn") == 1


def test_a_failed_submission_cannot_be_withdrawn_but_retried(world: World) -> None:
    accepted = world.submit("file")
    claim = world.claim(accepted.job_id)
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)
    with world.database.write() as session, pytest.raises(Conflict, match="failed"):
        withdraw(session, accepted.submission.id, actor="test")
    with world.database.write() as session:
        retry_submission(session, accepted.submission.id, actor="test")
    assert not world.finish(claim)  # the old claim is void
    world.score(accepted.job_id)
    with world.database.read() as session:
        submission = session.get(Submission, accepted.submission.id)
        assert (submission.status, submission.failure_code) == (SubmissionStatus.SCORED, None)


def test_a_failed_submission_is_not_retried_when_the_same_bytes_came_again(world: World) -> None:
    first = world.submit("file")
    claim = world.claim(first.job_id)
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)
    assert not world.submit("file").is_duplicate
    with world.database.write() as session, pytest.raises(Conflict, match="same file again"):
        retry_submission(session, first.submission.id, actor="test")


def test_only_failed_submissions_are_retried(world: World) -> None:
    submission_id = world.scored("file")
    with world.database.write() as session, pytest.raises(Conflict, match="scored"):
        retry_submission(session, submission_id, actor="test")


def test_anothers_submission_and_an_unknown_one_are_the_same_answer(world: World) -> None:
    submission_id = world.submit("file").submission.id
    with world.database.read() as session:
        with pytest.raises(NotFound) as anothers:
            find_submission(session, submission_id, team_id=world.team_id + 1)
        with pytest.raises(NotFound) as unknown:
            find_submission(session, "0" * 16, team_id=world.team_id)
    assert str(anothers.value).replace(submission_id, "0" * 16) == str(unknown.value)


def test_pages_list_every_submission_once_newest_first(world: World) -> None:
    ids = [world.submit(f"file {i}").submission.id for i in range(7)]
    with world.database.write() as session:  # the same moment for some: ids break the tie
        session.execute(update(Submission).values(received_at=Submission.status_at))
    seen: list[str] = []
    after = None
    with world.database.read() as session:
        while True:
            page, after = submission_page(session, team_id=world.team_id, after=after, limit=3)
            seen += [row.id for row in page]
            if after is None:
                break
    assert sorted(seen) == sorted(ids)
    assert len(set(seen)) == 7


def test_lists_can_be_narrowed(world: World) -> None:
    done = world.scored("one")
    world.submit("two")
    with world.database.read() as session:
        scored = SubmissionStatus.SCORED
        found, _ = submission_page(session, phase_id="dev", status=scored, limit=2)
        assert [row.id for row in found] == [done]
        assert submission_page(session, team_id=world.team_id + 1, limit=2) == ([], None)
