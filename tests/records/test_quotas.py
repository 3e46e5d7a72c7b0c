"""A quota of n admits exactly n, whoever asks at the same time."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import timedelta
from itertools import repeat
from typing import Any

import pytest
from sqlalchemy import select, update
from tests.support.forked import FORKS

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import (
    ConcurrentQuotaExceeded,
    Conflict,
    QuotaExceeded,
    RejectedCapExceeded,
)
from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.submissions import accept, withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work import jobs
from exceptiondrive_schemas.api.submission import Quota, SubmissionStatus
from exceptiondrive_schemas.faults import CheckReport

World = Any
N_AT_ONCE = 32
QUOTA = 5


def quota(world: World) -> Quota:
    with world.database.read() as session:
        return quota_of(session, world.team_id, find_phase(session, "dev"))


def try_to_submit(database: Database, team_id: int, number: int) -> str:
    try:
        with database.write() as session:
            accepted = accept(
                session,
                team_id=team_id,
                phase_id="dev",
                method="method",
                file_digest=f"sha256:{number:064}",
                size_bytes=1,
            )
    except QuotaExceeded:
        return "refused"
    return accepted.submission.id


def submit_all(url: str, team_id: int, numbers: range) -> list[str]:
    database = Database(url)
    return [try_to_submit(database, team_id, number) for number in numbers]


def submit_in_processes(url: str, shares: Sequence[tuple[int, range]]) -> list[list[str]]:
    """Let processes of their own send the files of teams; none begins before all have started."""
    urls, teams, numbers = repeat(url), *zip(*shares, strict=True)
    all_are_there = FORKS.Barrier(len(shares))
    with ProcessPoolExecutor(len(shares), FORKS, all_are_there.wait) as pool:
        return list(pool.map(submit_all, urls, teams, numbers))


def must_admit_exactly_the_quota(world: World, outcomes: list[str]) -> None:
    assert len(outcomes) == N_AT_ONCE
    assert outcomes.count("refused") == N_AT_ONCE - QUOTA
    with world.database.read() as session:
        assert session.query(Submission).count() == QUOTA
    assert quota(world).remaining_today == 0


def test_a_quota_admits_exactly_its_number_under_parallel_threads(
    make_world: Callable[..., World],
) -> None:
    world = make_world(quota_per_day=QUOTA)
    with ThreadPoolExecutor(N_AT_ONCE) as pool:
        outcomes = list(
            pool.map(
                lambda number: try_to_submit(world.database, world.team_id, number),
                range(N_AT_ONCE),
            )
        )
    must_admit_exactly_the_quota(world, outcomes)


@pytest.mark.row("I20")
def test_a_quota_admits_exactly_its_number_under_parallel_processes(
    make_world: Callable[..., World], database_url: str
) -> None:
    world = make_world(quota_per_day=QUOTA)
    shares = [(world.team_id, range(start, N_AT_ONCE, 4)) for start in range(4)]
    told = submit_in_processes(database_url, shares)
    must_admit_exactly_the_quota(world, [outcome for outcomes in told for outcome in outcomes])


@pytest.mark.row("I20")
def test_of_many_teams_at_once_each_has_its_own_quota(
    make_world: Callable[..., World], database_url: str
) -> None:
    world = make_world(quota_per_day=QUOTA)
    with world.database.write() as session:
        teams = [create_team(session, f"t{n}", f"Team {n}", actor="test").id for n in range(4)]
    shares = [(team, range(100 * n, 100 * n + 8)) for n, team in enumerate(teams)]
    told = submit_in_processes(database_url, shares)
    assert [lines.count("refused") for lines in told] == [8 - QUOTA] * len(teams)
    with world.database.read() as session:
        of_teams = session.scalars(select(Submission.team_id)).all()
    assert Counter(of_teams) == dict.fromkeys(teams, QUOTA)


def test_parallel_copies_of_one_file_are_one_submission(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=QUOTA)
    with ThreadPoolExecutor(20) as pool:
        ids = set(pool.map(lambda _: try_to_submit(world.database, world.team_id, 1), range(20)))
    assert len(ids) == 1
    assert quota(world).used_today == 1


def test_the_refusal_says_when_the_quota_begins_anew(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=1)
    world.submit("one")
    with pytest.raises(QuotaExceeded, match="00:00 UTC") as refused:
        world.submit("two")
    assert refused.value.resets_at == quota(world).resets_at


def test_the_quota_of_yesterday_does_not_count_today(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=1)
    first = world.submit("one").submission
    with world.database.write() as session:
        yesterday = first.received_at - timedelta(days=1)
        session.execute(update(Submission).values(received_at=yesterday))
    world.submit("two")
    assert (quota(world).used_today, quota(world).used_total) == (1, 2)


def test_the_total_quota_holds_over_days(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=5)
    world.submit("one")
    with world.database.write() as session:
        session.execute(update(Phase).values(quota_total=1))
        session.execute(update(Submission).values(received_at=Submission.status_at))
    with pytest.raises(QuotaExceeded, match="its 1 submission of this phase") as refused:
        world.submit("two")
    assert refused.value.resets_at is None


def reject(world: World, content: str) -> None:
    report = CheckReport(
        challenge=None, split=None, n_predictions=None, digest="sha256:x", size_bytes=1
    )
    claim = world.claim(world.submit(content).job_id)
    with world.database.write() as session:
        jobs.finish_rejected(session, claim, report)


def test_rejected_files_cost_no_quota_but_are_capped(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=2, rejected_per_day=3)
    for i in range(3):
        reject(world, f"wrong {i}")
    assert (quota(world).used_today, quota(world).rejected_today) == (0, 3)
    with pytest.raises(RejectedCapExceeded, match="exceptiondrive check"):
        world.submit("right at last")


def test_wrong_files_sent_all_at_once_stay_within_their_cap(
    make_world: Callable[..., World],
) -> None:
    """None of 24 is known to be wrong while they come: 13 to 16 were taken with a cap of 4."""
    world = make_world(quota_per_day=24, rejected_per_day=4)

    def submit(number: int) -> str | None:
        try:
            job_id: str | None = world.submit(f"wrong {number}").job_id
        except ConcurrentQuotaExceeded:
            return None
        return job_id

    with ThreadPoolExecutor(24) as pool:
        jobs_of_files = [job for job in pool.map(submit, range(24)) if job is not None]
    assert len(jobs_of_files) == 4
    for job in jobs_of_files:
        report = CheckReport(
            challenge=None, split=None, n_predictions=None, digest="sha256:x", size_bytes=1
        )
        claim = world.claim(job)
        with world.database.write() as session:
            jobs.finish_rejected(session, claim, report)
    assert quota(world).rejected_today == 4
    with pytest.raises(RejectedCapExceeded):
        world.submit("one more")


def test_what_waits_makes_room_as_it_is_scored(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=24, rejected_per_day=2)
    first = world.submit("one")
    world.submit("two")
    with pytest.raises(ConcurrentQuotaExceeded, match="2 submissions wait"):
        world.submit("three")
    world.score(first.job_id)
    assert not world.submit("three").is_duplicate


def test_our_own_failures_cost_no_quota(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=1)
    claim = world.claim(world.submit("one").job_id)
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)
    assert not world.submit("two").is_duplicate


def fail(world: World, content: str) -> str:
    accepted = world.submit(content)
    submission_id: str = accepted.submission.id
    claim = world.claim(accepted.job_id)
    with world.database.write() as session:
        jobs.finish_failed(session, claim, "split_day_full", "Later.", retry=False)
    return submission_id


def test_what_fails_counts_among_the_files_of_a_day_without_a_score(
    make_world: Callable[..., World],
) -> None:
    world = make_world(quota_per_day=5, rejected_per_day=2)
    reject(world, "wrong")
    fail(world, "right")
    assert (quota(world).used_today, quota(world).rejected_today) == (0, 2)
    told = (
        "2 files of your team .* limit; faulty ones count, and sound ones that could not be scored"
    )
    with pytest.raises(RejectedCapExceeded, match=told):
        world.submit("one more")


@pytest.mark.parametrize("limits", [{"quota_per_day": 2}, {"quota_per_day": 9, "quota_total": 2}])
def test_what_failed_is_tried_again_only_within_the_quota(
    make_world: Callable[..., World], limits: dict[str, int]
) -> None:
    world = make_world(**limits)
    first, second, third = (fail(world, content) for content in ("one", "two", "three"))
    with world.database.write() as session:
        retry_submission(session, first, actor="test")
        retry_submission(session, third, actor="test")
    assert quota(world).remaining_today == 0
    with (
        world.database.write() as session,
        pytest.raises(Conflict, match="give the team an allowance"),
    ):
        retry_submission(session, second, actor="test")
    with world.database.write() as session:
        given: dict[str, Any] = {
            "quota_per_day": 3,
            "quota_total": 3,
            "reason": "it was ours",
            "actor": "test",
        }
        set_allowance(session, "alpha", "dev", **given)
        retry_submission(session, second, actor="test")
    assert quota(world).used_total == 3


def test_a_withdrawn_submission_stays_counted(make_world: Callable[..., World]) -> None:
    world = make_world(quota_per_day=1)
    first = world.submit("one").submission
    with world.database.write() as session:
        withdraw(session, first.id, actor="test")
    with world.database.read() as session:
        assert session.get(Submission, first.id).status is SubmissionStatus.WITHDRAWN
    with pytest.raises(QuotaExceeded):
        world.submit("two")


def test_only_so_many_of_a_team_may_wait_at_once(make_world: Callable[..., World]) -> None:
    world = make_world(quota_concurrent=2)
    first = world.submit("one")
    world.submit("two")
    assert (quota(world).concurrent, quota(world).waiting) == (2, 2)
    with pytest.raises(ConcurrentQuotaExceeded, match="2 submissions wait"):
        world.submit("three")
    assert world.submit("two").is_duplicate
    world.score(first.job_id)
    assert quota(world).waiting == 1
    assert not world.submit("three").is_duplicate


def test_the_limit_of_waiting_ones_is_exact_under_parallel_threads(
    make_world: Callable[..., World],
) -> None:
    world = make_world(quota_concurrent=3)

    def submit(number: int) -> bool:
        try:
            world.submit(f"file {number}")
        except ConcurrentQuotaExceeded:
            return False
        return True

    with ThreadPoolExecutor(30) as pool:
        assert sum(pool.map(submit, range(30))) == 3
    assert quota(world).waiting == 3
