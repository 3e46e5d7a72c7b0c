"""The ceiling chart: the first primary metric against the second, with HCC <= 100 - UR."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.score_sheet import Interval
from exceptiondrive_server.pages.board_query import Average
from exceptiondrive_server.pages.effect_arrows import Arrow, effect_arrows
from exceptiondrive_server.pages.entry_facts import (
    challenge_of,
    interval_of,
    primary_metrics,
    values_of,
)
from exceptiondrive_server.pages.label_placing import Box, Label, place_labels
from exceptiondrive_server.pages.numbers import fixed
from exceptiondrive_server.pages.scales import Scale, nice_scale, px

MAX_POINTS = 24
_Ends = tuple[float, float, float, float]


@dataclass(frozen=True)
class Tick:
    """A tick: its position and its text."""

    at: str
    text: str


@dataclass(frozen=True)
class Point:
    """One entry in the chart. Positions are SVG coordinates."""

    x: str
    y: str
    ceiling_y: str
    x_whisker: tuple[str, str] | None
    y_whisker: tuple[str, str] | None
    source: str
    title: str


@dataclass(frozen=True)
class CeilingChart:
    """All coordinates of the chart."""

    width: int
    height: int
    left: str
    right: str
    top: str
    bottom: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    impossible: str
    ceiling: tuple[str, str, str, str]
    ceiling_label: tuple[float, float, float]
    points: tuple[Point, ...]
    labels: tuple[Label, ...]
    arrows: tuple[Arrow, ...]
    x_title: str
    y_title: str
    outside: tuple[str, ...]
    description: str


@dataclass(frozen=True)
class _Mark:
    """An entry's values in per cent."""

    entry: BoardEntry
    x: float
    y: float
    x_interval: Interval | None
    y_interval: Interval | None


def ceiling_chart(
    board: Board,
    entries: Sequence[BoardEntry],
    average: Average,
    *,
    width: int = 640,
    height: int = 560,
) -> CeilingChart | None:
    """Draw entries; None if no entry has both values.

    Args:
        board: The board they stand on.
        entries: What to draw, most important first; the first twenty-four are drawn.
        average: Which average to draw.
        width: Width of the drawing; 640 for wide screens, 350 for phones.
        height: Height of the drawing.
    """
    marks = _marks(board, entries[:MAX_POINTS], average)
    if not marks:
        return None
    left, right, top, bottom = 52.0, width - 16.0, 14.0, height - 52.0
    framing = [mark for mark in marks if mark.entry.source != "reference"] or marks
    x_scale = _scale([m.x for m in framing], [m.x_interval for m in framing], (left, right), width)
    y_scale = _scale([m.y for m in framing], [m.y_interval for m in framing], (bottom, top), width)
    outside = [m for m in marks if not (x_scale.holds(m.x) and y_scale.holds(m.y))]
    marks = [mark for mark in marks if mark not in outside]
    points = tuple(_point(mark, x_scale, y_scale) for mark in marks)
    first, second = primary_metrics(challenge_of(board))[:2]
    ends = _ceiling_ends(x_scale, y_scale)
    spots = [(x_scale.at(mark.x), y_scale.at(mark.y)) for mark in marks]
    words = _ceiling_label(ends, spots)
    return CeilingChart(
        width=width,
        height=height,
        left=px(left),
        right=px(right),
        top=px(top),
        bottom=px(bottom),
        x_ticks=_ticks(x_scale),
        y_ticks=_ticks(y_scale),
        impossible=_impossible(x_scale, y_scale),
        ceiling=(px(ends[0]), px(ends[1]), px(ends[2]), px(ends[3])),
        ceiling_label=words,
        points=points,
        arrows=effect_arrows([mark.entry for mark in marks], (second, first), x_scale, y_scale)
        if average == board.headline
        else (),
        labels=_labels(marks, x_scale, y_scale, ends, words),
        x_title=_axis_title(second),
        y_title=_axis_title(first),
        outside=tuple(f"{m.entry.method} ({m.y:.2f} at {m.x:.2f})" for m in outside),
        description=_description(marks, first.label, second.label),
    )


def _axis_title(metric: Metric) -> str:
    """The title with its abbreviation, where the label is one."""
    return f"{metric.title}, {metric.label} %" if metric.label.isupper() else f"{metric.title}, %"


def _marks(board: Board, entries: Sequence[BoardEntry], average: Average) -> list[_Mark]:
    first, second = primary_metrics(challenge_of(board))[:2]
    marks = []
    for entry in entries:
        values = values_of(entry, board, average)
        x, y = values.get(second.key), values.get(first.key)
        if x is None or y is None:
            continue
        x_interval = interval_of(entry, board, average, second.key)
        y_interval = interval_of(entry, board, average, first.key)
        marks.append(_Mark(entry, x * 100, y * 100, _times_100(x_interval), _times_100(y_interval)))
    return marks


def _times_100(interval: Interval | None) -> Interval | None:
    return None if interval is None else (interval[0] * 100, interval[1] * 100)


