"""Fair share: one team's flood does not delay another's first file."""

import itertools
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete, select
from tests.support.fair_share import TeamQueue, served, team_to_serve

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.fair_share import (
    fair_order,
    is_live_job_waiting,
    is_live_work_open,
    jobs_ahead,
    waits,
)
from exceptiondrive_records.work.lease import new_item
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.jobs import Lane

World = Any
MAX_ATTEMPTS = 4
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


TEAMS = st.lists(
    st.tuples(
        st.integers(0, 3),  # running
        st.integers(1, 6),  # waiting
        st.integers(0, 50),  # oldest, s
        st.none() | st.integers(0, 900),  # served, s
    ),
    min_size=1,
    max_size=5,
)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(TEAMS)
def test_the_query_orders_all_that_waits_as_the_model_does(
    world: World, teams: list[tuple[int, int, int, int | None]]
) -> None:
    """What waits is also told its place by this query, so that each gets the place it is told."""
    world.submit("of all jobs", "of all jobs")
    with world.database.write() as session:
        session.execute(delete(Job))
        ids = [team_of(session, number) for number in range(len(teams))]
        numbers = itertools.count()
        for team_id, (n_running, n_waiting, since_s, served_s) in zip(ids, teams, strict=True):
            for _ in range(n_running):
                add_job(session, team_id, next(numbers), at(since_s), leased_at=at(served_s or 0))
            if served_s is not None:
                add_job(session, team_id, next(numbers), at(0), at(served_s), WorkState.DONE)
            for place in range(n_waiting):
                add_job(session, team_id, next(numbers), at(since_s + place))
        found = list(session.scalars(fair_order(waits(Lane.LIVE), Lane.LIVE)))
        firsts = fair_order(waits(Lane.LIVE), Lane.LIVE, firsts_alone=True)
        firsts_found = list(session.scalars(firsts))
        order = [session.get_one(Job, job_id).team_id for job_id in found]
        ages = [session.get_one(Job, job_id).created_at for job_id in found]
        running = sum(n_running for n_running, *_ in teams)
        ahead = jobs_ahead(session, [session.get_one(Job, job_id) for job_id in found])
        places = [ahead[job_id] for job_id in found]
    queues = [
        TeamQueue(
            team_id, n_running, n_waiting, at(since_s), at(served_s or 0)
            if n_running or served_s is not None else None,
        )
        for team_id, (n_running, n_waiting, since_s, served_s) in zip(ids, teams, strict=True)
    ]  # fmt: skip
    assert order == rounds(queues)
    assert firsts_found[0] == found[0], "a claim takes who comes first of all"
    assert len(firsts_found) == len(teams), "one of each team"
    for team_id in ids:
        mine = [age for age, owner in zip(ages, order, strict=True) if owner == team_id]
        assert mine == sorted(mine), "within a team the oldest first"
    assert places == list(range(running, running + len(found)))


def rounds(queues: list[TeamQueue]) -> list[int]:
    """The order when nothing ends meanwhile, and what is taken counts as served at one moment."""
    turns = [
        (found.n_running + place, found.served_at or at(-1e9), found.oldest_at, found.team_id)
        for found in queues
        for place in range(1, found.n_waiting + 1)
    ]
    return [turn[-1] for turn in sorted(turns)]


def team_of(session: Any, number: int) -> int:
    from exceptiondrive_records.teams.tables import Team

    slug = f"team-{number}"
    team = session.scalars(select(Team).where(Team.slug == slug)).first()
    return int((team or create_team(session, slug, slug.title(), actor="test")).id)


def add_job(
    session: Any,
    team_id: int,
    number: int,
    created_at: datetime,
    leased_at: datetime | None = None,
    state: WorkState | None = None,
    lane: Lane = Lane.LIVE,
) -> Job:
    job = new_item(
        Job,
        str(number),
        created_at,
        lane=lane,
        submission_id=session.scalars(select(Submission.id)).first(),
        team_id=team_id,
        protocol_digest=session.scalars(select(Phase.protocol_digest)).first(),
        split_revision="sha256:split",
        is_first=True,
    )
    if leased_at is not None:
        job.leased_at = leased_at
        job.state = state or WorkState.LEASED
        if state is None:
            job.lease_until = database_now(session) + timedelta(hours=1)
    session.add(job)
    session.flush()
    return job


def add_team(world: World, slug: str) -> int:
    with world.database.write() as session:
        return create_team(session, slug, slug.title(), actor="test").id


def flood(world: World, name: str, n: int, team_id: int | None = None) -> list[Any]:
    return [world.submit(f"{name}{i}", f"{name}{i}", team_id) for i in range(n)]


