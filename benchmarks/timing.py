"""Timing: candidates take turns in one process, and ratios are taken round by round.

Times are CPU seconds of one thread. On a shared machine absolute times wobble by a factor of two;
the ratio of two candidates that ran next to each other wobbles far less. Quote ratios.
"""

import gc
import time
import tracemalloc
from collections.abc import Callable, Mapping
from statistics import median

Job = Callable[[], object]
Rounds = dict[str, list[float]]


def interleave(jobs: Mapping[str, Job], rounds: int) -> Rounds:
    """Run every job once a round, in turn, and once before; CPU seconds by job."""
    for job in jobs.values():
        job()
    times: Rounds = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            times[name].append(cpu_seconds(job))
    return times


def cpu_seconds(job: Job) -> float:
    """CPU seconds of one run, of all threads of this process."""
    gc.collect()  # so that nobody pays for the litter of the one before
    start = time.process_time()
    job()
    return time.process_time() - start


def typical(times: list[float]) -> float:
    """Median."""
    return median(times)


def ratio(slower: list[float], faster: list[float]) -> float:
    """Median of the ratios of runs that stood next to each other."""
    return median(s / f for s, f in zip(slower, faster, strict=True))


def repeated(job: Job, times: int) -> Job:
    """Run a short job several times, so that the clock can tell."""

    def run() -> None:
        for _ in range(times):
            job()

    return run


def peak_mib(job: Job) -> float:
    """Most memory that the job held at once beyond what was there before, as allocated."""
    job()
    tracemalloc.start()
    try:
        job()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
