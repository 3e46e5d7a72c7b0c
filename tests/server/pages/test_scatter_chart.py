"""The chart of two metrics."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.pages.invented_board import PROTOCOL

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.boards.charts import (
    Box,
    _text_box,
    labels_of,
    place_labels,
    scatter_chart,
)
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.numbers import px


@pytest.mark.parametrize("width", [640, 350])
def test_every_mark_and_whisker_stays_inside_the_frame(lively_board: Board, width: int) -> None:
    chart = scatter_chart(lively_board, "macro_family", width=width)
    assert chart is not None
    assert len(chart.points) == 8  # six scored, two references
    for point in chart.points:
        xs = [float(x) for x in (point.x, *(point.x_whisker or ()))]
        ys = [float(y) for y in (point.y, *(point.y_whisker or ()))]
        assert chart.frame.left <= min(xs) <= max(xs) <= chart.frame.right
        assert chart.frame.top <= min(ys) <= max(ys) <= chart.frame.bottom


def test_a_parked_car_stands_at_the_left_above_all_others(lively_board: Board) -> None:
    chart = scatter_chart(lively_board, "macro_family")
    assert chart is not None
    freeze = next(point for point in chart.points if point.title.startswith("FREEZE"))
    others = [point for point in chart.points if point is not freeze]
    assert freeze.x == px(chart.frame.left)
    assert all(float(freeze.y) < float(point.y) for point in others)
    assert all(float(freeze.x) < float(point.x) for point in others)
    assert freeze.title == "FREEZE (Stands still): HCC 97.20 %, Progress 0.00 %"


def test_small_values_fill_their_axis(lively_board: Board) -> None:
    entries = tuple(
        entry.model_copy(
            update={
                "metrics": entry.metrics | {"hcc": 0.02 if index else 0.03},
                "intervals": {**entry.intervals, "hcc": None},
            }
        )
        for index, entry in enumerate(lively_board.entries)
    )
    chart = scatter_chart(lively_board.model_copy(update={"entries": entries}), "macro_family")
    assert chart is not None
    middle = (chart.frame.top + chart.frame.bottom) / 2
    assert all(float(point.y) < middle for point in chart.points)


@pytest.mark.parametrize(("best", "is_drawn"), [(0.49, True), (0.48, False)])
def test_a_reference_over_twice_as_high_as_all_others_is_named_beside_the_picture(
    lively_board: Board, best: float, is_drawn: bool
) -> None:
    entries = tuple(
        entry
        if entry.source == "reference"
        else entry.model_copy(
            update={
                "metrics": entry.metrics | {"hcc": best},
                "intervals": {**entry.intervals, "hcc": None},
            }
        )
        for entry in lively_board.entries
    )
    board = lively_board.model_copy(update={"entries": entries})
    chart = scatter_chart(board, "macro_family")
    assert chart is not None
    assert any(point.title.startswith("FREEZE") for point in chart.points) is is_drawn
    assert chart.beyond == (() if is_drawn else ("FREEZE (97.20\u202f%)",))
    assert "FREEZE" not in chart.without
    page = BoardPage(BoardQuery.parse([]), (), None, board, PROTOCOL, ("1.0",), "1.0")
    assert page.shown is not None
    assert (
        "with over twice the HCC of all others: FREEZE" in str(page.shown.charts)
    ) is not is_drawn


def test_a_label_nearer_to_another_point_than_to_its_own_has_a_line() -> None:
    frame = Box(0, 0, 400, 400)
    alone = place_labels([("Swerve Net", 200, 200)], frame, [])
    assert alone[0].leader is None
    crowd = [("Swerve Net", 200.0, 200.0), ("", 230.0, 182.0)]
    blocked = [Box(205, 186, 219, 240), Box(100, 150, 196, 240), Box(202, 207, 300, 240)]
    label = place_labels(crowd, frame, blocked)[0]
    own, other = (
        math.hypot(max(float(label.x) - x, 0), float(label.y) - 4 - y) for _, x, y in crowd
    )
    assert other < own
    assert label.leader is not None


def test_an_entry_without_progress_is_named_beside_the_picture(lively_board: Board) -> None:
    first, *others = lively_board.entries
    unknown = first.model_copy(update={"metrics": first.metrics | {"progress": None}})
    board = lively_board.model_copy(update={"entries": (unknown, *others)})
    chart = scatter_chart(board, "macro_family")
    assert chart is not None
    assert chart.without == ("Kestrel-2", "half-a-file")


def test_a_reference_without_progress_stands_at_the_edge_and_says_so(lively_board: Board) -> None:
    entries = tuple(
        entry.model_copy(update={"metrics": entry.metrics | {"progress": None}})
        if entry.method == "FREEZE"
        else entry
        for entry in lively_board.entries
    )
    chart = scatter_chart(lively_board.model_copy(update={"entries": entries}), "macro_family")
    assert chart is not None
    freeze = next(point for point in chart.points if point.title.startswith("FREEZE"))
    assert (freeze.x, chart.has_edge) == (px(chart.frame.left), True)
    assert freeze.title.endswith("Progress not defined")
    assert "FREEZE" not in chart.without


@pytest.mark.parametrize("width", [640, 350])
def test_no_two_points_carry_one_label(lively_board: Board, width: int) -> None:
    long = "A planner with a very long name that is cut, number "
    entries = tuple(
        entry.model_copy(
            update={"method": "Twin" if at % 2 else f"{long}{at}", "team": f"T{at % 3}"}
        )
        for at, entry in enumerate(lively_board.entries)
    )
    chart = scatter_chart(
        lively_board.model_copy(update={"entries": entries}), "macro_family", width=width
    )
    assert chart is not None
    texts = [label.text for label in chart.labels]
    assert len(texts) > 2
    assert len(set(texts)) == len(texts)
    assert max(map(len, texts)) <= 24


def test_what_an_entry_is_called_in_a_picture(lively_board: Board) -> None:
    called = [
        ("Twin", "T"),
        ("Twin", "T"),
        ("Twin", "U"),
        ("x" * 21, "T"),
        ("x" * 22, "T"),
        ("One", "T"),
    ]
    entries = [
        lively_board.entries[0].model_copy(update={"method": method, "team": team})
        for method, team in called
    ]
    alike = "x" * 15 + "…"
    assert labels_of(entries, 20) == (
        *("Twin, T (1)", "Twin, T (2)", "Twin, U"),
        *(f"{alike} (1)", f"{alike} (2)", "One"),
    )


def test_a_point_is_marked_as_what_its_entry_is(lively_board: Board) -> None:
    first, *others = lively_board.entries
    listed = first.model_copy(update={"rank": None})
    chart = scatter_chart(
        lively_board.model_copy(update={"entries": (listed, *others)}), "macro_family"
    )
    assert chart is not None
    kinds = [point.kind for point in chart.points]
    assert kinds == ["listed", *["scored"] * 5, *["reference"] * 2]


def test_axes_stay_where_they_are_however_the_board_is_sorted_or_paged(
    lively_board: Board,
) -> None:
    shown = []
    for query in ([], [("sort", "ur")], [("page", "2")], [("q", "Kestrel")]):
        page = BoardPage(BoardQuery.parse(query), (), None, lively_board, PROTOCOL, ("1.0",), "1.0")
        assert page.shown is not None
        charts = str(page.shown.charts)
        shown.append(charts[charts.index("<svg") : charts.index("</svg>")])
    assert len(set(shown)) == 1


def test_without_values_there_is_no_chart(empty_board: Board) -> None:
    assert scatter_chart(empty_board, "macro_family") is None


def test_linked_submissions_are_joined_by_an_arrow_with_the_interval_of_the_change(
    strategy_board: Board,
) -> None:
    chart = scatter_chart(strategy_board, "macro_family")
    assert chart is not None
    (arrow,) = chart.arrows
    with_it, without = chart.points[:2]
    start, end = (float(arrow.line[0]), float(arrow.line[1])), (arrow.line[2], arrow.line[3])
    assert math.dist(start, (float(without.x), float(without.y))) == pytest.approx(9, abs=0.1)
    _, *sides = ([float(at) for at in corner.split(",")] for corner in arrow.head.split())
    foot = [sum(both) / 2 for both in zip(*sides, strict=True)]
    assert foot == pytest.approx([float(at) for at in end], abs=0.1)
    assert math.dist([float(at) for at in end], (float(with_it.x), float(with_it.y))) < 20
    assert arrow.box is not None
    left, top, width, height = (float(at) for at in arrow.box)
    assert left <= float(with_it.x) <= left + width
    assert top <= float(with_it.y) <= top + height
    per_point = (float(without.x) - float(with_it.x)) / (44.0 - 28.75)
    assert width == pytest.approx(13 * per_point, abs=0.2)  # -22 to -9 points
    assert height == pytest.approx(8 * per_point, abs=0.2)  # -5 to 3 points


def test_there_is_no_arrow_without_both_ends_or_under_the_other_average(
    strategy_board: Board, lively_board: Board
) -> None:
    one = strategy_board.model_copy(update={"entries": strategy_board.entries[:1]})
    alone = scatter_chart(one, "macro_family")
    other = scatter_chart(strategy_board, "micro")
    planning = scatter_chart(lively_board, "macro_family")
    for chart in (alone, other, planning):
        assert chart is not None
        assert chart.arrows == ()


@pytest.mark.parametrize("width", [640, 350])
def test_two_parts_of_one_whole_are_drawn_on_one_scale(strategy_board: Board, width: int) -> None:
    chart = scatter_chart(strategy_board, "macro_family", width=width)
    assert chart is not None
    along, up = (
        [(float(tick.text), float(tick.at)) for tick in ticks]
        for ticks in (chart.x_ticks, chart.y_ticks)
    )
    (x0, at_x0), (x1, at_x1), *_ = along
    (y0, at_y0), (y1, at_y1), *_ = up
    assert (at_x1 - at_x0) / (x1 - x0) == pytest.approx((at_y0 - at_y1) / (y1 - y0), abs=0.02)
    assert float(chart.y_ticks[-1].at) >= chart.frame.top
    assert chart.y_ticks[-1].text == "20", "the first above all that it holds"


def test_what_a_lower_corner_means_stands_below_the_axis_and_its_numbers(
    strategy_board: Board,
) -> None:
    chart = scatter_chart(strategy_board, "macro_family")
    assert chart is not None
    lower = [label for label in chart.corners if label.text in ("never wrong", "too careless")]
    assert len(lower) == 2
    assert all(float(label.y) > chart.frame.bottom + 21 + 13 for label in lower)


async def test_the_board_says_the_effect_in_words_beside_the_arrows(shown_site: Any) -> None:
    text = (await shown_site.get("/?phase=strategy")).text
    assert text.count('<g class="eff">') == 2  # wide and narrow
    assert "Accuracy +16.25 points (+10 to +23)" in text
    assert "Under-warning \u221215.25 points (\u221222 to \u22129)" in text
    assert 'class="eff' not in (await shown_site.get("/?phase=sample")).text


spots = st.lists(
    st.tuples(st.text("abcdefgh", min_size=1, max_size=30), st.floats(20, 600), st.floats(20, 400)),
    max_size=12,
)


@pytest.mark.parametrize(
    ("ranked", "listed", "said"),
    [
        (19, 1, ""),
        (20, 0, ""),
        (1200, 2, "Drawn are the first 20 of 1,202 scored, those with a rank before others."),
        (19, 2, "Drawn are the first 20 of 21 scored, those with a rank before others."),
        (0, 21, "Drawn are the first 20 of 21 scored, those with a rank before others."),
    ],
)
def test_a_chart_says_how_many_of_many_it_draws(
    lively_board: Board, ranked: int, listed: int, said: str
) -> None:
    one = lively_board.entries[0]
    entries = tuple(
        one.model_copy(update={"submission_id": f"s{n}", "rank": n + 1 if n < ranked else None})
        for n in range(ranked + listed)
    )
    chart = scatter_chart(lively_board.model_copy(update={"entries": entries}), "macro_family")
    assert chart is not None
    assert chart.not_charted == said
    assert len(chart.points) == min(ranked + listed, 20)


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
        middle = Box(box.left + 6, box.top + 6, box.right - 6, box.bottom - 6)
        for other in labels[:index] + labels[index + 1 :]:
            if other.leader and middle.left < middle.right:
                x1, y1, x2, y2 = map(float, other.leader)
                line = [(x1 + (x2 - x1) * k / 40, y1 + (y2 - y1) * k / 40) for k in range(41)]
                assert not any(
                    middle.left < x < middle.right and middle.top < y < middle.bottom
                    for x, y in line
                )


@pytest.mark.parametrize(
    ("frame", "anchors"),
    [
        (Box(40, 20, 612, 438), [("Llama", 600, 409.5), ("Claude", 600, 415), ("Human", 600, 438)]),
        (Box(40, 20, 332, 316), [("Llama", 320, 300.5), ("Claude", 320, 303)]),
    ],
)
def test_names_of_points_that_touch_in_a_corner_stand_in_the_order_of_the_points(
    frame: Box, anchors: list[tuple[str, float, float]]
) -> None:
    whiskers = [Box(x - 20, y - 2, x + 2, y + 2) for _, x, y in anchors]
    labels = place_labels(anchors, frame, whiskers)
    from_the_top = sorted(labels, key=lambda label: float(label.y))
    assert [label.text for label in from_the_top] == [name for name, _, _ in anchors]


REAL_PLANNERS = [("llama-3.2-11b", 7.91), ("claude-3.7-sonnet", 6.45), ("recorded-human", 0.51)]


@pytest.mark.parametrize(("right", "bottom"), [(624, 428), (334, 348)], ids=["wide", "narrow"])
def test_three_planners_that_lose_no_progress_and_hardly_react_all_have_their_names(
    right: float, bottom: float
) -> None:
    anchors = [(name, right, bottom - (bottom - 32) * hcc / 100) for name, hcc in REAL_PLANNERS]
    whiskers = [Box(right - 20, y - 2, right + 2, y + 2) for _, _, y in anchors]
    labels = place_labels(anchors, Box(54, 34, right + 12, bottom + 4), whiskers)
    assert [label.text for label in labels] == [name for name, _ in REAL_PLANNERS]
