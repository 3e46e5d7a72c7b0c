"""What the records tell of a rush after it: waits, turns and the queue over time. All pure.

`jobs` is a table of scoring runs: `team`, and when each was accepted (`created_at`), begun
(`leased_at`) and ended (`finished_at`).
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from benchmarks.load_traffic import FLOOD

_BARS = "▁▂▃▄▅▆▇█"


def spread(values: ArrayLike) -> tuple[str, str, str]:
    """Median, 99th percentile and largest."""
    of = np.asarray(values, dtype=np.float64)
    if len(of) < 2:
        return ("-", "-", "-")
    median, p99, most = np.quantile(of, [0.5, 0.99, 1.0])
    return (f"{median:.3f}", f"{p99:.3f}", f"{most:.3f}")


def waits_s(jobs: pd.DataFrame) -> "pd.Series[float]":
    """Seconds from acceptance to the score."""
    return (jobs.finished_at - jobs.created_at).dt.total_seconds()


def services_s(jobs: pd.DataFrame) -> "pd.Series[float]":
    """Seconds of the scoring runs themselves."""
    return (jobs.finished_at - jobs.leased_at).dt.total_seconds()


def first_files(jobs: pd.DataFrame) -> pd.DataFrame:
    """The first file of every team but the flooding one."""
    firsts = jobs.sort_values("created_at").drop_duplicates("team")
    return firsts[firsts.team != FLOOD]


def taken_before(jobs: pd.DataFrame, firsts: pd.DataFrame) -> pd.DataFrame:
    """How many jobs were begun while each of `firsts` waited: of `all` teams, of the `flood`."""
    pairs = firsts[["created_at", "leased_at"]].merge(jobs, how="cross", suffixes=("_first", ""))
    pairs["is_before"] = pairs.leased_at.between(
        pairs.created_at_first, pairs.leased_at_first, inclusive="neither"
    )
    pairs["is_of_flood"] = pairs.is_before & (pairs.team == FLOOD)
    found = pairs.groupby("created_at_first")[["is_before", "is_of_flood"]].sum()
    return found.set_axis(["all", "flood"], axis=1)


def queue_over_time(jobs: pd.DataFrame, n_points: int = 60) -> pd.DataFrame:
    """How many waited (`waiting`) and how long the oldest had (`oldest_s`), by second of the rush."""
    begin, end = jobs.created_at.min(), jobs.finished_at.max()
    found = {}
    for second in np.linspace(0, (end - begin).total_seconds(), n_points):
        at = begin + pd.Timedelta(seconds=second)
        waits = jobs[(jobs.created_at <= at) & (at < jobs.leased_at)]
        oldest_s = (at - waits.created_at.min()).total_seconds() if len(waits) else 0.0
        found[second] = {"waiting": len(waits), "oldest_s": oldest_s}
    return pd.DataFrame.from_dict(found, orient="index")


def chart(queue: pd.DataFrame) -> list[str]:
    """Two lines of bars: how many wait, and the age of the oldest."""
    return [
        f"waiting files  {_bars(list(queue.waiting))}  most {queue.waiting.max():.0f}",
        f"oldest waits   {_bars(list(queue.oldest_s))}  most {queue.oldest_s.max():.0f} s",
        f"               0 s{f'{queue.index[-1]:.0f} s':>{max(1, len(queue) - 3)}}",
    ]


def _bars(values: Sequence[float]) -> str:
    most = max(values) or 1.0
    return "".join(" " if v == 0 else _BARS[min(7, int(8 * v / most))] for v in values)
