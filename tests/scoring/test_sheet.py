"""Totals and breakdown, by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.sheet import aggregate

MakeSplit = Callable[..., SplitArrays]
NAN = float("nan")
METRICS = (PLANNING.metric("hcc"), PLANNING.metric("cts"))


def _split(make_split: MakeSplit, tasks: list[int]) -> SplitArrays:
    return make_split(np.zeros((len(tasks), 4, 2)), tasks=tasks)


def test_micro_weighs_samples_and_macro_weighs_families(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    # three samples of Sudden Emergence (tasks SE1 SE1 SE2), one of Lane Blockage (LB1)
    scores = SampleScores(METRICS, np.array([[0.0, 1.0], [0.3, 2.0], [0.6, 3.0], [0.9, 4.0]]))
    sheet = aggregate(scores, _split(make_split, [0, 0, 1, 4]), protocol.taxonomy)
    assert sheet.n == 4
    assert sheet.micro == pytest.approx({"hcc": 0.45, "cts": 2.5})
    assert sheet.macro_family == pytest.approx({"hcc": 0.6, "cts": 3.0})
    assert sheet.family_sizes == {"sudden_emergence": 3, "lane_blockage": 1}
    assert sheet.families["sudden_emergence"] == pytest.approx({"hcc": 0.3, "cts": 2.0})
    assert sheet.task_sizes == {"SE1": 2, "SE2": 1, "LB1": 1}
    assert sheet.headline("macro_family") == sheet.macro_family


def test_a_family_without_samples_is_absent(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    scores = SampleScores(METRICS, np.array([[0.5, 1.0]]))
    sheet = aggregate(scores, _split(make_split, [4]), protocol.taxonomy)
    assert list(sheet.families) == ["lane_blockage"]
    assert list(sheet.tasks) == ["LB1"]


def test_an_undefined_value_is_left_out_and_an_undefined_mean_is_none(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    scores = SampleScores(METRICS, np.array([[0.5, NAN], [0.5, NAN], [0.7, 2.0]]))
    sheet = aggregate(scores, _split(make_split, [0, 1, 4]), protocol.taxonomy)
    assert sheet.micro["cts"] == 2.0
    assert sheet.families["sudden_emergence"] == {"hcc": 0.5, "cts": None}
    assert sheet.macro_family["cts"] == 2.0
    nothing = SampleScores(METRICS, np.array([[0.5, NAN]]))
    assert aggregate(nothing, _split(make_split, [0]), protocol.taxonomy).micro["cts"] is None


def test_the_paper_prints_the_mean_of_the_family_means() -> None:
    table_2 = {
        "AutoVLA": ([9.90, 12.86, 10.22, 9.78, 9.92, 9.56], 10.37),
        "Impromptu VLA": ([19.63, 20.28, 19.98, 20.14, 17.86, 19.95], 19.64),
        "DrivoR": ([4.31, 4.59, 2.61, 5.49, 3.94, 8.27], 4.86),
        "ST-P3": ([20.02, 19.86, 17.48, 22.92, 24.75, 21.17], 21.03),
    }
    for families, printed in table_2.values():
        assert np.mean(families) == pytest.approx(printed, abs=0.01)