def _scale(
    values: Sequence[float],
    intervals: Sequence[Interval | None],
    extent: tuple[float, float],
    width: int,
) -> Scale:
    ends = [end for interval in intervals if interval for end in interval]
    spread = max([*values, *ends]) - min([*values, *ends])
    room = max(spread * 0.06, 1.0)
    wanted = [*values, *ends, min(values) - room, max(values) + room]
    return nice_scale(wanted, extent, n_ticks=7 if width > 480 else 5, floor=0.0, ceiling=100.0)


def _ticks(scale: Scale) -> tuple[Tick, ...]:
    decimals = scale.tick_decimals
    return tuple(Tick(px(scale.at(tick)), fixed(tick, decimals)) for tick in scale.ticks)


def _ceiling_ends(x: Scale, y: Scale) -> _Ends:
    """Ends of the line HCC = 100 - UR inside the plot, as x1, y1, x2, y2."""
    x_low = max(x.domain[0], 100 - y.domain[1])
    x_high = min(x.domain[1], 100 - y.domain[0])
    return (x.at(x_low), y.at(100 - x_low), x.at(x_high), y.at(100 - x_high))


def _impossible(x: Scale, y: Scale) -> str:
    """Corners of the region above the ceiling, as an SVG points list; empty if out of view."""
    if x.domain[1] + y.domain[1] <= 100:
        return ""
    x1, y1, x2, y2 = _ceiling_ends(x, y)
    top, right, bottom = y.extent[1], x.extent[1], y.extent[0]
    corners = [(x1, top), (x1, y1), (x2, y2), (right, y2 if x2 >= right else bottom)]
    corners += [(right, top)]
    return " ".join(f"{px(a)},{px(b)}" for a, b in corners)


def _ceiling_label(ends: _Ends, spots: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Place and turn of the words along the line, where no point is near: x, y, degrees."""
    x1, y1, x2, y2 = ends
    angle = math.degrees(math.atan2(y2 - y1, x2 - x1)) if x2 > x1 else 0.0
    places = [(x1 + s / 20 * (x2 - x1), y1 + s / 20 * (y2 - y1)) for s in range(4, 17)]
    x, y = max(places, key=lambda place: min(math.dist(place, spot) for spot in spots))
    return (x, y, angle)


def _point(mark: _Mark, x: Scale, y: Scale) -> Point:
    return Point(
        x=px(x.at(mark.x)),
        y=px(y.at(mark.y)),
        ceiling_y=px(y.clamped(100 - mark.x)),
        x_whisker=_whisker(mark.x_interval, x),
        y_whisker=_whisker(mark.y_interval, y),
        source=mark.entry.source,
        title=f"{mark.entry.method}: {mark.y:.2f} % at {mark.x:.2f} %",
    )


def _whisker(interval: Interval | None, scale: Scale) -> tuple[str, str] | None:
    return interval and (px(scale.clamped(interval[0])), px(scale.clamped(interval[1])))


def _labels(
    marks: Sequence[_Mark],
    x: Scale,
    y: Scale,
    ends: _Ends,
    words: tuple[float, float, float],
) -> tuple[Label, ...]:
    frame = Box(x.extent[0] + 2, y.extent[1] + 2, x.extent[1] + 12, y.extent[0] - 2)
    anchors = [(mark.entry.method, x.at(mark.x), y.at(mark.y)) for mark in marks]
    bars = [_extent_box(mark, x, y) for mark in marks]
    bars += [_drop_box(mark, x, y) for mark in marks]
    return place_labels(anchors, frame, [*bars, *_line_boxes(ends), *_word_boxes(words)])


def _line_boxes(ends: _Ends) -> list[Box]:
    """The ceiling as small obstacles."""
    x1, y1, x2, y2 = ends
    places = [(x1 + s / 80 * (x2 - x1), y1 + s / 80 * (y2 - y1)) for s in range(81)]
    return [Box(x - 2, y - 2, x + 2, y + 2) for x, y in places]


def _word_boxes(words: tuple[float, float, float]) -> list[Box]:
    """The words along the ceiling as small obstacles."""
    x, y, angle = words
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    places = [(x + s * cos + 14 * sin, y + s * sin - 14 * cos) for s in range(-90, 91, 12)]
    return [Box(a - 8, b - 8, a + 8, b + 8) for a, b in places]


def _extent_box(mark: _Mark, x: Scale, y: Scale) -> Box:
    """The horizontal whisker as an obstacle for labels."""
    low, high = mark.x_interval or (mark.x, mark.x)
    at = y.at(mark.y)
    return Box(x.clamped(low) - 2, at - 2, x.clamped(high) + 2, at + 2)


def _drop_box(mark: _Mark, x: Scale, y: Scale) -> Box:
    """The dotted drop from the ceiling as an obstacle for labels."""
    at = x.at(mark.x)
    return Box(at - 2, y.clamped(100 - mark.x), at + 2, y.at(mark.y))


def _description(marks: Sequence[_Mark], first: str, second: str) -> str:
    shown = ", ".join(f"{m.entry.method} {m.y:.2f} at {m.x:.2f}" for m in marks[:12])
    more = f" and {len(marks) - 12} more" if len(marks) > 12 else ""
    return f"{first} against {second} in per cent: {shown}{more}. No point can lie above the line."
