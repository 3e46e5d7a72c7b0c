"""The frame check of docs/protocol.md section 5, in the precise checker."""

import json
from collections.abc import Callable

import pytest

from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.faults import Fault, FaultCode
from exceptiondrive_schemas.protocol import ProtocolDocument

Ends = list[tuple[float, float]]


@pytest.fixture
def frame_fault(protocol: ProtocolDocument) -> Callable[[Ends], Fault | None]:
    def find(ends_m: Ends) -> Fault | None:
        predictions = [
            {
                "sample_id": f"s-{index}",
                "source": [[x_m * t / 6, y_m * t / 6] for t in range(1, 7)],
                "edited": None,
            }
            for index, (x_m, y_m) in enumerate(ends_m)
        ]
        document = {
            "schema": "exceptiondrive.planning/1",
            "split": "example",
            "predictions": predictions,
        }
        report = check(json.dumps(document).encode(), protocol=protocol).report
        if report.is_valid:
            return None
        (group,) = report.faults
        assert group.code is FaultCode.WRONG_FRAME
        assert str(group.examples[0].hint) in group.message
        return group.examples[0]

    return find


@pytest.mark.parametrize(
    ("end_m", "words"),
    [
        ((0.0, 10.0), "looks like x right / y forward: swap to (y, -x)"),
        ((5.0, 9.0), "looks like x right / y forward: swap to (y, -x)"),
        ((-10.0, 1.0), "most motion is along -x"),
        ((0.0, -10.0), "most motion is along -y"),
    ],
)
def test_a_wrong_frame_is_named(
    end_m: tuple[float, float], words: str, frame_fault: Callable[[Ends], Fault | None]
) -> None:
    fault = frame_fault([end_m] * 20)
    assert fault is not None
    assert str(fault.hint).startswith(words)


def test_forward_motion_passes(frame_fault: Callable[[Ends], Fault | None]) -> None:
    assert frame_fault([(10.0, 9.0), (10.0, -9.0)] * 10) is None


def test_the_median_decides(frame_fault: Callable[[Ends], Fault | None]) -> None:
    assert frame_fault([(10.0, 0.0)] * 11 + [(0.0, 10.0)] * 10) is None
    fault = frame_fault([(10.0, 0.0)] * 10 + [(0.0, 10.0)] * 11)
    assert fault is not None
    assert fault.got == "90.0 degrees over 21 source trajectories"


def test_standing_cars_and_too_few_moving_ones_are_not_judged(
    frame_fault: Callable[[Ends], Fault | None],
) -> None:
    assert frame_fault([(0.0, 2.0)] * 100) is None
    assert frame_fault([(0.0, 10.0)] * 19) is None
