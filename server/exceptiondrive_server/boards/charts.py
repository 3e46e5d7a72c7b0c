"""The ceiling chart: the first primary metric against the second, with HCC <= 100 - UR.

Labels stand beside their point, never on top of another one; arrows lead from a submission without
the reminder to the one with it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from exceptiondrive_schemas.board import Board, BoardEntry, ReminderEffect
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.score_sheet import Interval
from exceptiondrive_server.boards.entry_facts import (
    challenge_of,
    entry_key,
    interval_of,
    primary_metrics,
    values_of,
)
from exceptiondrive_server.boards.query import Average
from exceptiondrive_server.web.numbers import Digits, fixed
from exceptiondrive_server.web.scales import Scale, nice_scale, px

CHARACTER_WIDTH = 7.4
LINE_HEIGHT = 16.0
MAX_CHARACTERS = 24
FAR = 30.0
"""From here on a line leads from the point to its label."""
HEAD = 9.0
GAP = 9.0
"""Arrows end before the point that they lead to."""
MAX_POINTS = 24
_Ends = tuple[float, float, float, float]


class Box(NamedTuple):
    """A rectangle in SVG coordinates."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, others: Sequence["Box"]) -> bool:
        """Whether this rectangle shares area with any of the others."""
        left, top, right, bottom = self
        for other_left, other_top, other_right, other_bottom in others:
            if (
                left < other_right
                and other_left < right
                and top < other_bottom
                and other_top < bottom
            ):
                return True
        return False

    def holds(self, other: "Box") -> bool:
        """Whether `other` lies inside this rectangle."""
        return (
            self.left <= other.left
            and other.right <= self.right
            and self.top <= other.top
            and other.bottom <= self.bottom
        )


Anchor = Literal["start", "middle", "end"]


@dataclass(frozen=True)
class Label:
    """A placed label."""

    x: str
    y: str
    anchor: Anchor
    text: str
    leader: tuple[str, str, str, str] | None
    """From the point to a label that stands far from it."""


@dataclass(frozen=True)
class Arrow:
    """A line, its head as a points list, and the box of the paired intervals around its end."""

    line: tuple[str, str, str, str]
    head: str
    box: tuple[str, str, str, str] | None
    title: str


@dataclass(frozen=True)
class EffectLine:
    """One linked pair in words."""

    method: str
    without: str
    parts: tuple[str, ...]


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


_OFFSETS: tuple[tuple[float, float, Anchor], ...] = (
    (10, -9, "start"),
    (10, 18, "start"),
    (-10, 18, "end"),
    (-10, -9, "end"),
    (0, 27, "middle"),
    (-34, 34, "end"),
    (34, 34, "start"),
    (34, -26, "start"),
    (-40, 56, "end"),
    (40, 56, "start"),
    (40, -48, "start"),
    (-46, 80, "end"),
    (46, -72, "start"),
)


def place_labels(
    anchors: Sequence[tuple[str, float, float]], frame: Box, obstacles: Sequence[Box]
) -> tuple[Label, ...]:
    """Place the labels that fit; a label without room is left out (its point has a title).

    Args:
        anchors: Text and position of each point, most important first.
        frame: Labels stay inside it.
        obstacles: Rectangles that labels keep off, besides the points themselves.
    """
    taken = [Box(x - 7, y - 7, x + 7, y + 7) for _, x, y in anchors] + list(obstacles)
    placed: list[Label] = []
    for text, x, y in anchors:
        short = text if len(text) <= MAX_CHARACTERS else text[: MAX_CHARACTERS - 1] + "…"
        for dx, dy, anchor in _OFFSETS:
            box = _text_box(short, x + dx, y + dy, anchor)
            if frame.holds(box) and not box.meets(taken):
                taken.append(box)
                leader = _leader(x, y, dx, dy)
                placed.append(Label(px(x + dx), px(y + dy), anchor, short, leader))
                break
    return tuple(placed)


def _text_box(text: str, x: float, y: float, anchor: Anchor) -> Box:
    width = len(text) * CHARACTER_WIDTH
    left = {"start": x, "middle": x - width / 2, "end": x - width}[anchor]
    return Box(left, y - LINE_HEIGHT + 4, left + width, y + 4)


