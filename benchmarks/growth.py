"""How cost grows: with the number of samples, of waypoints, and of scenes that are drawn.

A sheet is all that follows from measurements; of new clearances, what they change of it.
"""

from functools import partial

import numpy as np

from benchmarks.naive import naive_clearances_m
from benchmarks.report import at_most, ms, show, times
from benchmarks.timing import cpu_seconds, interleave, peak_mib, ratio, typical
from benchmarks.uncertainty import bootstrap_of, sums_of
from benchmarks.workload import BENCHMARK_SAMPLES, SAMPLES_PER_SCENE, make_workload
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring.challenge import exact_sheet, graded_sheet, scoring_of, settle
from exceptiondrive_scoring.measure import measure

SAMPLE_FACTORS = (1, 2, 4, 8, 16, 40)
"""The last, 127,240 samples, is about as many as the largest legal file holds."""
WAYPOINTS = (6, 12, 24, 48)
NAIVE_SAMPLES = 100
SCENES = (1_250, 2_500, 5_000, 10_000)


def run(protocol: ProtocolDocument) -> None:
    """Print the growth tables."""
    cases = {f"{BENCHMARK_SAMPLES * k:,}": (BENCHMARK_SAMPLES * k, 6) for k in SAMPLE_FACTORS}
    _grow("Measure as N grows (T = 6)", "N", cases, protocol)
    cases = {str(n): (BENCHMARK_SAMPLES, n) for n in WAYPOINTS}
    _grow(f"Measure as T grows (N = {BENCHMARK_SAMPLES:,}, 3 s)", "T", cases, protocol)
    _grow_sheets(protocol)
    _grow_scenes(protocol)


def _grow(
    title: str, name: str, cases: dict[str, tuple[int, int]], protocol: ProtocolDocument
) -> None:
    rows, each_us = [], []
    for case, (n_samples, n_waypoints) in cases.items():
        workload = make_workload(protocol, n_samples, n_waypoints)
        regions = workload.split.prepared_regions
        few = slice(0, NAIVE_SAMPLES)
        edited, corners = workload.pairs.edited[few], workload.split.regions_m[few]

        ours = partial(measure, workload.pairs, regions, protocol.geometry)
        naive = partial(naive_clearances_m, edited, corners, protocol.geometry)
        found = interleave({"ours": ours, "naive": naive}, rounds=5)
        seconds = typical(found["ours"])
        each_us.append(seconds / n_samples / n_waypoints * 1e6)
        unsafe = float(np.mean(measure(workload.pairs, regions, protocol.geometry).intrusion))
        factor = ratio(found["naive"], found["ours"]) * n_samples / NAIVE_SAMPLES
        rows.append(
            (
                case,
                ms(seconds),
                f"{seconds / n_samples * 1e6:.2f}",
                times(factor),
                f"{unsafe:.0%}",
                f"{peak_mib(ours):.1f}",
            )
        )
    show(title, (name, "ms", "us a sample", "x naive", "UR", "peak MiB"), rows)
    at_most(f"{title}: a waypoint of the longest", each_us[-1] / each_us[0], 1.5, "x the shortest")


def _grow_sheets(protocol: ProtocolDocument) -> None:
    rows = []
    scoring, ref = scoring_of(PLANNING.id), SplitRef(name="workload", revision="")
    for factor in SAMPLE_FACTORS:
        workload = make_workload(protocol, BENCHMARK_SAMPLES * factor)
        split = workload.split
        answers = {"source": workload.pairs.source, "edited": workload.pairs.edited}
        measured = scoring.measure(answers, split, protocol.geometry)
        settled = settle(scoring, measured, split, ref, protocol)
        sheet = partial(exact_sheet, scoring, measured, split, ref, protocol)
        regraded = partial(graded_sheet, scoring, settled, split, ref, protocol)
        found = interleave({"sheet": sheet, "regraded": regraded}, rounds=5)
        rows.append(
            (
                f"{split.n_samples:,}",
                *(ms(typical(found[name])) for name in found),
                *(f"{typical(found[name]) / split.n_samples * 1e6:.2f}" for name in found),
                f"{peak_mib(sheet):.1f}",
            )
        )
    head = ("N", "ms", "new d_safe, ms", "us a sample", "new d_safe, us", "peak MiB")
    show("Sheet of measurements as N grows", head, rows)


def _grow_scenes(protocol: ProtocolDocument) -> None:
    rows = []
    for n_scenes in SCENES:
        sums = sums_of(make_workload(protocol, n_scenes * SAMPLES_PER_SCENE), protocol)
        job = partial(bootstrap_of, sums, 1, protocol)
        seconds = min(cpu_seconds(job) for _ in range(3))
        mib = f"{peak_mib(job):.1f}"
        rows.append((f"{n_scenes:,}", ms(seconds), f"{seconds / n_scenes * 1e6:.1f}", mib))
    head = ("scenes", "ms", "us a scene", "peak MiB")
    show("Bootstrap of one entry as scenes grow", head, rows)
