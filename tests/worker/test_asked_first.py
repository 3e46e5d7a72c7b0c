"""Uploads that count only once their team was asked, where there is something to ask."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import (
    Conflict,
    PhaseClosed,
    QuotaExceeded,
    RejectedCapExceeded,
)
from exceptiondrive_records.entries.selection import choose
from exceptiondrive_records.operations.garbage import sweep_orphans
from exceptiondrive_records.operations.invariants import damaged_uploads, violations
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.retry import restore_submission
from exceptiondrive_records.submissions.submissions import LONGEST_CONFIRMATION, confirm, withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.work.jobs import CONFIRM_WITHIN, jobs_of
from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.api.submission import Quota, SubmissionStatus, SubmissionView
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.scoring_run import score_next

World = Any
MakeFile = Callable[..., bytes]
GAPS = {"a": {"edited": None}}


@pytest.fixture
def on_both(make_world: Callable[..., World], database_url: str, tiny: Split) -> World:
    world = make_world(database_url)
    world.add_phase(tiny)
    return world


def seen(world: World, submission_id: str) -> SubmissionView:
    with world.database.read() as session:
        return view(session, session.get_one(Submission, submission_id))


def quota(world: World, submission_id: str) -> Quota:
    with world.database.read() as session:
        submission = session.get_one(Submission, submission_id)
        return quota_of(session, submission.team_id, find_phase(session, "dev"))


def confirmed(world: World, submission_id: str) -> str:
    """Say yes, and let a worker score it; return the id of what counts."""
    with world.database.write() as session:
        counted_id = confirm(session, submission_id, actor="test").id
        (job,) = jobs_of(session, counted_id)
        lane = job.lane
    assert lane is not None
    assert score_next(world.context, lane)
    return counted_id


def test_what_would_not_be_ranked_costs_nothing_until_it_is_confirmed(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    asked_id = on_both.score(planning_file(tiny, changes=GAPS), asks_first=True)
    asked = seen(on_both, asked_id)
    assert asked.is_asked
    assert asked.sheet is None
    assert asked.report is not None
    (question,) = asked.report.to_confirm
    assert question.endswith(
        "not ranked: 75.00% of the samples as edited are answered; a rank needs 99%."
    )
    before = quota(on_both, asked_id)
    assert (before.used_today, before.rejected_today) == (0, 1)

    counted = seen(on_both, confirmed(on_both, asked_id))
    assert counted.status is SubmissionStatus.SCORED
    assert counted.sheet is not None
    assert (counted.method, counted.file_digest) == (asked.method, asked.file_digest)
    assert seen(on_both, asked_id).confirmed_as == counted.id
    after = quota(on_both, asked_id)
    assert (after.used_today, after.rejected_today) == (1, 1), "a question is no way round the cap"
    with on_both.database.write() as session:
        withdraw(session, counted.id, actor="team:alpha")
        with pytest.raises(Conflict, match=f"confirmed as {counted.id}"):
            restore_submission(session, asked_id, actor="organizer", reason="a mistake")
    with on_both.database.read() as session:
        assert violations(session) == []


def test_the_last_file_that_may_be_wrong_today_can_be_asked_about_and_confirmed(
    make_world: Callable[..., World], sqlite_url: str, tiny: Split, planning_file: MakeFile
) -> None:
    world = make_world(sqlite_url)
    world.add_phase(tiny, rejected_per_day=1)
    asked_id = world.score(planning_file(tiny, changes=GAPS), asks_first=True)
    assert quota(world, asked_id).left_of_rejected == 0
    with pytest.raises(RejectedCapExceeded):
        world.submit(planning_file(tiny), "another")
    assert seen(world, confirmed(world, asked_id)).status is SubmissionStatus.SCORED


def test_a_file_without_a_question_goes_straight_on(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    scored = seen(on_both, on_both.score(planning_file(tiny), asks_first=True))
    assert scored.status is SubmissionStatus.SCORED
    assert not scored.is_asked


def test_a_wrong_file_is_told_its_faults_and_asked_nothing(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    on_both.score(planning_file(tiny))
    rejected = seen(on_both, on_both.score(b"[]", asks_first=True))
    assert rejected.report is not None
    assert rejected.report.faults
    assert not rejected.is_asked


def test_a_run_that_takes_the_place_of_an_entry_is_asked_about_and_a_new_method_is_not(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    first = on_both.score(planning_file(tiny), method="Kestrel")
    other = on_both.score(planning_file(tiny, 1.1), method="Merlin", asks_first=True)
    assert seen(on_both, other).status is SubmissionStatus.SCORED
    asked_id = on_both.score(planning_file(tiny, 1.2), method="Kestrel", asks_first=True)
    asked = seen(on_both, asked_id)
    assert asked.report is not None
    (question,) = asked.report.to_confirm
    assert question.startswith(f"It replaces {first} (HCC ")
    assert question.endswith('of "Kestrel".')
    assert seen(on_both, first).replaced_by is None
    counted_id = confirmed(on_both, asked_id)
    assert seen(on_both, first).replaced_by == counted_id


def test_an_entry_of_another_phase_is_not_replaced(
    world: World, tiny: Split, planning_file: MakeFile
) -> None:
    world.add_phase(tiny)
    world.add_phase(tiny, "other")
    world.score(planning_file(tiny), method="Kestrel", phase_id="other")
    later = world.score(planning_file(tiny, 1.2), method="Kestrel", asks_first=True)
    assert seen(world, later).status is SubmissionStatus.SCORED


def test_where_the_best_run_stands_nothing_is_replaced(
    world: World, tiny: Split, planning_file: MakeFile
) -> None:
    world.add_phase(tiny, policy=PhasePolicy(run_choice="team"))
    first = world.score(planning_file(tiny), method="Kestrel")
    with world.database.write() as session:
        choose(session, first, actor="test", rule="best")
    later = world.score(planning_file(tiny, 1.2), method="Kestrel", asks_first=True)
    assert seen(world, later).status is SubmissionStatus.SCORED


def test_the_same_bytes_without_a_question_are_the_word(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    data = planning_file(tiny, changes=GAPS)
    asked_id = on_both.score(data, asks_first=True)
    counted_id = on_both.score(data, method="Another name")
    assert counted_id != asked_id
    assert seen(on_both, counted_id).method == "Another name"
    assert seen(on_both, asked_id).confirmed_as == counted_id


def test_confirming_twice_is_once_and_there_must_be_a_question(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    asked_id = on_both.score(planning_file(tiny, changes=GAPS), asks_first=True)
    counted_id = confirmed(on_both, asked_id)
    with on_both.database.write() as session:
        assert confirm(session, asked_id, actor="test").id == counted_id
    with pytest.raises(Conflict, match="Nothing is asked"), on_both.database.write() as session:
        confirm(session, counted_id, actor="test")
    assert quota(on_both, asked_id).used_today == 1


def test_a_confirmation_takes_quota_as_an_upload_does(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    asked_id = on_both.score(planning_file(tiny, changes=GAPS), asks_first=True)
    on_both.score(planning_file(tiny), method="other")
    with on_both.database.write() as session:
        session.get_one(Phase, "dev").quota_per_day = 1
    with pytest.raises(QuotaExceeded), on_both.database.write() as session:
        confirm(session, asked_id, actor="test")
    assert seen(on_both, asked_id).is_asked, "what is refused changes nothing"


def test_what_was_not_confirmed_in_time_loses_its_file_and_can_be_sent_again(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    data = planning_file(tiny, changes=GAPS)
    asked_id = on_both.score(data, asks_first=True)
    asked = seen(on_both, asked_id)
    assert asked.confirm_until is not None
    assert asked.confirm_until - asked.status_at == pytest.approx(
        CONFIRM_WITHIN, abs=timedelta(minutes=5)
    )
    lapse(on_both, asked_id, ago=timedelta(minutes=1))
    with pytest.raises(Conflict, match="time to confirm"), on_both.database.write() as session:
        confirm(session, asked_id, actor="test")
    assert seen(on_both, asked_id).confirm_until is None
    assert not seen(on_both, asked_id).is_asked
    assert sweep(on_both) == 0, "a confirmation that began in time may be under way"

    lapse(on_both, asked_id, ago=LONGEST_CONFIRMATION)
    assert sweep(on_both) == 1
    assert not on_both.files.holds(asked.file_digest)
    again_id = on_both.score(data, asks_first=True)
    assert seen(on_both, again_id).is_asked
    assert seen(on_both, asked_id).confirmed_as == again_id
    lapse(on_both, again_id, ago=LONGEST_CONFIRMATION)
    assert sweep(on_both) == 1
    with on_both.database.read() as session:
        assert violations(session) + damaged_uploads(session, on_both.files, limit_bytes=1) == []
    counted_id = on_both.score(data)
    assert seen(on_both, counted_id).sheet is not None
    assert sweep(on_both) == 0


def test_a_file_that_another_submission_has_is_kept(
    on_both: World, tiny: Split, planning_file: MakeFile
) -> None:
    data = planning_file(tiny, changes=GAPS)
    asked_id = on_both.score(data, asks_first=True)
    on_both.score(data, team="beta")
    lapse(on_both, asked_id, ago=LONGEST_CONFIRMATION)
    assert sweep(on_both) == 0


def lapse(world: World, submission_id: str, *, ago: timedelta) -> None:
    with world.database.write() as session:
        session.get_one(Submission, submission_id).confirm_until = database_now(session) - ago


def sweep(world: World) -> int:
    grace = timedelta(seconds=-1)
    return sweep_orphans(world.database, world.files, actor="test", grace=grace).n_files


@pytest.mark.parametrize(("minutes_ago", "is_late"), [(5, False), (20, True)])
def test_a_confirmation_is_judged_by_the_first_byte_of_its_file(
    on_both: World, tiny: Split, planning_file: MakeFile, minutes_ago: int, is_late: bool
) -> None:
    asked_id = on_both.score(planning_file(tiny, changes=GAPS), asks_first=True)
    with on_both.database.write() as session:
        now = database_now(session)
        session.get_one(Submission, asked_id).arrived_at = now - timedelta(minutes=minutes_ago)
        session.get_one(Phase, "dev").opens_at = datetime(2020, 1, 1, tzinfo=UTC)
        session.get_one(Phase, "dev").closes_at = now - timedelta(minutes=2)
    asked = seen(on_both, asked_id)
    if is_late:
        assert not asked.is_asked, "nothing is offered that can only fail"
        with pytest.raises(PhaseClosed), on_both.database.write() as session:
            confirm(session, asked_id, actor="test")
        with on_both.database.write() as session:
            session.get_one(Phase, "dev").policy = PhasePolicy(late_entries="own_view")
        asked = seen(on_both, asked_id)
        assert asked.is_asked
        assert asked.report is not None
        assert "confirmed now, it stands on the late view alone" in asked.report.to_confirm[-1]
        with on_both.database.write() as session:
            late_id = confirm(session, asked_id, actor="test").id
        assert seen(on_both, late_id).is_late
        return
    assert asked.report is not None
    until = now + timedelta(minutes=15 - minutes_ago)
    assert asked.report.to_confirm[-1] == (
        f"It is in time where it is confirmed before {until:%Y-%m-%d %H:%M} UTC, a quarter of an hour "
        "after its first byte."
    )
    with on_both.database.write() as session:
        counted = confirm(session, asked_id, actor="test")
        closes_at = session.get_one(Phase, "dev").closes_at
        assert closes_at is not None
        assert counted.arrived_at is not None
        assert counted.arrived_at < closes_at
