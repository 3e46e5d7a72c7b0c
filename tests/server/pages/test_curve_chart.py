"""The curves of what samples keep of the required clearance."""

import pytest

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.score_sheet import ClearanceCurve
from exceptiondrive_server.boards.charts import clearance_bars, curve_chart
from exceptiondrive_server.boards.query import Average
from exceptiondrive_server.web.numbers import Digits

CURVE = ClearanceCurve(step=0.5, micro=(0.95, 0.9, 0.4, 0.1), macro_family=(0.75, 0.5, 0.25, 0.0))


def test_a_curve_runs_through_its_shares_and_is_told_at_the_required_clearance(
    lively_board: Board,
) -> None:
    chart = curve_chart(((lively_board.entries[0], CURVE),), "macro_family", Digits())
    assert chart is not None
    across = {tick.text: float(tick.at) for tick in chart.x_ticks}
    up = {tick.text: float(tick.at) for tick in chart.y_ticks}
    assert list(across) == ["0", "0.5", "1", "1.5"]
    assert list(up) == ["0", "25", "50", "75", "100"]
    assert float(chart.required_x) == across["1"]
    scale_x, _, _, scale_y, x0, y0 = map(
        float, chart.transform.removeprefix("matrix(").removesuffix(")").split()
    )
    (curve,) = chart.curves
    assert curve.at_ticks == CURVE.macro_family
    points = [[float(at) for at in point.split(",")] for point in curve.points.split()]
    drawn = [(x0 + scale_x * x, y0 + scale_y * y) for x, y in points]
    there = zip(across.values(), [up[share] for share in ("75", "50", "25", "0")], strict=True)
    assert drawn == [pytest.approx(at, abs=0.1) for at in there]


@pytest.mark.parametrize(("average", "said"), [("macro_family", "25.00 %"), ("micro", "40.00 %")])
def test_the_description_says_the_share_that_keeps_all_of_it(
    lively_board: Board, average: Average, said: str
) -> None:
    chart = curve_chart(((lively_board.entries[0], CURVE),), average, Digits())
    assert chart is not None
    assert chart.description.endswith(f"the whole required clearance: Kestrel-2 {said}")


@pytest.mark.parametrize(
    ("curve", "bars"),
    [
        (
            CURVE,
            ["hit hit 5", "close 0–0.5 5", "close 0.5–1 50", "clear 1–1.5 30", "clear ≥1.5 10"],
        ),
        (
            ClearanceCurve(step=0.1, micro=(1.0, 0.8, 0.7, 0.4), macro_family=(1, 1, 1, 1)),
            ["hit hit 0", "close 0–0.2 30", "close 0.2–0.3 30", "close ≥0.3 40"],
        ),
    ],
)
def test_the_bars_of_a_curve_hold_all_samples_by_what_they_keep(
    curve: ClearanceCurve, bars: list[str]
) -> None:
    found = clearance_bars(curve)
    assert [f"{bar.level} {bar.label} {100 * bar.share:.0f}" for bar in found] == bars
