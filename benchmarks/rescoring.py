"""Rescoring 1,000 stored submissions: new d_safe (no geometry), new geometry (no uploads)."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.report import note, show, times
from benchmarks.timing import Job, interleave, ratio, typical
from benchmarks.workload import SEED, Workload, make_workload
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.sheet import aggregate
from exceptiondrive_worker.private_store import PrivateStore, Shelf

SUBMISSIONS = 1000
DISTINCT = 50
"""Different submissions; each stands for twenty of the thousand."""

Load = Callable[[int], Columns]


def run(protocol: ProtocolDocument) -> None:
    """Print the rescoring table."""
    workload = make_workload(protocol)
    submissions = _submissions(workload)
    measured = [
        measure(pairs, workload.split.prepared_regions, protocol.geometry) for pairs in submissions
    ]
    with tempfile.TemporaryDirectory() as folder:
        store = PrivateStore(Path(folder))
        for index, (pairs, measurements) in enumerate(zip(submissions, measured, strict=True)):
            store.write_columns(Shelf.ANSWERS, str(index), pairs.columns())
            store.write_columns(Shelf.MEASUREMENTS, str(index), measurements.columns())
        _compare(
            "arrays at hand",
            lambda index: submissions[index].columns(),
            lambda index: measured[index].columns(),
            workload,
            protocol,
        )
        _compare(
            "from the worker's private store (file read, SHA-256 verified)",
            lambda index: _kept(store, Shelf.ANSWERS, index),
            lambda index: _kept(store, Shelf.MEASUREMENTS, index),
            workload,
            protocol,
        )
    note("target: regrading at least 50x faster than measuring again")


def _submissions(workload: Workload) -> list[TrajectoryPairs]:
    rng = np.random.default_rng(SEED)
    pairs = workload.pairs
    return [
        TrajectoryPairs(
            pairs.source,
            pairs.edited * rng.uniform(0.8, 1.1),
            pairs.source_given,
            pairs.edited_given,
        )
        for _ in range(DISTINCT)
    ]


def _kept(store: PrivateStore, shelf: Shelf, index: int) -> Columns:
    columns = store.read_columns(shelf, str(index))
    if columns is None:
        raise SystemExit("the benchmark's own store lost a file")
    return columns


def _compare(
    title: str, answers: Load, measurements: Load, workload: Workload, protocol: ProtocolDocument
) -> None:
    split, taxonomy = workload.split, protocol.taxonomy
    wider = protocol.geometry.model_copy(update={"footprint_width_m": 2.0})
    doubled = protocol.model_copy(
        update={"grading": protocol.grading.model_copy(update={"d_safe_scale": 2.0})}
    )

    def measure_again(index: int) -> None:
        pairs = TrajectoryPairs.from_columns(answers(index))
        _sheet(measure(pairs, split.prepared_regions, wider), split, protocol, taxonomy)

    def regrade(index: int) -> None:
        _sheet(Measurements.from_columns(measurements(index)), split, doubled, taxonomy)

    found = interleave({"new geometry": _all(measure_again), "new d_safe": _all(regrade)}, rounds=5)
    scale = SUBMISSIONS / DISTINCT
    slow, fast = found["new geometry"], found["new d_safe"]
    rows = [
        (
            name,
            f"{typical(seconds) * scale:.2f}",
            f"{SUBMISSIONS / (typical(seconds) * scale):,.0f}",
            times(ratio(slow, seconds)),
        )
        for name, seconds in (
            ("(b) new geometry: measure, grade, aggregate", slow),
            ("(a) new d_safe: grade, aggregate", fast),
        )
    ]
    show(f"Rescoring {SUBMISSIONS:,} submissions, {title}", ("", "s", "per second", "x (b)"), rows)


def _all(one: Callable[[int], None]) -> Job:
    def run() -> None:
        for index in range(DISTINCT):
            one(index)

    return run


def _sheet(
    measured: Measurements, split: SplitArrays, protocol: ProtocolDocument, taxonomy: Taxonomy
) -> None:
    aggregate(grade(measured, split, protocol), split, taxonomy)
