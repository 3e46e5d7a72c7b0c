"""Rescoring 1,000 stored submissions: new d_safe (no geometry), new geometry (no uploads).

Both ways run the worker's own stages, and differ in the protocol alone: of new clearances they find
what is settled in the private store, of a new geometry they find answers, measure, and keep the results.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.report import at_least, show, times
from benchmarks.timing import Job, interleave, ratio, typical
from benchmarks.workload import SEED, make_workload
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.challenge import graded_breakdown, scoring_of, settle
from exceptiondrive_worker.splits.private_store import PrivateStore, array_digest
from exceptiondrive_worker.splits.store import LoadedSplit
from exceptiondrive_worker.stages import Stages, Target

SUBMISSIONS = 1000
DISTINCT = 50
"""Different submissions; each stands for twenty of the thousand."""
ROUNDS = 7


def run(protocol: ProtocolDocument) -> None:
    """Print the rescoring tables."""
    split, answers = _workload(protocol)
    scoring, arrays, ref = scoring_of(PLANNING.id), split.arrays, split.manifest.ref
    geometries, clearances = _geometries(protocol), _clearances(protocol)
    settled = [
        settle(scoring, scoring.measure(each, arrays, protocol.geometry), arrays, ref, protocol)
        for each in answers
    ]

    def measure_at_hand(index: int, new: ProtocolDocument) -> None:
        measured = scoring.measure(answers[index], arrays, new.geometry)
        graded_breakdown(scoring, settle(scoring, measured, arrays, ref, new), arrays, new)

    def regrade_at_hand(index: int, new: ProtocolDocument) -> None:
        graded_breakdown(scoring, settled[index], arrays, new)

    at_hand = _show(
        "arrays at hand: metrics of every row",
        _all(measure_at_hand, geometries),
        _all(regrade_at_hand, clearances),
    )
    at_least("regrade, arrays at hand", at_hand, 50, "x measuring again")
    with tempfile.TemporaryDirectory() as folder:
        uploads = {array_digest(*each.values()): each for each in answers}
        stages = Stages(
            PrivateStore(Path(folder)), str.encode, lambda data, *_: uploads.pop(data.decode())
        )  # each is read once
        targets = [Target(digest, PLANNING, split, protocol) for digest in uploads]
        for target in targets:
            stages.score(target)

        def grade(index: int, new: ProtocolDocument) -> None:
            kept = stages.settled(replace(targets[index], protocol=new))
            graded_breakdown(scoring, kept, arrays, new)

        def score(index: int, new: ProtocolDocument) -> None:
            _ = stages.score(replace(targets[index], protocol=new)).digest

        over_store = _show(
            "over the private store: metrics of every row",
            _all(grade, geometries),
            _all(grade, clearances),
        )
        at_least("regrade, over the private store", over_store, 30, "x measuring again")
        _show(
            "over the private store: whole sheets, signed",
            _all(score, geometries),
            _all(score, clearances),
        )


def _workload(protocol: ProtocolDocument) -> tuple[LoadedSplit, list[Columns]]:
    """One split, and different answers to it."""
    workload = make_workload(protocol)
    arrays, rng = workload.split, np.random.default_rng(SEED)
    _ = arrays.prepared_regions
    split = LoadedSplit(
        manifest=Manifest(
            schema_="exceptiondrive.manifest/1",
            name="workload",
            title="Workload",
            revision=f"sha256:{SEED:064}",
            waypoints=protocol.geometry.waypoints,
            time_step_s=protocol.geometry.time_step_s,
            sample_ids=tuple(f"s{number:06}" for number in range(arrays.n_samples)),
        ),
        arrays=arrays,
        samples_digest="samples",
        regions_digest=array_digest(arrays.regions_m),
        grading_digest="grading",
        scenes_digest="scenes",
    )
    source, edited = workload.pairs.source, workload.pairs.edited
    return split, [
        {"source": source, "edited": edited * rng.uniform(0.8, 1.1)} for _ in range(DISTINCT)
    ]


def _geometries(protocol: ProtocolDocument) -> Iterator[ProtocolDocument]:
    """Protocols of other footprints without end, each once."""
    for number in count(1):
        wider = {"footprint_width_m": protocol.geometry.footprint_width_m + number / 1000}
        geometry = protocol.geometry.model_copy(update=wider)
        yield protocol.model_copy(update={"geometry": geometry})


def _clearances(protocol: ProtocolDocument) -> Iterator[ProtocolDocument]:
    """Protocols of other required clearances without end, each once."""
    for number in count(1):
        grading = protocol.grading.model_copy(update={"d_safe_scale": 1 + number / 100})
        yield protocol.model_copy(update={"grading": grading})


def _all(
    one: Callable[[int, ProtocolDocument], None], protocols: Iterator[ProtocolDocument]
) -> Job:
    """All submissions under the next protocol."""

    def run() -> None:
        new = next(protocols)
        for index in range(DISTINCT):
            one(index, new)

    return run


def _show(title: str, measure: Job, regrade: Job) -> float:
    """Print one comparison; return how many times faster regrading is."""
    found = interleave({"measure": measure, "regrade": regrade}, ROUNDS)
    scale = SUBMISSIONS / DISTINCT
    rows = [
        (
            name,
            f"{typical(found[job]) * scale:.2f}",
            f"{SUBMISSIONS / (typical(found[job]) * scale):,.0f}",
            times(ratio(found["measure"], found[job])),
        )
        for name, job in (("(b) new geometry", "measure"), ("(a) new d_safe", "regrade"))
    ]
    show(f"Rescoring {SUBMISSIONS:,} submissions, {title}", ("", "s", "per second", "x (b)"), rows)
    return ratio(found["measure"], found["regrade"])
