"""The ceiling chart."""

from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.ceiling_chart import ceiling_chart
from exceptiondrive_server.pages.label_placing import Box, _text_box, place_labels


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
        assert not any(inner.meets(other) for other in boxes[index + 1 :])
