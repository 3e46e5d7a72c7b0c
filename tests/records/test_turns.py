"""Teams take turns: one team's flood does not delay another's first file."""

from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.ringing import (
    due_jobs,
    hand_ring_over,
    mark_rung,
    outstanding,
    ring_due_jobs,
    ring_job,
)
from exceptiondrive_records.work.tables import Job
from exceptiondrive_records.work.turns import (
    TeamQueue,
    jobs_before,
    next_in_turn,
    served,
    team_queues,
    team_to_serve,
)
from exceptiondrive_schemas.jobs import Lane

World = Any
SETTINGS = RecordsSettings(window=4)
NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)


def at(seconds: float) -> datetime:
    return NOON + timedelta(seconds=seconds)


def queue(
    team_id: int, n_waiting: int, since_s: float, served_s: float | None = None, n_running: int = 0
) -> TeamQueue:
    served_at = None if served_s is None else at(served_s)
    return TeamQueue(team_id, n_running, n_waiting, at(since_s), served_at)


def simulated(queues: list[TeamQueue], slots: int, from_s: float = 1000) -> list[int]:
    """Teams in the order in which slots take their jobs; every job takes as long as any other."""
    by_team = {found.team_id: found for found in queues}
    order: list[int] = []
    running: list[int] = []
    while (team := team_to_serve(list(by_team.values()))) is not None:
        order.append(team.team_id)
        running.append(team.team_id)
        by_team[team.team_id] = served(team, at(from_s + len(order)))
        if len(running) == slots:
            done = by_team[running.pop(0)]
            by_team[done.team_id] = replace(done, n_running=done.n_running - 1)
    return order


def test_an_idle_team_comes_next_however_long_the_flood_waits() -> None:
    flood, quiet = queue(1, 150, since_s=0, served_s=900, n_running=2), queue(2, 1, since_s=950)
    assert team_to_serve([flood, quiet]) == quiet


def test_after_its_first_file_a_team_takes_turns_with_the_flood() -> None:
    flood, quiet = queue(1, 5, since_s=0, served_s=900), queue(2, 3, since_s=950)
    assert simulated([flood, quiet], slots=1) == [2, 1, 2, 1, 2, 1, 1, 1]


def test_many_teams_go_round_and_none_is_served_twice_before_all_were_once() -> None:
    queues = [queue(1, 30, since_s=0)] + [queue(team, 3, since_s=team) for team in range(2, 12)]
    order = simulated(queues, slots=1)
    assert Counter(order[:11]) == dict.fromkeys(range(1, 12), 1)
    assert Counter(order[:33]) == dict.fromkeys(range(1, 12), 3)
    assert order[33:] == [1] * 27


def test_a_team_that_was_served_long_ago_goes_before_one_served_just_now() -> None:
    assert (
        simulated([queue(1, 1, since_s=0, served_s=99), queue(2, 1, since_s=1, served_s=5)], 1)[0]
        == 2
    )


