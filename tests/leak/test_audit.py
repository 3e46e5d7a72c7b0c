"""The leak audit: attack the published numbers as a participant would, and hold them to the bound.

The figures are printed (`pytest tests/leak -s`) and stand in docs/leakage.md.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.leak.cells import BITS_OF_FLIP, least_width_m

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import MetricRow, ScoreSheet
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_worker.boards.rounding import Rounding

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

FloatArray = NDArray[np.float64]
CELLS = ["task", "family", "overall"]
STRAIGHT = np.arange(1, 7)[:, None] / 6 * np.array([1.0, 0.0])


def index_of(oracle: "Oracle", cell: str) -> NDArray[np.integer]:
    arrays = oracle.split.arrays
    overall = np.zeros(arrays.n_samples, dtype=np.int64)
    return {"task": arrays.task_index, "family": arrays.family_index, "overall": overall}[cell]


def rows_of(oracle: "Oracle", sheet: ScoreSheet, cell: str) -> list[MetricRow]:
    if cell == "overall":
        return [sheet.micro]
    known = oracle.protocol.tasks if cell == "task" else oracle.protocol.families
    shown = sheet.tasks if cell == "task" else sheet.families
    return [shown[key.id].metrics if key.id in shown else {} for key in known]


def column(rows: list[MetricRow], metric: str) -> FloatArray:
    return np.array([row.get(metric) for row in rows], dtype=np.float64)


@dataclass(frozen=True)
class Found:
    """What differencing found out about the samples that it tried."""

    value: FloatArray
    true_value: FloatArray
    clearance_error_m: FloatArray
    typical_error_m: FloatArray
    n: FloatArray


def differencing(oracle: "Oracle", cell: str, metric: str, edited: FloatArray) -> Found:
    """One sample of each cell is left out at a time: its value is n times what the mean loses."""
    cells, index = oracle.cells, index_of(oracle, cell)
    measured = oracle.measured(edited)
    clearance, d_safe = np.asarray(measured["clearance_m"]), oracle.split.arrays.d_safe_m
    ratio = clearance / d_safe
    truth = {
        "hcc": np.minimum(ratio, 1.0),
        "hpr": 1 / (np.abs(ratio - 1) + 1),
        "ur": np.ones_like(ratio),
    }[metric]
    truth = np.where(np.asarray(measured["intrusion"]), 0.0, truth)
    with_all = column(rows_of(oracle, oracle.ask(edited), cell), metric)
    members = [np.flatnonzero(index == number) for number in range(len(with_all))]
    rounds = min(60, max(len(some) for some in members))
    samples, values = [], []
    for turn in range(rounds):
        left_out = [int(some[turn]) for some in members if turn < len(some)]
        changed = edited.copy()
        changed[left_out] = np.nan
        lost = with_all - column(rows_of(oracle, oracle.ask(changed), cell), metric)
        for sample in left_out:
            samples.append(sample)
            values.append(lost[index[sample]] * len(members[index[sample]]))
    value = np.abs(np.array(values))
    d_true, d_needed = clearance[samples], d_safe[samples]
    if metric == "hpr":
        guess = d_needed / np.maximum(value, 1e-9)
        guess = np.where(d_true < d_needed, 2 * d_needed - guess, guess)
    else:
        guess = value * d_needed
    sizes = np.array([len(members[index[sample]]) for sample in samples], dtype=np.float64)
    typical = [
        cells.clearance_error_m(max(float(d), float(s)), float(s), int(n))
        for d, s, n in zip(d_true, d_needed, sizes, strict=True)
    ]
    return Found(value, truth[samples], np.abs(guess - d_true), np.array(typical), sizes)


def frozen(oracle: "Oracle") -> FloatArray:
    return np.zeros((oracle.split.arrays.n_samples, 6, 2))


def near(oracle: "Oracle") -> FloatArray:
    """Everybody drives on until 0.5 d_safe before the region: where HCC tells the distance.

    The attacker of this test is given that for nothing; a real one has to search for it first.
    """
    low, high = (
        np.zeros(oracle.split.arrays.n_samples),
        np.full(oracle.split.arrays.n_samples, 60.0),
    )
    for _ in range(12):
        middle = (low + high) / 2
        measured = oracle.measured(middle[:, None, None] * STRAIGHT)
        is_short = np.asarray(measured["clearance_m"]) > oracle.split.arrays.d_safe_m / 2
        low, high = np.where(is_short, middle, low), np.where(is_short, high, middle)
    return np.asarray(low[:, None, None] * STRAIGHT)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("metric", ["hpr", "hcc"])
def test_differencing_one_sample_tells_no_more_than_the_bound(
    oracle: "Oracle", cell: str, metric: str
) -> None:
    found = differencing(oracle, cell, metric, frozen(oracle) if metric == "hpr" else near(oracle))
    n = round(float(np.median(found.n)))
    bound_bits = oracle.cells.bits_of_sample(n)
    outcomes = len(np.unique(np.round(found.value, 9)))
    bits = math.log2(outcomes)
    if metric == "hpr":
        typical = float(np.median(found.typical_error_m))
    else:
        typical = float(np.median(oracle.split.arrays.d_safe_m)) * oracle.cells.resolution(n) / 3
    error = float(np.median(found.clearance_error_m))
    print(  # noqa: T201 - the audit's figures
        f"\n{metric.upper()} by {cell} (n = {n}): {bits:.1f} bits a sample and submission "
        f"(bound {bound_bits:.1f}); clearance to {error:.3g} m (typical {typical:.3g} m)"
    )
    assert outcomes <= oracle.cells.outcomes(n)
    assert error > typical / 10


@pytest.mark.parametrize("metric", ["hpr", "hcc"])
def test_without_rounding_the_audit_would_sound(oracle: "Oracle", metric: str) -> None:
    """The audit is able to fail: exact means give the clearance to nanometres."""
    oracle.is_rounded = False
    found = differencing(
        oracle, "family", metric, frozen(oracle) if metric == "hpr" else near(oracle)
    )
    typical = float(np.median(found.typical_error_m))
    assert np.median(found.clearance_error_m) < 1e-9 < typical / 10


@pytest.mark.parametrize("cell", CELLS)
def test_a_flip_of_ur_tells_one_bit_of_one_sample(oracle: "Oracle", cell: str) -> None:
    found = differencing(oracle, cell, "ur", frozen(oracle))
    n = round(float(np.median(found.n)))
    is_seen = np.round(found.value) == 1
    print(  # noqa: T201
        f"\nUR by {cell} (n = {n}): a flip is seen in {is_seen.mean():.0%} of samples "
        f"(bound {BITS_OF_FLIP:.0f} bit a sample and submission)"
    )
    assert is_seen.all()
    assert len(np.unique(np.round(found.value))) <= 2**BITS_OF_FLIP


@pytest.mark.parametrize("n_submissions", [5, 10, 20])
def test_a_search_for_the_near_edge_gets_no_narrower_than_the_bound(
    oracle: "Oracle", n_submissions: int
) -> None:
    """Bisect, with one sample of each task at a time, by the published UR of the task."""
    index = index_of(oracle, "task")
    probed = np.array([int(np.flatnonzero(index == task)[0]) for task in range(index.max() + 1)])
    before = column(rows_of(oracle, oracle.ask(frozen(oracle)), "task"), "ur")
    low, high = np.zeros(len(probed)), np.full(len(probed), 60.0)
    for _ in range(n_submissions):
        middle = (low + high) / 2
        edited = frozen(oracle)
        edited[probed] = middle[:, None, None] * STRAIGHT
        hit = column(rows_of(oracle, oracle.ask(edited), "task"), "ur") > before
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    width = float((high - low).max())
    least = least_width_m(60.0, BITS_OF_FLIP, n_submissions)
    print(  # noqa: T201
        f"\ncorner search by UR, {len(probed)} samples at once: after {n_submissions} submissions "
        f"an edge is known to {width:.2g} m (no search can do better than {least:.1g} m)"
    )
    assert width >= least
    assert width == pytest.approx(60.0 / 2**n_submissions)


def test_small_cells_are_not_shown(oracle: "Oracle") -> None:
    """With a floor above the size of tasks, only families and overall means are left."""
    strict = oracle.protocol.publication.model_copy(update={"min_samples_per_cell": 30})
    oracle.protocol = oracle.protocol.model_copy(update={"publication": strict})
    sheet = oracle.ask(frozen(oracle))
    assert all(set(row.metrics.values()) == {None} for row in sheet.tasks.values())
    assert all(row.n == 20 for row in sheet.tasks.values())
    assert sheet.families["sudden_emergence"].metrics["ur"] is not None


def test_coarser_publication_leaks_less(oracle: "Oracle") -> None:
    fine = oracle.cells
    publication = fine.publication.model_copy(update={"percent_decimals": 0})
    coarse = type(fine)(publication, fine.family_sizes, fine.task_sizes)
    print(  # noqa: T201
        f"\nat most {fine.bits_per_submission():.0f} bits a submission over all tasks of the sample "
        f"phase; with whole per cents {coarse.bits_per_submission():.0f}"
    )
    assert coarse.bits_per_submission() < fine.bits_per_submission() / 2
    assert coarse.clearance_error_m(10, 1, 20) == pytest.approx(
        100 * fine.clearance_error_m(10, 1, 20)
    )
    assert fine.bits_per_submission() < fine.bits_of_any_submission()


# What protocol 1.1 adds, weighed by the same measure.


def test_outcome_cells_would_tell_two_flips_a_cell_and_are_off(oracle: "Oracle") -> None:
    """Two samples of each task are probed at once, told apart by whether they seem to react."""
    index = index_of(oracle, "task")
    pairs = [np.flatnonzero(index == task)[:2] for task in range(index.max() + 1)]
    reacting, unmoved = (np.array([pair[side] for pair in pairs]) for side in (0, 1))
    edited = frozen(oracle)
    edited[reacting] = 40.0 * STRAIGHT  # it certainly moves
    hits = np.asarray(oracle.measured(edited)["intrusion"])
    shares = [
        column(rows_of(oracle, oracle.exact(edited), "task"), key)
        for key in ("hit_reacting", "hit_unmoved")
    ]
    sizes = np.bincount(index)
    assert np.array_equal(np.round(shares[0] * sizes), hits[reacting])
    assert np.array_equal(np.round(shares[1] * sizes), hits[unmoved])
    print(  # noqa: T201
        f"\noutcome shares by task: 2 flips a cell and submission where UR tells 1, "
        f"{oracle.cells.bits_of_more_means(2):.0f} bits more by any means (cells: "
        f"{oracle.cells.bits_of_any_submission():.0f})"
    )
    shown = oracle.ask(edited)
    for row in (*shown.tasks.values(), *shown.families.values()):
        assert {row.metrics[key] for key in OUTCOMES} == {None}
    assert None not in {shown.micro[key] for key in OUTCOMES}


OUTCOMES = ("clear", "close", "hit_reacting", "hit_unmoved")


def test_a_clearance_curve_would_tell_more_than_the_totals_do(oracle: "Oracle") -> None:
    edited = near(oracle)
    curve = oracle.exact(edited).clearance_curve
    assert curve is not None
    places = set()
    for sample in range(0, oracle.split.arrays.n_samples, 5):
        changed = edited.copy()
        changed[sample] = np.nan
        without = oracle.exact(changed).clearance_curve
        assert without is not None
        lost = np.array(curve.micro) - np.array(without.micro)
        places.add(int(np.count_nonzero(np.round(lost * oracle.split.arrays.n_samples))))
    steps = len(curve.micro)
    n = oracle.split.arrays.n_samples
    any_means = steps * math.log2(n + 1)
    print(  # noqa: T201
        f"\nclearance curve, overall: up to {math.log2(steps + 1):.1f} bits of one sample (UR overall "
        f"1, HCC overall at most {oracle.cells.bits_of_sample(n):.1f}), {any_means:.0f} bits a "
        f"submission by any means (three means overall: {oracle.cells.bits_of_means(3):.0f})"
    )
    assert len(places) > 1, "where on the curve a sample lies is seen"
    assert any_means > oracle.cells.bits_of_means(3)
    assert oracle.ask(edited).clearance_curve is None


def test_progress_and_flags_tell_nothing_of_regions(oracle: "Oracle") -> None:
    """Other regions leave them as they are: they are made of the upload, labels and drives."""
    arrays = oracle.split.arrays
    drives = oracle.split.recorded_m
    assert drives is not None
    counted = drives[oracle.split.rows]
    elsewhere = arrays.regions_m + np.array([7.0, -3.0])
    moved = replace(
        oracle, split=replace(oracle.split, arrays=replace(arrays, regions_m=elsewhere))
    )
    for edited in (0.1 * counted, counted, -counted):
        here, there = oracle.exact(edited), moved.exact(edited)
        assert here.plausibility == there.plausibility
        assert here.coverage == there.coverage
        for key in ("progress", "cts", "source_l2_m"):
            for rows in ("families", "tasks"):
                a, b = getattr(here, rows), getattr(there, rows)
                assert all(a[name].metrics[key] == b[name].metrics[key] for name in a), key


def test_distances_from_withheld_drives_are_told_in_the_totals_alone(oracle: "Oracle") -> None:
    sheet = oracle.exact(frozen(oracle))
    rounding = Rounding(PLANNING, oracle.protocol.publication)
    shown = rounding.sheet(sheet)
    keys = [key for key in shown.micro if key.startswith("source_l2")]
    assert len(keys) == 4
    for row in (*shown.tasks.values(), *shown.families.values()):
        assert {row.metrics[key] for key in keys} == {None}
    step_m = 10.0**-oracle.protocol.publication.metre_decimals
    error_m = oracle.split.arrays.n_samples * step_m
    print(f"\nSource L2, overall: the distance of one sample to {error_m:.1f} m")  # noqa: T201
    assert error_m > 2.2, "no finer than what real planners differ by"


def test_over_caution_tells_which_samples_are_controls(oracle: "Oracle") -> None:
    """What cannot be helped is known: whoever changes one sample sees whether it is a control."""
    split, protocol = oracle.split, oracle.protocol
    drives = split.recorded_m
    assert drives is not None
    scoring = scoring_of(PLANNING.id)

    def over_caution(edited: FloatArray) -> float | None:
        answers = {"source": drives[split.control_rows], "edited": edited[split.control_rows]}
        return scoring.of_controls(answers, protocol).metrics["over_caution"]

    found = []
    for sample in range(len(drives)):
        edited = drives.copy()
        edited[sample] = 0.0
        if over_caution(edited) != 0.0:
            found.append(sample)
    assert found == list(split.control_rows)
    bits = math.log2(len(found) + 1)
    print(f"\nover-caution: at most {bits:.1f} bits of marks a submission")  # noqa: T201
