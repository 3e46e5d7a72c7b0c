"""Rescoring 1,000 stored submissions: new d_safe (no geometry), new geometry (no uploads).

A third row shows what batches would give: several submissions graded and summed as one long one, with
the same bits. Nothing else uses them: a job takes many times as long as its grading (docs/performance.md).
"""

import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import note, show, times
from benchmarks.timing import Job, interleave, ratio, typical
from benchmarks.workload import SEED, Workload, make_workload
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import Columns, IntArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.sheet import Breakdown, aggregate
from exceptiondrive_worker.splits.private_store import PrivateStore, Shelf

SUBMISSIONS = 1000
AT_ONCE = 5
"""Submissions of a batch; 2, 10 and 25 were slower still."""
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

    batch = _Batch(split, doubled)

    def regrade_batches() -> None:
        for start in range(0, DISTINCT, AT_ONCE):
            some = range(start, start + AT_ONCE)
            batch.breakdowns([Measurements.from_columns(measurements(index)) for index in some])

    batch.require_same_bits(
        Measurements.from_columns(measurements(index)) for index in range(AT_ONCE)
    )
    jobs = {"new geometry": _all(measure_again), "new d_safe": _all(regrade)}
    found = interleave({**jobs, "in batches": regrade_batches}, rounds=5)
    scale = SUBMISSIONS / DISTINCT
    slow = found["new geometry"]
    rows = [
        (
            name,
            f"{typical(seconds) * scale:.2f}",
            f"{SUBMISSIONS / (typical(seconds) * scale):,.0f}",
            times(ratio(slow, seconds)),
        )
        for name, seconds in (
            ("(b) new geometry: measure, grade, aggregate", slow),
            ("(a) new d_safe: grade, aggregate", found["new d_safe"]),
            (f"(a) in batches of {AT_ONCE}", found["in batches"]),
        )
    ]
    show(f"Rescoring {SUBMISSIONS:,} submissions, {title}", ("", "s", "per second", "x (b)"), rows)


class _Batch:
    """Several submissions, one behind the other, as one whose tasks and families are its own."""

    def __init__(self, split: SplitArrays, protocol: ProtocolDocument) -> None:
        self._one, self._protocol = split, protocol
        taxonomy = protocol.taxonomy
        numbers = range(AT_ONCE)
        self._split = SplitArrays(
            regions_m=np.tile(split.regions_m, (AT_ONCE, 1, 1)),
            task_index=_apart(split.task_index, len(taxonomy.tasks)),
            family_index=_apart(split.family_index, len(taxonomy.families)),
            scene_index=_apart(split.scene_index, split.n_scenes),
            n_scenes=split.n_scenes * AT_ONCE,
            d_safe_m=np.tile(split.d_safe_m, AT_ONCE),
            acceptable=np.tile(split.acceptable, (AT_ONCE, 1)),
        )
        self._taxonomy = Taxonomy.model_construct(
            families=tuple(
                family.model_copy(update={"id": f"{number}.{family.id}"})
                for number in numbers
                for family in taxonomy.families
            ),
            tasks=tuple(
                task.model_copy(update={"id": f"{number}.{task.id}"})
                for number in numbers
                for task in taxonomy.tasks
            ),
        )

    def breakdowns(self, measured: Sequence[Measurements]) -> Breakdown:
        """Grade and aggregate them; the rows of each carry its number. Only its total is still to be made."""
        given = [each.columns() for each in measured]
        columns = {name: np.concatenate([each[name] for each in given]) for name in given[0]}
        scores = grade(Measurements.from_columns(columns), self._split, self._protocol)
        return aggregate(scores, self._split, self._taxonomy)

    def require_same_bits(self, measured: Iterable[Measurements]) -> None:
        """Compare every row with that of the single way.

        Raises:
            SystemExit: One differs.
        """
        submissions = list(measured)
        found = self.breakdowns(submissions)
        for number, each in enumerate(submissions):
            scores = grade(each, self._one, self._protocol)
            alone = aggregate(scores, self._one, self._protocol.taxonomy)
            for rows, of_all in ((alone.families, found.families), (alone.tasks, found.tasks)):
                if any(row != of_all[f"{number}.{key}"] for key, row in rows.items()):
                    raise SystemExit("a batch does not give the bits of its submissions")


def _apart(index: IntArray, n: int) -> IntArray:
    return np.concatenate([index + number * n for number in range(AT_ONCE)])


def _all(one: Callable[[int], None]) -> Job:
    def run() -> None:
        for index in range(DISTINCT):
            one(index)

    return run


def _sheet(
    measured: Measurements, split: SplitArrays, protocol: ProtocolDocument, taxonomy: Taxonomy
) -> None:
    aggregate(grade(measured, split, protocol), split, taxonomy)
