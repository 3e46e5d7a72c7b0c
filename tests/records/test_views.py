"""What a team sees of its submission: queue place, sheet, rank, failure."""

from datetime import timedelta
from typing import Any

from tests.records.statements import of_board_texts, statements

from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.views import recent_scoring_s, view, views
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.heartbeats import beat, forget_worker, live_workers
from exceptiondrive_records.work.tables import Job, WorkerHeartbeat, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane

World = Any


def seen(world: World, submission_id: str) -> SubmissionView:
    with world.database.read() as session:
        return view(session, find_submission(session, submission_id))


def test_a_waiting_submission_shows_how_many_stand_before_it(world: World) -> None:
    accepted = [world.submit(f"file {i}") for i in range(3)]
    places = [seen(world, one.submission.id).queue for one in accepted]
    assert [place and place.position for place in places] == [0, 1, 2]
    world.score(accepted[0].job_id)
    assert seen(world, accepted[0].submission.id).queue is None
    last = seen(world, accepted[2].submission.id).queue
    assert last is not None
    assert last.position == 1


def test_the_expected_wait_comes_from_measured_durations_and_live_workers(world: World) -> None:
    done = [world.submit(f"done {i}") for i in range(3)]
    for one in done:
        world.score(one.job_id)
    with world.database.write() as session:
        for job, duration_s in zip(
            session.query(Job).order_by(Job.created_at), [2, 4, 90], strict=True
        ):
            job.leased_at = job.finished_at - timedelta(seconds=duration_s)
        for name, lane in (("one", Lane.LIVE), ("two", Lane.LIVE), ("three", Lane.RESCORE)):
            beat(session, name, (lane,))
    waiting = [world.submit(f"waiting {i}") for i in range(4)]
    place = seen(world, waiting[3].submission.id).queue
    assert place is not None
    assert (place.position, place.workers_alive) == (3, 2)
    assert (
        place.expected_wait_s == 2 * 4 / 2
    )  # two must end before a worker is free, x median / workers


def test_the_place_in_the_queue_goes_by_turns_not_by_arrival(world: World) -> None:
    flood = [world.submit(f"flood {i}") for i in range(5)]
    with world.database.write() as session:
        beta = create_team(session, "beta", "Beta", actor="test").id
    quiet = [world.submit(f"quiet {i}", team_id=beta) for i in range(2)]
    places = [seen(world, one.submission.id).queue for one in (*flood, *quiet)]
    assert [place and place.position for place in places] == [0, 2, 4, 5, 6, 1, 3]
    world.claim(flood[0].job_id)
    places = [seen(world, one.submission.id).queue for one in (*flood, *quiet)]
    assert [place and place.position for place in places] == [0, 3, 4, 5, 6, 1, 2]


def test_no_wait_is_promised_without_a_worker_or_a_measurement(world: World) -> None:
    waiting = world.submit("waiting")
    place = seen(world, waiting.submission.id).queue
    assert place is not None
    assert (place.expected_wait_s, place.workers_alive) == (None, 0)
    with world.database.read() as session:
        assert recent_scoring_s(session) is None


def test_a_worker_that_does_not_find_the_split_is_none_to_wait_for(world: World) -> None:
    """One that lacks another split, or another revision of this one, as an update may ask for, is."""
    world.score(world.submit("done").job_id)
    waiting = world.submit("waiting")
    with world.database.read() as session:
        revision = session.get_one(Job, waiting.job_id).split_revision
    for lacks, expected in (
        (["other", "sample"], (None, 0)),
        ([f"sample@{revision}"], (None, 0)),
        (["other", "sample@sha256:another"], (0, 1)),
    ):
        with world.database.write() as session:
            beat(session, "one", missing_splits=lacks)
        place = seen(world, waiting.submission.id).queue
        assert place is not None
        assert (place.expected_wait_s, place.workers_alive) == expected