def _leader(x: float, y: float, dx: float, dy: float) -> tuple[str, str, str, str] | None:
    if abs(dy) < FAR and abs(dx) < FAR:
        return None
    side = math.copysign(3, dx)
    return (px(x), px(y), px(x + dx - side), px(y + dy - 4))


def effect_arrows(
    entries: Sequence[BoardEntry], metrics: tuple[Metric, Metric], x: Scale, y: Scale
) -> tuple[Arrow, ...]:
    """Return an arrow for each linked pair of which both stand in the drawing.

    Args:
        entries: What the drawing shows.
        metrics: What stands along x and along y, in per cent.
        x: Scale of the first, in per cent.
        y: Scale of the second, in per cent.
    """
    by_key = {entry_key(entry): entry for entry in entries}
    arrows = []
    for entry in entries:
        effect = entry.reminder_effect
        start = by_key.get(effect.without) if effect else None
        if effect is None or start is None:
            continue
        ends = [_values(one, metrics) for one in (start, entry)]
        if None not in ends[0] and None not in ends[1]:
            arrows.append(_arrow(ends[0], ends[1], effect, metrics, x, y, entry.method))
    return tuple(arrow for arrow in arrows if arrow is not None)


def _values(entry: BoardEntry, metrics: tuple[Metric, Metric]) -> list[float]:
    return [100 * value for m in metrics if (value := entry.metrics.get(m.key)) is not None]


def _arrow(
    start: Sequence[float],
    end: Sequence[float],
    effect: ReminderEffect,
    metrics: tuple[Metric, Metric],
    x: Scale,
    y: Scale,
    method: str,
) -> Arrow | None:
    if len(start) < 2 or len(end) < 2:
        return None
    (x1, y1), (x2, y2) = ((x.clamped(at[0]), y.clamped(at[1])) for at in (start, end))
    length = ((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5
    if length < 2 * GAP:
        return None
    ux, uy = (x2 - x1) / length, (y2 - y1) / length
    tip = (x2 - ux * GAP, y2 - uy * GAP)
    foot = (tip[0] - ux * HEAD, tip[1] - uy * HEAD)
    side = (-uy * HEAD / 2, ux * HEAD / 2)
    corners = [tip, (foot[0] + side[0], foot[1] + side[1]), (foot[0] - side[0], foot[1] - side[1])]
    return Arrow(
        line=(px(x1 + ux * GAP), px(y1 + uy * GAP), px(foot[0]), px(foot[1])),
        head=" ".join(f"{px(a)},{px(b)}" for a, b in corners),
        box=_box(start, effect, metrics, x, y),
        title=f"{effect.without_method} with the reminder: {method}",
    )


def _box(
    start: Sequence[float],
    effect: ReminderEffect,
    metrics: tuple[Metric, Metric],
    x: Scale,
    y: Scale,
) -> tuple[str, str, str, str] | None:
    """Where the arrow may end: start plus the interval of the change; x, y, width, height."""
    intervals = [_interval(effect, metric) for metric in metrics]
    if intervals[0] is None or intervals[1] is None:
        return None
    left, right = (x.clamped(start[0] + 100 * end) for end in intervals[0])
    bottom, top = (y.clamped(start[1] + 100 * end) for end in intervals[1])
    return (px(left), px(top), px(right - left), px(bottom - top))


def _interval(effect: ReminderEffect, metric: Metric) -> Interval | None:
    found = effect.differences.get(metric.key)
    return found.interval if found else None


def effect_lines(board: Board, digits: Digits) -> tuple[EffectLine, ...]:
    """Say of every linked pair of a board what changed, with intervals and verdicts."""
    metrics = primary_metrics(challenge_of(board))
    lines = []
    for entry in board.entries:
        effect = entry.reminder_effect
        if effect is None:
            continue
        parts = []
        for metric in metrics:
            found = effect.differences.get(metric.key)
            if found is None or found.difference is None:
                continue
            text = f"{metric.label} {digits.signed(metric, found.difference)} points"
            if found.interval:
                low, high = (digits.signed(metric, end) for end in found.interval)
                text += f" ({low} to {high})"
            parts.append(text)
        lines.append(EffectLine(entry.method, effect.without_method, tuple(parts)))
    return tuple(lines)
