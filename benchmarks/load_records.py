"""What the records tell of a rush after it: waits, turns and the queue over time. All pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median, quantiles

from benchmarks.load_traffic import FLOOD

_BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class ScoredJob:
    """One scoring run: whose, and when it was accepted, begun and ended."""

    team: str
    created_at: datetime
    leased_at: datetime
    finished_at: datetime


def spread(values: Sequence[float]) -> tuple[str, str, str]:
    """Median, 99th percentile and largest."""
    if len(values) < 2:
        return ("-", "-", "-")
    p99 = quantiles(values, n=100, method="inclusive")[98]
    return (f"{median(values):.3f}", f"{p99:.3f}", f"{max(values):.3f}")


def waits_s(jobs: Sequence[ScoredJob]) -> list[float]:
    """Seconds from acceptance to the score."""
    return [(job.finished_at - job.created_at).total_seconds() for job in jobs]


def services_s(jobs: Sequence[ScoredJob]) -> list[float]:
    """Seconds of the scoring runs themselves."""
    return [(job.finished_at - job.leased_at).total_seconds() for job in jobs]


def first_files(jobs: Sequence[ScoredJob]) -> list[ScoredJob]:
    """The first file of every team but the flooding one."""
    first: dict[str, ScoredJob] = {}
    for job in sorted(jobs, key=lambda found: found.created_at):
        first.setdefault(job.team, job)
    return [job for team, job in first.items() if team != FLOOD]


def taken_before(jobs: Sequence[ScoredJob], one: ScoredJob) -> tuple[int, int]:
    """How many jobs were begun while this one waited: of all teams, of the flooding one."""
    before = [job for job in jobs if one.created_at < job.leased_at < one.leased_at]
    return len(before), sum(job.team == FLOOD for job in before)


@dataclass(frozen=True)
class QueueAt:
    """The queue at one moment."""

    second: float
    waiting: int
    oldest_s: float


def queue_over_time(jobs: Sequence[ScoredJob], n_points: int = 60) -> list[QueueAt]:
    """How many waited and how long the oldest had, at evenly spaced moments of the whole rush."""
    begin = min(job.created_at for job in jobs)
    length_s = (max(job.finished_at for job in jobs) - begin).total_seconds()
    points = []
    for number in range(n_points):
        second = length_s * number / max(1, n_points - 1)
        at = begin + timedelta(seconds=second)
        ages = [(at - job.created_at).total_seconds() for job in jobs if _waits(job, at)]
        points.append(QueueAt(second, len(ages), max(ages, default=0.0)))
    return points


def chart(points: Sequence[QueueAt]) -> list[str]:
    """Two lines of bars: how many wait, and the age of the oldest."""
    end_s = points[-1].second
    waiting = [float(point.waiting) for point in points]
    oldest = [point.oldest_s for point in points]
    return [
        f"waiting files  {_bars(waiting)}  most {max(waiting):.0f}",
        f"oldest waits   {_bars(oldest)}  most {max(oldest):.0f} s",
        f"               0 s{f'{end_s:.0f} s':>{max(1, len(points) - 3)}}",
    ]


def _waits(job: ScoredJob, at: datetime) -> bool:
    return job.created_at <= at < job.leased_at


def _bars(values: Sequence[float]) -> str:
    most = max(values) or 1.0
    return "".join(" " if v == 0 else _BARS[min(7, int(8 * v / most))] for v in values)
