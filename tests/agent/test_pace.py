import pytest

from exceptiondrive_endpoints.endpoint import Pace


def test_slots_lie_a_minute_divided_by_the_rate_apart() -> None:
    pace = Pace(30)
    assert [pace.reserve(100.0) for _ in range(4)] == pytest.approx([0, 2, 4, 6])


def test_a_pause_is_not_saved_up_for_a_burst() -> None:
    pace = Pace(60)
    assert pace.reserve(0.0) == 0
    assert pace.reserve(100.0) == 0
    assert pace.reserve(100.0) == pytest.approx(1)


def test_without_a_rate_nothing_waits() -> None:
    pace = Pace(None)
    assert [pace.reserve(5.0) for _ in range(3)] == [0, 0, 0]
