"""The bootstrap for 10, 100, 200 and 1,000 entries, rank intervals, and one new entry."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.report import at_most, ms, note, show, times
from benchmarks.timing import Job, cpu_seconds, peak_mib, typical
from benchmarks.workload import SEED, Workload, make_workload
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.bootstrap import SceneSums, Uncertainty, bootstrap, scene_sums
from exceptiondrive_scoring.grade import SampleScores, grade
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.rank import rank_intervals

ENTRIES = (1, 10, 100, 200, 1000)
DISTINCT = 20
TARGET_ENTRIES = 200


def run(protocol: ProtocolDocument) -> None:
    """Print the bootstrap table."""
    workload = make_workload(protocol)
    sums = sums_of(workload, protocol)
    rows = []
    for n_entries in ENTRIES:
        job = partial(bootstrap_of, sums, n_entries, protocol)
        bootstrapping, measuring = _seconds(job, n_entries, workload, protocol)
        confidence = protocol.ranking.confidence
        ranking = cpu_seconds(partial(rank_intervals, job(), "descending", confidence))
        mib = peak_mib(job)
        if n_entries == TARGET_ENTRIES:
            what = f"bootstrap of {n_entries} entries"
            at_most(what, bootstrapping / measuring, 1 / 3, "x measuring them")
            at_most(what, mib, 100, "MiB")
        rows.append(
            (
                f"{n_entries:,}",
                ms(bootstrapping),
                ms(bootstrapping / n_entries),
                times(bootstrapping / measuring),
                ms(ranking),
                f"{mib:.0f}",
            )
        )
    show(
        f"Bootstrap: {protocol.ranking.bootstrap_draws:,} paired draws of {workload.split.n_scenes} "
        f"scenes, seven metrics, both aggregates and six families, N = {workload.split.n_samples:,}",
        ("entries", "ms", "ms an entry", "x measuring them", "rank intervals ms", "peak MiB"),
        rows,
    )
    note(
        "a new entry on a board costs the first row and its comparisons: kept draws of the others are "
        "reused"
    )


def sums_of(workload: Workload, protocol: ProtocolDocument) -> list[SceneSums]:
    """Return what some invented entries on the split of a workload add up to by scene."""
    split, rng = workload.split, np.random.default_rng(SEED)
    measured = measure(workload.pairs, split.prepared_regions, protocol.geometry)
    scores = grade(measured, split, protocol).only(PLANNING.interval_metrics)
    return [
        scene_sums(
            SampleScores(
                scores.metrics, scores.values * rng.uniform(0.7, 1.0, scores.values.shape)
            ),
            split,
            protocol.taxonomy,
        )
        for _ in range(DISTINCT)
    ]


def _entries(sums: list[SceneSums], n_entries: int) -> Iterator[SceneSums]:
    return (sums[index % DISTINCT] for index in range(n_entries))


def bootstrap_of(
    sums: list[SceneSums], n_entries: int, protocol: ProtocolDocument
) -> list[Uncertainty]:
    """Return the uncertainty of so many entries, which take the sums in turn."""
    entries = _entries(sums, n_entries)
    return list(bootstrap(entries, PLANNING, protocol.ranking, protocol.grading.headline))


def _seconds(
    job: Job, n_entries: int, workload: Workload, protocol: ProtocolDocument
) -> tuple[float, float]:
    """CPU seconds of the bootstrap and of measuring the same number of entries, side by side."""
    regions = workload.split.prepared_regions
    few = min(n_entries, DISTINCT)
    bootstrapping, measuring = [], []
    for _ in range(3 if n_entries >= TARGET_ENTRIES else 7):
        bootstrapping.append(cpu_seconds(job))
        seconds = [
            cpu_seconds(lambda: measure(workload.pairs, regions, protocol.geometry))
            for _ in range(few)
        ]
        measuring.append(sum(seconds) * n_entries / few)
    return typical(bootstrapping), typical(measuring)