def take_next(world: World, *which: Any) -> Any:
    """What a worker does that was woken: claim the job that comes next."""
    with world.database.write() as session:
        return jobs.claim_job(session, Lane.LIVE, 120, MAX_ATTEMPTS, *which)


def method_of(world: World, job: Job) -> str:
    with world.database.read() as session:
        return str(session.get_one(Submission, job.submission_id).method)


def drained(world: World, slots: int = 1) -> list[str]:
    """The methods of all that waits, in the order in which so many slots take them."""
    order, running = [], []
    while (job := take_next(world)) is not None:
        order.append(method_of(world, job))
        running.append(job)
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


def test_slots_that_come_at_once_take_different_jobs_in_fair_order(world: World) -> None:
    flood(world, "flood", 20)
    quiet = flood(world, "quiet", 2, add_team(world, "beta"))
    with ThreadPoolExecutor(8) as pool:
        taken = list(pool.map(lambda _: take_next(world), range(8)))
    assert len({job.id for job in taken}) == 8, "each has one of its own"
    assert {job.job_id for job in quiet} <= {job.id for job in taken}
    while (job := take_next(world)) is not None:
        taken.append(job)
    assert len({job.id for job in taken}) == len(taken) == 22


def test_jobs_of_a_split_that_is_away_do_not_keep_others_waiting(world: World) -> None:
    away = world.submit("away")
    other = world.submit("here")
    with world.database.write() as session:
        session.get_one(Job, away.job_id).split_revision = "sha256:away"
    is_here = Job.split_revision.not_in(["sha256:away"])
    assert take_next(world, is_here).id == other.job_id
    assert take_next(world, is_here) is None


def test_withdrawn_held_and_waiting_retries_have_no_turn(world: World) -> None:
    first, second, third = (world.submit(name) for name in ("one", "two", "three"))
    with world.database.write() as session:
        withdraw(session, first.submission.id, actor="test")
        session.get_one(Job, third.job_id).state = WorkState.HELD
    job = take_next(world)
    assert job.id == second.job_id
    with world.database.write() as session:
        jobs.finish_failed(session, job, "internal", "We failed.", retry=True, backoff_s=60)
    assert take_next(world) is None


@pytest.mark.parametrize("state", [WorkState.QUEUED, WorkState.LEASED])
def test_what_runs_counts_for_its_team_only_while_its_lease_holds(
    world: World, state: WorkState
) -> None:
    flood(world, "flood", 2)
    busy = take_next(world)
    flood(world, "quiet", 1, add_team(world, "beta"))
    with world.database.write() as session:
        job = session.get_one(Job, busy.id)
        job.state, job.lease_until = state, job.lease_until.replace(year=2020)
    assert method_of(world, take_next(world)) == "quiet0", "it was never served"
    assert take_next(world).id == busy.id, "the oldest of its team"


def test_what_is_scored_anew_in_the_background_takes_no_turn_from_its_team(world: World) -> None:
    (mine,) = flood(world, "mine", 1)
    flood(world, "other", 1, add_team(world, "beta"))
    with world.database.write() as session:
        add_job(session, world.team_id, 1, at(0), database_now(session), lane=Lane.RESCORE)
    with world.database.read() as session:
        job = session.get_one(Job, mine.job_id)
        assert jobs_ahead(session, [job]) == {job.id: 0}
    assert method_of(world, take_next(world)) == "mine0"


@pytest.mark.parametrize(
    ("lane", "is_taken", "in_s", "waits_now", "is_open"),
    [
        (Lane.LIVE, False, -1, True, True),
        (Lane.LIVE, False, 60, False, False),  # it rests before it is tried again
        (Lane.LIVE, True, 60, False, True),
        (Lane.LIVE, True, -1, False, False),  # whoever scored it is gone
        (Lane.RESCORE, False, -1, False, False),
        (Lane.RESCORE, True, 60, False, False),
    ],
)
def test_the_background_gives_way_to_live_work_that_somebody_can_do_or_does(
    world: World, lane: Lane, is_taken: bool, in_s: float, waits_now: bool, is_open: bool
) -> None:
    world.submit("of the job", "of the job")
    with world.database.write() as session:
        session.execute(delete(Job))
        job = add_job(session, world.team_id, 1, at(0), at(0) if is_taken else None, lane=lane)
        time = database_now(session) + timedelta(seconds=in_s)
        if is_taken:
            job.lease_until = time
        else:
            job.available_at = time
    with world.database.read() as session:
        assert (is_live_job_waiting(session), is_live_work_open(session)) == (waits_now, is_open)