@given(
    st.lists(
        st.tuples(
            st.integers(1, 6),
            st.integers(0, 50),
            st.none() | st.integers(0, 900),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_the_place_that_a_team_is_told_is_the_place_it_gets(
    given_queues: list[tuple[int, int, int | None]],
) -> None:
    queues = [queue(i, *values) for i, values in enumerate(given_queues)]
    order = simulated(queues, slots=1)
    seen: Counter[int] = Counter()
    for position, team_id in enumerate(order):
        seen[team_id] += 1
        assert jobs_before(queues, queues[team_id], seen[team_id]) == position


def add_team(world: World, slug: str) -> int:
    with world.database.write() as session:
        return create_team(session, slug, slug.title(), actor="test").id


def flood(world: World, name: str, n: int, team_id: int | None = None) -> list[Any]:
    return [world.submit(f"{name}{i}", f"{name}{i}", team_id) for i in range(n)]


def take_next(world: World, without_splits: tuple[str, ...] = ()) -> Any:
    """What a worker does that was called: claim the job whose turn it is."""
    with world.database.write() as session:
        found = next_in_turn(session, SETTINGS.max_attempts, without_splits)
        if found is None:
            return None
        claim = jobs.claim(session, found.job_id, 120, SETTINGS.max_attempts)
        hand_ring_over(session, found)
        return claim


def method_of(world: World, claim: Any) -> str:
    with world.database.read() as session:
        return str(session.get_one(Submission, claim.submission_id).method)


def drained(world: World, slots: int = 1) -> list[str]:
    """The methods of all that waits, in the order in which so many slots take them."""
    order, running = [], []
    while (claim := take_next(world)) is not None:
        order.append(method_of(world, claim))
        running.append(claim)
        if len(running) == slots:
            world.finish(running.pop(0))
    return order


def test_the_first_file_of_an_idle_team_is_taken_next_after_a_flood(world: World) -> None:
    flood(world, "flood", 12)
    for _ in range(4):
        world.finish(take_next(world))
    flood(world, "quiet", 2, add_team(world, "beta"))
    assert drained(world)[:5] == ["quiet0", "flood4", "quiet1", "flood5", "flood6"]


def test_with_two_slots_no_team_holds_both_while_another_waits(world: World) -> None:
    flood(world, "flood", 6)
    flood(world, "quiet", 3, add_team(world, "beta"))
    order = drained(world, slots=2)
    assert order[:6] == ["flood0", "quiet0", "flood1", "quiet1", "flood2", "quiet2"]


def test_what_is_rung_already_does_not_go_first(world: World, broker: Any) -> None:
    flood(world, "flood", 9)
    take_next(world)
    bell = Doorbell(broker.url)
    assert ring_due_jobs(world.database, bell, SETTINGS, Lane.LIVE) == 4
    quiet = flood(world, "quiet", 1, add_team(world, "beta"))[0]
    claim = take_next(world)
    assert claim.job_id == quiet.job_id
    assert n_outstanding(world) == 3, "one message is used up, whoever it was sent for"
    bell.close()


def n_outstanding(world: World) -> int:
    with world.database.read() as session:
        return outstanding(session, Lane.LIVE)


def test_every_claim_uses_up_one_message_until_none_is_left(world: World) -> None:
    flood(world, "flood", 3)
    flood(world, "quiet", 3, add_team(world, "beta"))
    with world.database.write() as session:
        for due in due_jobs(session, Lane.LIVE, SETTINGS):
            mark_rung(session, due)
    left = []
    while take_next(world) is not None:
        left.append(n_outstanding(world))
    assert left == [3, 2, 1, 0, 0, 0]


def test_jobs_of_a_split_that_is_away_do_not_keep_others_waiting(world: World) -> None:
    away = world.submit("away")
    other = world.submit("here")
    with world.database.write() as session:
        session.get_one(Job, away.job_id).split_revision = "sha256:away"
    assert take_next(world, ("sha256:away",)).job_id == other.job_id
    assert take_next(world, ("sha256:away",)) is None


def test_withdrawn_and_waiting_retries_have_no_turn(world: World) -> None:
    first, second = world.submit("one"), world.submit("two")
    with world.database.write() as session:
        withdraw(session, first.submission.id, actor="test")
    claim = take_next(world)
    assert claim.job_id == second.job_id
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=True, backoff_s=60)
    assert take_next(world) is None
    with world.database.read() as session:
        assert [(found.n_waiting, found.n_running) for found in team_queues(session)] == [(0, 0)]


def test_an_upload_rings_while_there_is_room(world: World, broker: Any) -> None:
    bell = Doorbell(broker.url)
    accepted = flood(world, "f", 5)
    rung = [ring_job(world.database, bell, one.job_id, SETTINGS) for one in accepted]
    assert rung == [True, True, True, True, False]
    bell.close()
