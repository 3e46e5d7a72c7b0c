"""The ceiling chart."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.boards.charts import Box, _text_box, ceiling_chart, place_labels


def test_no_point_stands_above_the_ceiling(lively_board: Board) -> None:
    chart = ceiling_chart(lively_board, lively_board.entries, "macro_family")
    assert chart is not None
    assert all(float(point.ceiling_y) <= float(point.y) + 0.1 for point in chart.points)


def test_every_mark_stays_inside_the_frame(lively_board: Board) -> None:
    for width in (640, 350):
        chart = ceiling_chart(lively_board, lively_board.entries, "macro_family", width=width)
        assert chart is not None
        for point in chart.points:
            assert float(chart.left) <= float(point.x) <= float(chart.right)
            assert float(chart.top) <= float(point.y) <= float(chart.bottom)


def test_a_reference_far_away_is_named_beside_the_picture(lively_board: Board) -> None:
    chart = ceiling_chart(lively_board, lively_board.entries, "macro_family")
    assert chart is not None
    assert chart.outside == ("FREEZE (97.20 at 0.00)",)
    assert len(chart.points) == 14  # six scored, one reference, seven reported


def test_without_values_there_is_no_chart(empty_board: Board) -> None:
    assert ceiling_chart(empty_board, (), "macro_family") is None


def test_linked_submissions_are_joined_by_an_arrow_with_the_interval_of_the_change(
    strategy_board: Board,
) -> None:
    chart = ceiling_chart(strategy_board, strategy_board.entries, "macro_family")
    assert chart is not None
    (arrow,) = chart.arrows
    with_it, without = chart.points[:2]
    start, end = (float(arrow.line[0]), float(arrow.line[1])), (arrow.line[2], arrow.line[3])
    assert math.dist(start, (float(without.x), float(without.y))) < 10
    assert math.dist([float(at) for at in end], (float(with_it.x), float(with_it.y))) < 20
    assert arrow.box is not None
    left, top, width, height = (float(at) for at in arrow.box)
    assert left <= float(with_it.x) <= left + width
    assert top <= float(with_it.y) <= top + height
    per_point = (float(without.x) - float(with_it.x)) / (44.0 - 28.75)
    assert width == pytest.approx(13 * per_point, abs=0.2)  # -22 to -9 points


def test_there_is_no_arrow_without_both_ends_or_under_the_other_average(
    strategy_board: Board, lively_board: Board
) -> None:
    alone = ceiling_chart(strategy_board, strategy_board.entries[:1], "macro_family")
    other = ceiling_chart(strategy_board, strategy_board.entries, "micro")
    planning = ceiling_chart(lively_board, lively_board.entries, "macro_family")
    for chart in (alone, other, planning):
        assert chart is not None
        assert chart.arrows == ()


async def test_the_board_says_the_effect_in_words_beside_the_arrows(shown_site: Any) -> None:
    text = (await shown_site.get("/?phase=strategy")).text
    assert text.count('<g class="eff">') == 2  # wide and narrow
    assert "Accuracy +16.25 points (+10.00 to +23.00)" in text
    assert "Under-warning \u221215.25 points (\u221222.00 to \u22129.00)" in text
    assert 'class="eff' not in (await shown_site.get("/?phase=sample")).text


spots = st.lists(
    st.tuples(st.text("abcdefgh", min_size=1, max_size=30), st.floats(20, 600), st.floats(20, 400)),
    max_size=12,
)


@given(spots)
def test_labels_never_cover_each_other_and_stay_in_the_frame(
    anchors: list[tuple[str, float, float]],
) -> None:
    frame = Box(0, 0, 640, 440)
    labels = place_labels(anchors, frame, [])
    boxes = [
        _text_box(label.text, float(label.x), float(label.y), label.anchor) for label in labels
    ]
    grown = Box(-1, -1, 641, 441)
    assert all(grown.holds(box) for box in boxes)
    for index, box in enumerate(boxes):
        inner = Box(box.left + 0.2, box.top + 0.2, box.right - 0.2, box.bottom - 0.2)
        assert not inner.meets(boxes[index + 1 :])
