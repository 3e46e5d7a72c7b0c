"""What a later revision tells of a sample that it withdraws: its value, of every entry, without a submission."""

import numpy as np
import pytest
from tests.leak.oracle import SAMPLE, FloatArray, Oracle

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_worker.splits.store import load_split, read_split

STEPS_M = (0.0, 0.5, 1.5, 3.0)
"""Four entries that drive straight on, so far a waypoint."""


def straight(n_samples: int, step_m: float) -> FloatArray:
    path = np.stack([step_m * np.arange(1.0, 7.0), np.zeros(6)], axis=-1)
    return np.broadcast_to(path, (n_samples, 6, 2)).copy()


def sum_of_hcc(sheet: ScoreSheet, family: str) -> tuple[float, int]:
    """Return the sum over the smallest published cell that holds the family, and its N."""
    cell = sheet.families[family]
    hcc, n = cell.metrics["hcc"], cell.n
    if hcc is None or n is None:
        hcc, n = sheet.micro["hcc"], sheet.n
    assert hcc is not None
    return n * hcc, n


@pytest.mark.parametrize(("version", "within"), [("1.1", 0.006), (NEWEST_WITHHELD, 0.042)])
def test_a_revision_that_withdraws_one_sample_tells_its_value_of_every_entry(
    version: str, within: float
) -> None:
    protocol = packaged_protocol(version)
    split = read_split(SAMPLE)
    before = Oracle(load_split(split, protocol), protocol)
    ids = before.split.counted_ids
    truth = np.array([_hcc(before, step_m) for step_m in STEPS_M])
    is_between = ((truth > 0) & (truth < 1)).any(axis=0)
    place = int(np.argmax(is_between * np.ptp(truth, axis=0)))
    gone = [
        each.model_copy(update={"withdrawn": "a test"}) if each.sample_id == ids[place] else each
        for each in split.samples
    ]
    later = split.model_copy(update={"samples": tuple(gone)})
    after = Oracle(load_split(later, protocol), protocol)
    family = protocol.families[before.split.arrays.family_index[place]].id
    read = []
    for step_m in STEPS_M:
        told = [
            sum_of_hcc(each.ask(straight(each.split.arrays.n_samples, step_m)), family)
            for each in (before, after)
        ]
        assert told[0][1] - told[1][1] == 1
        read.append(told[0][0] - told[1][0])
    assert np.ptp(truth[:, place]) > 10 * within, "its value says how near an entry came"
    assert np.abs(np.array(read) - truth[:, place]).max() < within


def _hcc(oracle: Oracle, step_m: float) -> FloatArray:
    """Withheld: HCC of each sample, by the formula of docs/protocol.md."""
    measured = oracle.measured(straight(oracle.split.arrays.n_samples, step_m))
    clearance_m = measured["clearance_m"].astype(np.float64)
    return np.minimum(clearance_m / oracle.split.arrays.d_safe_m, 1.0)
