"""Measure and grade: naive shapely loop, vectorised shapely, our kernel, roofline estimate."""

import gzip
import json
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.naive import naive_clearances_m, vectorised_clearances_m
from benchmarks.report import at_least, ms, note, show, times
from benchmarks.timing import Rounds, cpu_seconds, interleave, ratio, repeated, typical
from benchmarks.workload import Workload, make_workload
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring import clearance, convex_distance
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs, split_arrays
from exceptiondrive_scoring.footprint import Footprints
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.region import prepare_regions
from exceptiondrive_scoring.sheet import aggregate

REALDATA = Path(__file__).parents[2] / "shared" / "realdata" / "nuscenes-real"
NAIVE_SAMPLES = 400
FLOPS_PER_CORNER = 16
"""Bounds: a region corner in a footprint's frame, and its distance from the rectangle."""
FLOPS_PER_PAIR = 96 * 14 + 16 * 30
"""Exact distance: 96 pairs of edge and point, 16 edges with the extent of two rectangles."""


def run(protocol: ProtocolDocument) -> None:
    """Print the measuring tables, on the seeded workload and on a real planner's file."""
    _compare("seeded workload", make_workload(protocol), protocol)
    if REALDATA.is_dir():
        _compare(
            "real planner file, claude-3.7-sonnet", _real("claude-3.7-sonnet", protocol), protocol
        )
    else:
        note("real planner files: not beside this repository, left out")


def _real(name: str, protocol: ProtocolDocument) -> Workload:
    split = Split.model_validate_json(gzip.decompress((REALDATA / "split.json.gz").read_bytes()))
    file = json.loads(gzip.decompress((REALDATA / f"{name}.json.gz").read_bytes()))
    answers = sorted(file["predictions"], key=lambda answer: str(answer["sample_id"]))
    missing = [[np.nan] * 2] * protocol.geometry.waypoints
    columns = {
        key: np.array([answer[key] or missing for answer in answers])
        for key in ("source", "edited")
    }
    return Workload(
        TrajectoryPairs.from_columns(columns), split_arrays(split.samples, protocol.taxonomy)
    )


def _compare(title: str, workload: Workload, protocol: ProtocolDocument) -> None:
    pairs, split, geometry = workload.pairs, workload.split, protocol.geometry
    edited = np.nan_to_num(pairs.edited)
    points, regions = np.insert(edited, 0, 0.0, axis=1), split.prepared_regions
    part = slice(0, NAIVE_SAMPLES)
    measured = measure(pairs, regions, geometry)
    jobs = {
        "naive": lambda: naive_clearances_m(edited[part], split.regions_m[part], geometry),
        "vectorised": lambda: vectorised_clearances_m(edited, split.regions_m, geometry),
        "kernel": repeated(lambda: clearance.clearance_m(points, regions, geometry), 3),
        "measure": repeated(lambda: measure(pairs, regions, geometry), 3),
        "score": repeated(lambda: _grade(measure(pairs, regions, geometry), workload, protocol), 3),
        "grade": repeated(lambda: _grade(measured, workload, protocol), 20),
        "prepare": repeated(lambda: prepare_regions(split.regions_m), 3),
    }
    found = interleave(jobs, rounds=9)
    scaled = _per_run(found, split.n_samples)
    floor = _roofline_s(points, workload, protocol)
    naive = scaled["naive"]
    names = {
        "naive": "naive shapely loop (hulls, union, intersects, distance)",
        "vectorised": "vectorised shapely (hulls as multipolygon, distance)",
        "kernel": "our kernel: clearance of all samples",
        "measure": "measure: clearance, intrusion, shift, motion",
        "score": "measure + grade + aggregate",
        "grade": "grade + aggregate alone",
        "prepare": "regions into convex pieces (once per split)",
    }
    rows = [
        (
            text,
            ms(typical(scaled[key])),
            times(ratio(naive, scaled[key])),
            times(typical(scaled[key]) / floor),
        )
        for key, text in names.items()
    ]
    rows.append(
        (
            "roofline estimate of the pruned arithmetic",
            ms(floor),
            times(typical(naive) / floor),
            "1",
        )
    )
    unsafe = float(np.mean(measured.intrusion))
    show(
        f"Measure, {title}: N = {split.n_samples:,}, UR {unsafe:.1%}",
        ("", "ms", "x naive", "x roofline"),
        rows,
    )
    at_least(f"measure, {title}", ratio(naive, scaled["measure"]), 150, "x the naive loop")


def _grade(measured: Measurements, workload: Workload, protocol: ProtocolDocument) -> None:
    aggregate(grade(measured, workload.split, protocol), workload.split, protocol.taxonomy)


def _per_run(found: Rounds, n_samples: int) -> Rounds:
    """Seconds for one submission: the naive loop ran a part, the short jobs ran several times."""
    factor = {"naive": n_samples / NAIVE_SAMPLES, "vectorised": 1.0, "grade": 1 / 20}
    return {name: [t * factor.get(name, 1 / 3) for t in seconds] for name, seconds in found.items()}


def _roofline_s(points: FloatArray, workload: Workload, protocol: ProtocolDocument) -> float:
    """Arithmetic that the pruned method needs, at the rate of the machine's matrix product."""
    n_pairs = 0
    exact = convex_distance.hull_distance_m

    def counting(a: Footprints, b: Footprints, x: FloatArray, y: FloatArray) -> FloatArray:
        nonlocal n_pairs
        n_pairs += x.shape[1]
        return exact(a, b, x, y)

    regions = workload.split.prepared_regions
    with patch.object(clearance, "hull_distance_m", counting):
        clearance.clearance_m(points, regions, protocol.geometry)
    n_corners = int(points.shape[1] * regions.x_m.size)
    flops = n_corners * FLOPS_PER_CORNER + n_pairs * FLOPS_PER_PAIR
    rate = _flops_per_second()
    note(
        f"pairs that need an exact distance: {n_pairs:,} of "
        f"{(points.shape[1] - 1) * len(regions.sample):,}; {flops / 1e6:.1f} Mflop at "
        f"{rate / 1e9:.0f} Gflop/s (float64 matrix product of this machine, one thread)"
    )
    return flops / rate


def _flops_per_second() -> float:
    n = 500
    matrix = np.random.default_rng(0).random((n, n))
    best = min(cpu_seconds(lambda: np.matmul(matrix, matrix)) for _ in range(10))
    return 2 * n * n * n / best
