"""The frame check at upload."""

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.frame_check import FrameFault, frame_check

REALDATA = Path(__file__).parents[3] / "shared" / "realdata"
CRUISE = np.stack([3.0 * np.arange(1, 7), 0.2 * np.arange(1, 7)], axis=-1)
SWAP = np.array([[0.0, 1.0], [-1.0, 0.0]])  # (forward, left) -> x right, y forward


def _check(source: list[FloatArray], protocol: Protocol) -> FrameFault | None:
    stacked = np.stack(source)
    pairs = TrajectoryPairs.from_columns({"source": stacked, "edited": stacked})
    return frame_check(pairs, protocol.plausibility)


def test_a_file_in_the_ego_frame_passes(protocol: Protocol) -> None:
    assert _check([CRUISE] * 30, protocol) is None


def test_x_right_y_forward_is_named_with_the_remedy(protocol: Protocol) -> None:
    fault = _check([CRUISE @ SWAP] * 30, protocol)
    assert fault is not None
    assert fault.kind == "x_right_y_forward"
    assert fault.sentence == "looks like x right / y forward: swap to (y, -x)"
    assert fault.median_angle_deg == pytest.approx(90, abs=5)
    assert fault.n_moving == 30


def test_driving_backwards_is_named(protocol: Protocol) -> None:
    fault = _check([-CRUISE] * 30, protocol)
    assert fault is not None
    assert fault.kind == "backward"
    assert "along -x" in fault.sentence


def test_a_minority_that_turns_or_reverses_passes(protocol: Protocol) -> None:
    assert _check([CRUISE] * 20 + [CRUISE @ SWAP] * 10 + [-CRUISE] * 5, protocol) is None


def test_trajectories_that_hardly_move_or_are_missing_say_nothing(protocol: Protocol) -> None:
    wrong = CRUISE @ SWAP
    assert _check([0.05 * wrong] * 100, protocol) is None
    assert _check([np.full((6, 2), np.nan)] * 100, protocol) is None


def test_too_few_moving_trajectories_say_nothing(protocol: Protocol) -> None:
    fewest = protocol.plausibility.frame_check_min_samples
    assert _check([CRUISE @ SWAP] * (fewest - 1), protocol) is None
    assert _check([CRUISE @ SWAP] * fewest, protocol) is not None


def test_the_real_file_in_the_wrong_frame_is_caught(protocol: Protocol) -> None:
    path = REALDATA / "wrong-frame" / "agent-driver-x-right-y-forward.json.gz"
    if not path.exists():
        pytest.skip("the real planner files are not beside this repository (../shared/realdata)")
    predictions = json.loads(gzip.decompress(path.read_bytes()))["predictions"]
    missing = [[np.nan] * 2] * 6
    fault = _check([np.array(p["source"] or missing) for p in predictions], protocol)
    assert fault is not None
    assert fault.kind == "x_right_y_forward"


@pytest.mark.parametrize("name", ["gpt-4.1", "qwen-2.5-7b", "recorded-human"])
def test_real_files_in_the_right_frame_pass(
    name: str,
    real_case: Callable[[str, str], tuple[TrajectoryPairs, SplitArrays]],
    protocol: Protocol,
) -> None:
    pairs, _ = real_case("nuscenes-real", name)
    assert frame_check(pairs, protocol.plausibility) is None