def test_a_submission_being_scored_shows_its_attempt(world: World) -> None:
    accepted = world.submit("file")
    world.claim(accepted.job_id)
    found = seen(world, accepted.submission.id)
    assert found.status is SubmissionStatus.SCORING
    assert found.queue is not None
    assert (found.queue.position, found.queue.attempts) == (0, 1)


def test_until_when_a_worker_has_a_file_is_told_while_it_has_it(world: World) -> None:
    accepted = world.submit("file")
    waiting = seen(world, accepted.submission.id).queue
    assert waiting is not None
    assert waiting.lease_until is None
    claimed = world.claim(accepted.job_id)
    held = seen(world, accepted.submission.id).queue
    assert held is not None
    assert held.lease_until == claimed.lease_until is not None
    with world.database.write() as session:
        session.get_one(Job, accepted.job_id).lease_until = claimed.leased_at
    lost = seen(world, accepted.submission.id).queue
    assert lost is not None
    assert lost.lease_until is None


def test_a_scored_submission_shows_its_sheet_until_it_is_withdrawn(world: World) -> None:
    accepted = world.submit("file")
    world.score(accepted.job_id)
    assert seen(world, accepted.submission.id).sheet == world.sheet()
    with world.database.write() as session:
        withdraw(session, accepted.submission.id, actor="test")
    assert seen(world, accepted.submission.id).sheet is None


def test_rejected_and_failed_submissions_say_why(world: World) -> None:
    report = CheckReport(
        challenge=None, split=None, n_predictions=None, digest="sha256:x", size_bytes=1
    )
    wrong, ours = world.submit("wrong"), world.submit("ours")
    wrong_claim, our_claim = world.claim(wrong.job_id), world.claim(ours.job_id)
    with world.database.write() as session:
        jobs.finish_rejected(session, wrong_claim, report)
        jobs.finish_failed(session, our_claim, "internal", "We failed.", retry=False)
    assert seen(world, wrong.submission.id).report == report
    failure = seen(world, ours.submission.id).failure
    assert failure is not None
    assert (failure.code, failure.message) == ("internal", "We failed.")


def test_several_views_keep_their_order(world: World) -> None:
    accepted = [world.submit(f"file {i}").submission for i in range(3)]
    with world.database.read() as session:
        found = views(session, [find_submission(session, one.id) for one in accepted])
    assert [one.id for one in found] == [one.id for one in accepted]


def test_a_worker_lives_for_as_long_as_its_sign_of_life_says(world: World) -> None:
    with world.database.write() as session:
        beat(session, "old")
        beat(session, "young", (Lane.LIVE, Lane.RESCORE), ttl_s=75)
    with world.database.write() as session:
        for row in session.query(WorkerHeartbeat):
            row.lives_until -= timedelta(seconds=60)
    with world.database.read() as session:
        assert live_workers(session) == live_workers(session, Lane.RESCORE) == 1
    with world.database.write() as session:
        forget_worker(session, "young")
        assert live_workers(session) == 0


def test_a_cancelled_job_takes_no_place_in_the_queue(world: World) -> None:
    first, second = world.submit("first"), world.submit("second")
    with world.database.write() as session:
        withdraw(session, first.submission.id, actor="test")
        assert session.get_one(Job, first.job_id).state is WorkState.CANCELLED
    place = seen(world, second.submission.id).queue
    assert place is not None
    assert place.position == 0


def test_a_list_of_submissions_reads_the_board_of_their_phase_once(world: World) -> None:
    accepted = [world.submit(f"file {i}", f"method {i}") for i in range(3)]
    for one in accepted:
        world.score(one.job_id)
    ids = [one.submission.id for one in accepted]
    world.publish(world.board(*ids))
    bodies = []
    for _ in range(2):
        with statements(world.database) as sent, world.database.read() as session:
            found = views(session, [find_submission(session, each) for each in ids])
        assert [one.rank for one in found] == [1, 2, 3]
        bodies.append(len(of_board_texts(sent)))
    assert bodies == [1, 0], "a board never changes: its body is read once, whoever asks"
