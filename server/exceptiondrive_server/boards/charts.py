"""The charts of a board: two metrics that the challenge names, and the clearance curve.

Labels are placed beside their points without overlaps; arrows lead from a submission without the
reminder to the one with it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple
from unicodedata import east_asian_width

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Corner, Metric
from exceptiondrive_schemas.score_sheet import ClearanceCurve, Interval, ReminderEffect
from exceptiondrive_server.boards.entry_facts import (
    challenge_of,
    entry_key,
    flags_of,
    interval_of,
    primary_metrics,
    values_of,
)
from exceptiondrive_server.boards.query import Average
from exceptiondrive_server.web.numbers import Digits, Scale, fixed, nice_scale, px
from exceptiondrive_server.web.templating import template_filter

LINE_HEIGHT = 16.0
MAX_CHARACTERS = 24
FAR = 30.0
"""From here on a line leads from the point to its label; and wherever another point is nearer to it."""
HEAD = 9.0
GAP = 9.0
"""Arrows end before the point that they lead to."""
MAX_SCORED = 20


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
class Frame:
    """Size of a chart, and where its axes end; SVG units."""

    width: int
    height: int
    top: float
    bottom: float
    left: float = 52.0

    @property
    def right(self) -> float:
        """Where x ends."""
        return self.width - 16.0

    @property
    def across(self) -> tuple[float, float]:
        """Extent of x."""
        return self.left, self.right

    @property
    def upwards(self) -> tuple[float, float]:
        """Extent of y."""
        return self.bottom, self.top


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
    x_whisker: tuple[str, str] | None
    y_whisker: tuple[str, str] | None
    kind: str
    """`scored` (and ranked), `listed` (without a rank) or `reference`."""
    title: str


@dataclass(frozen=True)
class ScatterChart:
    """All coordinates of the chart, and the entries without one of the two metrics."""

    frame: Frame
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    corners: tuple[Label, ...]
    points: tuple[Point, ...]
    labels: tuple[Label, ...]
    arrows: tuple[Arrow, ...]
    x_metric: Metric
    y_metric: Metric
    without: tuple[str, ...]
    beyond: tuple[str, ...]
    """References too high to be drawn, each with its value along y."""
    not_charted: str
    """Which entries are left out since they are many, in a sentence."""
    has_edge: bool
    """Whether a reference stands at the left edge, since it has nothing along x."""
    description: str


@dataclass(frozen=True)
class _Mark:
    """An entry's values in per cent; a reference without the metric along x stands at the edge."""

    entry: BoardEntry
    x: float
    y: float
    has_x: bool
    x_interval: Interval | None
    y_interval: Interval | None


def labels_of(entries: Sequence[BoardEntry], most: int = 60) -> tuple[str, ...]:
    """Return unique, short labels of these entries for a picture.

    Its method; where two have the same one, its team as well; where that is the same, a number.
    """
    names = [entry.method for entry in entries]
    full = [
        f"{name}, {entry.team}" if names.count(name) > 1 and entry.team else name
        for entry, name in zip(entries, names, strict=True)
    ]
    cut = [_shortened(name, most) for name in full]
    return tuple(
        [
            f"{_shortened(name, most - 4)} ({cut[: at + 1].count(name)})"
            if cut.count(name) > 1
            else name
            for at, name in enumerate(cut)
        ]
    )


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def charted_entries(board: Board) -> tuple[BoardEntry, ...]:
    """Return the entries that the chart of a board draws: the first scored ones, the references."""
    scored = [entry for entry in board.entries if entry.source == "scored"]
    references = [entry for entry in board.entries if entry.source == "reference"]
    return (*scored[:MAX_SCORED], *references)


def _not_charted(board: Board) -> str:
    """Say how many scored entries the chart of a board leaves out; empty if none."""
    n_scored = sum([entry.source == "scored" for entry in board.entries])
    if n_scored <= MAX_SCORED:
        return ""
    return (
        f"Drawn are the first {MAX_SCORED} of {n_scored:,} scored, those with a rank before others."
    )


@template_filter
def charted_values(
    board: Board, average: Average, chart: "ScatterChart"
) -> list[tuple[BoardEntry, float | None, float | None]]:
    """Return each charted entry with its two values, y before x."""
    keys = chart.y_metric.key, chart.x_metric.key
    rows = [(entry, values_of(entry, board, average)) for entry in charted_entries(board)]
    return [(entry, values.get(keys[0]), values.get(keys[1])) for entry, values in rows]


def scatter_chart(
    board: Board, average: Average, *, width: int = 640, height: int = 480
) -> ScatterChart | None:
    """Draw the entries of a board by the two metrics of its challenge; None if none has both.

    Of scored entries the first twenty are drawn. The width is 640 for wide screens, 350 for phones.
    """
    challenge = challenge_of(board)
    words = challenge.words.chart
    if not {words.x, words.y} <= set(challenge.metric_keys):
        return None
    metrics = challenge.metric(words.x), challenge.metric(words.y)
    entries = charted_entries(board)
    all_marks = _marks(board, entries, average, metrics)
    if not all_marks:
        return None
    beyond = [] if words.same_scale else _outlying_references(all_marks)
    marks = [mark for mark in all_marks if mark not in beyond]
    foot = 72.0 if any(corner.startswith("bottom") for corner in words.corners) else 52.0
    frame = Frame(width, height, top=32.0, bottom=height - foot)
    x_values = [value for m in marks for value in (m.x, *(m.x_interval or ()))]
    y_values = [value for m in marks for value in (m.y, *(m.y_interval or ()))]
    if words.same_scale:
        x_scale = _scale([*x_values, *y_values], frame.across, width)
        y_scale, frame = _like_along_x(x_scale, frame, foot, y_values)
    else:
        x_scale = _scale(x_values, frame.across, width)
        y_scale = _scale(y_values, frame.upwards, width)
    known = {entry_key(mark.entry) for mark in all_marks}
    corners = _corners(words.corners, x_scale, y_scale)
    return ScatterChart(
        frame=frame,
        x_ticks=ticks_of(x_scale),
        y_ticks=ticks_of(y_scale),
        corners=corners,
        points=tuple(_point(mark, x_scale, y_scale, metrics) for mark in marks),
        arrows=_arrows(marks, metrics, x_scale, y_scale) if average == board.headline else (),
        labels=_labels(marks, x_scale, y_scale, corners),
        x_metric=metrics[0],
        y_metric=metrics[1],
        without=tuple([e.method for e in entries if entry_key(e) not in known]),
        beyond=tuple([f"{mark.entry.method} ({mark.y:.2f}\u202f%)" for mark in beyond]),
        not_charted=_not_charted(board),
        has_edge=not all(mark.has_x for mark in marks),
        description=_description(marks, metrics),
    )


@template_filter
def axis_title(metric: Metric) -> str:
    """Return the title of an axis, with its abbreviation if the label is one."""
    return f"{metric.title}, {metric.label} %" if metric.label.isupper() else f"{metric.title}, %"


def _marks(
    board: Board, entries: Sequence[BoardEntry], average: Average, metrics: tuple[Metric, Metric]
) -> list[_Mark]:
    marks = []
    for entry in entries:
        values = values_of(entry, board, average)
        x, y = (values.get(metric.key) for metric in metrics)
        if y is None or (x is None and entry.source != "reference"):
            continue
        ends = [_times_100(interval_of(entry, board, average, m.key)) for m in metrics]
        marks.append(_Mark(entry, (x or 0.0) * 100, y * 100, x is not None, *ends))
    return marks


def _outlying_references(marks: Sequence[_Mark]) -> list[_Mark]:
    """Return the references over twice as high as every other mark, which would squeeze all others together."""
    others = [mark.y for mark in marks if mark.entry.source != "reference"]
    limit = 2 * max(others, default=math.inf)
    return [mark for mark in marks if mark.entry.source == "reference" and mark.y > limit]


def _times_100(interval: Interval | None) -> Interval | None:
    return None if interval is None else (interval[0] * 100, interval[1] * 100)


def _scale(values: Sequence[float], extent: tuple[float, float], width: int) -> Scale:
    """A scale from 0 to a bound of all values, at most 100."""
    n_ticks = 6 if width > 480 else 5
    return nice_scale(values, extent, n_ticks=n_ticks, floor=0.0, ceiling=100.0, include=(0.0, 1.0))


def _like_along_x(
    x: Scale, frame: Frame, foot: float, values: Sequence[float]
) -> tuple[Scale, Frame]:
    """Return a y on which a point is as long as along x, and a frame as high as that y asks.

    It ends at the first tick above all that it holds, and above a quarter of x, where labels find room.
    """
    needed = max(*values, x.domain[1] / 4)
    top = next((tick for tick in x.ticks if tick >= needed - 1e-9), x.domain[1])
    bottom = frame.top + (frame.right - frame.left) * top / x.domain[1]
    cut = Frame(frame.width, math.ceil(bottom + foot), frame.top, bottom, frame.left)
    ticks = tuple(tick for tick in x.ticks if tick <= top)
    return Scale((0.0, top), cut.upwards, ticks), cut


def ticks_of(scale: Scale) -> tuple[Tick, ...]:
    """Return the ticks of a scale, each with as many decimals as all need."""
    decimals = scale.tick_decimals
    return tuple(Tick(px(scale.at(tick)), fixed(tick, decimals)) for tick in scale.ticks)


def _corners(words: Mapping[Corner, str], x: Scale, y: Scale) -> tuple[Label, ...]:
    """What the corners mean, outside of the frame: above it, or below the numbers along x."""
    placed = []
    for corner, text in words.items():
        is_left, is_top = corner.endswith("left"), corner.startswith("top")
        at = (x.extent[0] + 8 if is_left else x.extent[1] - 6, y.extent[1 if is_top else 0])
        anchor: Anchor = "start" if is_left else "end"
        placed.append(Label(px(at[0]), px(at[1] + (-10 if is_top else 42)), anchor, text, None))
    return tuple(placed)


def _point(mark: _Mark, x: Scale, y: Scale, metrics: tuple[Metric, Metric]) -> Point:
    kind = "listed" if mark.entry.rank is None else "scored"
    kind = "reference" if mark.entry.source == "reference" else kind
    along, up = metrics
    flags = f" ({flags_of(mark.entry)})" if mark.entry.flags else ""
    return Point(
        x=px(x.at(mark.x)),
        y=px(y.at(mark.y)),
        x_whisker=_whisker(mark.x_interval, x),
        y_whisker=_whisker(mark.y_interval, y),
        kind=kind,
        title=f"{mark.entry.method}{flags}: {up.label} {mark.y:.2f} %, {along.label} "
        + (f"{mark.x:.2f} %" if mark.has_x else "not defined"),
    )


def _whisker(interval: Interval | None, scale: Scale) -> tuple[str, str] | None:
    return interval and (px(scale.clamped(interval[0])), px(scale.clamped(interval[1])))


def _labels(
    marks: Sequence[_Mark], x: Scale, y: Scale, corners: Sequence[Label]
) -> tuple[Label, ...]:
    frame = Box(x.extent[0] + 2, y.extent[1] + 2, x.extent[1] + 12, y.extent[0] + 4)
    names = labels_of([mark.entry for mark in marks], MAX_CHARACTERS)
    anchors = [(name, x.at(m.x), y.at(m.y)) for name, m in zip(names, marks, strict=True)]
    bars = [_extent_box(mark, x, y) for mark in marks]
    words = [_text_box(c.text, float(c.x), float(c.y), c.anchor) for c in corners]
    return place_labels(anchors, frame, [*bars, *words])


def _extent_box(mark: _Mark, x: Scale, y: Scale) -> Box:
    """The horizontal whisker as an obstacle for labels."""
    low, high = mark.x_interval or (mark.x, mark.x)
    at = y.at(mark.y)
    return Box(x.clamped(low) - 2, at - 2, x.clamped(high) + 2, at + 2)


def _description(marks: Sequence[_Mark], metrics: tuple[Metric, Metric]) -> str:
    along, up = metrics
    shown = ", ".join(
        f"{m.entry.method} {m.y:.2f} at {m.x:.2f}"
        if m.has_x
        else f"{m.entry.method} {m.y:.2f}, {along.label} not defined"
        for m in marks[:12]
    )
    more = f" and {len(marks) - 12} more" if len(marks) > 12 else ""
    return f"{up.label} against {along.label} in per cent: {shown}{more}."


_Offset = tuple[float, float, Anchor]
_BESIDE: tuple[_Offset, ...] = (
    (60, 4, "start"),
    (-60, 4, "end"),
    (60, 2, "start"),
    (-60, 2, "end"),
)
"""At the height of the point, so that names stand in its order; but a long name fills the row."""
_OFFSETS: tuple[_Offset, ...] = (
    (10, -9, "start"),
    (10, 18, "start"),
    (-10, 18, "end"),
    (-10, -9, "end"),
    (22, -8, "start"),
    (-22, -8, "end"),
    (0, 27, "middle"),
    *_BESIDE,
    (4, -36, "start"),
    (-4, -36, "end"),
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

    The places of `_BESIDE` are given up where that lets more labels stand. `anchors` are text and
    position of each point, most important first; `obstacles` are kept off besides the points
    themselves.
    """
    placed = _place_labels(anchors, frame, obstacles, _OFFSETS)
    if len(placed) == len(anchors):
        return placed
    others = tuple(offset for offset in _OFFSETS if offset not in _BESIDE)
    return max(placed, _place_labels(anchors, frame, obstacles, others), key=len)


def _place_labels(
    anchors: Sequence[tuple[str, float, float]],
    frame: Box,
    obstacles: Sequence[Box],
    offsets: Sequence[_Offset],
) -> tuple[Label, ...]:
    taken = [Box(x - 7, y - 7, x + 7, y + 7) for _, x, y in anchors] + list(obstacles)
    placed: list[Label] = []
    names: list[Box] = []
    for text, x, y in anchors:
        short = _shortened(text, MAX_CHARACTERS)
        for dx, dy, anchor in offsets:
            box = _text_box(short, x + dx, y + dy, anchor)
            if not frame.holds(box) or box.meets(taken):
                continue
            left, top, right, bottom = box
            aways = [max(left - a, a - right, top - b, b - bottom) for _, a, b in anchors]
            own = max(left - x, x - right, top - y, y - bottom)
            is_far = abs(dy) >= FAR or abs(dx) >= FAR or min(aways) < own
            leader = _leader_line(x, y, dx, dy) if is_far else None
            steps = _leader_boxes(leader) if leader else []
            if not steps or not any(step.meets(names) for step in steps):
                taken += [box, *steps]
                names.append(box)
                placed.append(Label(px(x + dx), px(y + dy), anchor, short, leader))
                break
    return tuple(placed)


def _text_box(text: str, x: float, y: float, anchor: Anchor) -> Box:
    width = _text_width(text)
    left = {"start": x, "middle": x - width / 2, "end": x - width}[anchor]
    return Box(left, y - LINE_HEIGHT + 4, left + width, y + 4)


@lru_cache(maxsize=1024)  # each place that is tried for a name asks
def _text_width(text: str) -> float:
    """Estimate the width of a label (13.5 px, bold), rather a little too wide."""
    n_wide = len([each for each in text if east_asian_width(each) in "WF"])
    return 7.8 * len(text) + 2.0 * sum(map(str.isupper, text)) + 5.7 * n_wide


def _leader_line(x: float, y: float, dx: float, dy: float) -> tuple[str, str, str, str]:
    side = math.copysign(3, dx)
    return (px(x), px(y), px(x + dx - side), px(y + dy - 4))


def _leader_boxes(leader: tuple[str, str, str, str]) -> list[Box]:
    """Pieces of a leading line, which must not run through a name."""
    x1, y1, x2, y2 = map(float, leader)
    places = [(x1 + (x2 - x1) * k / 8, y1 + (y2 - y1) * k / 8) for k in range(9)]
    return [Box(x - 1, y - 1, x + 1, y + 1) for x, y in places]


def _arrows(
    marks: Sequence[_Mark], metrics: tuple[Metric, Metric], x: Scale, y: Scale
) -> tuple[Arrow, ...]:
    """Return an arrow for each linked pair whose entries are both drawn."""
    by_key = {entry_key(mark.entry): mark for mark in marks if mark.has_x}
    arrows = []
    for mark in by_key.values():
        effect = mark.entry.reminder_effect
        start = by_key.get(effect.without) if effect else None
        if effect and start:
            arrows.append(_arrow(start, mark, effect, metrics, x, y))
    return tuple(arrow for arrow in arrows if arrow is not None)


def _arrow(
    start: _Mark,
    end: _Mark,
    effect: ReminderEffect,
    metrics: tuple[Metric, Metric],
    x: Scale,
    y: Scale,
) -> Arrow | None:
    (x1, y1), (x2, y2) = ((x.clamped(at.x), y.clamped(at.y)) for at in (start, end))
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
        title=f"{effect.without_method} with the reminder: {end.entry.method}",
    )


def _box(
    start: _Mark, effect: ReminderEffect, metrics: tuple[Metric, Metric], x: Scale, y: Scale
) -> tuple[str, str, str, str] | None:
    """Where the arrow may end: start plus the interval of the change; x, y, width, height."""
    found = [effect.differences.get(metric.key) for metric in metrics]
    along, up = (each.interval if each else None for each in found)
    if along is None or up is None:
        return None
    left, right = (x.clamped(start.x + 100 * end) for end in along)
    bottom, top = (y.clamped(start.y + 100 * end) for end in up)
    return (px(left), px(top), px(right - left), px(bottom - top))


def effect_lines(board: Board, digits: Digits) -> list[tuple[str, str, str]]:
    """Name both methods of every linked pair of a board, and say what changed, with intervals."""
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
                text += f" ({digits.interval(metric, found.interval, signed=True)})"
            parts.append(text)
        lines.append((entry.method, effect.without_method, "; ".join(parts)))
    return lines


Curves = tuple[tuple[BoardEntry, ClearanceCurve], ...]
"""Entries with the share of their samples that keeps at least a multiple of the required clearance.

Where a curve starts, at no clearance, it stands at 100 - UR; the area under it up to the required
clearance is HCC, as exactly as its steps allow.
"""
MAX_CURVES = 5
"""So many lines are told apart by colour and dashes."""


@dataclass(frozen=True)
class Curve:
    """One entry's curve, as the points of a polyline."""

    name: str
    points: str
    at_required: float
    """Share of samples that keep the whole required clearance."""
    at_ticks: tuple[float | None, ...]
    """The same of each number along x; None beyond the end of the curve."""


@dataclass(frozen=True)
class CurveChart:
    """Curves on one pair of axes, in SVG units; `required_x` is the required clearance.

    The points of curves count steps of the curve along x and thousandths of the samples up;
    `transform` brings them to the axes, so that they are written once for every size.
    """

    frame: Frame
    required_x: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    transform: str
    curves: tuple[Curve, ...]
    description: str


BAR_WIDTH = 0.25
"""Of the histogram, in multiples of the required clearance."""


class ClearanceBar(NamedTuple):
    """A share of the samples by what they keep of the required clearance."""

    level: Literal["hit", "close", "clear"]
    label: str
    share: float


def clearance_bars(curve: ClearanceCurve) -> tuple[ClearanceBar, ...]:
    """Return the histogram that a clearance curve holds: the differences of its points.

    All samples count the same. The first bar is those hit, the last all that is further away than the
    curve tells; together they are all samples.
    """
    kept, stride = curve.micro, max(1, round(BAR_WIDTH / curve.step))
    bars = [ClearanceBar("hit", "hit", 1 - kept[0])]
    for begin in range(0, len(kept) - 1, stride):
        end = min(begin + stride, len(kept) - 1)
        low, high = begin * curve.step, end * curve.step
        level: Literal["close", "clear"] = "close" if high <= 1 + 1e-9 else "clear"
        bars.append(ClearanceBar(level, f"{low:g}\u2013{high:g}", kept[begin] - kept[end]))
    last = (len(kept) - 1) * curve.step
    bars.append(ClearanceBar("clear" if last >= 1 else "close", f"\u2265{last:g}", kept[-1]))
    return tuple(bars)


def best_entries(board: Board, chosen: Sequence[str] = ()) -> tuple[BoardEntry, ...]:
    """Return the leader, the entries of these keys, and the next best ranked while there is room."""
    ranked = sorted([e for e in board.entries if e.rank is not None], key=lambda e: e.rank or 0)
    ranked.sort(key=lambda entry: entry is not board.leader)
    named = [entry for entry in board.entries if entry_key(entry) in chosen]
    drawn = {entry_key(entry): entry for entry in (*ranked[:1], *named, *ranked)}
    return tuple(drawn.values())[: max(MAX_CURVES, 1 + len(named))]


def curve_chart(
    known: Curves, average: Average, digits: Digits, *, width: int = 640, height: int = 380
) -> CurveChart | None:
    """Draw the curves of some entries; None where there are none."""
    if not known:
        return None
    frame = Frame(width, height, top=14.0, bottom=height - 52.0)
    reach = max((len(curve.micro) - 1) * curve.step for _, curve in known)
    x_scale = Scale((0.0, reach), frame.across, tuple(i / 2 for i in range(int(reach * 2) + 1)))
    y_scale = Scale((0.0, 1.0), frame.upwards, (0.0, 0.25, 0.5, 0.75, 1.0))
    curves = []
    names = labels_of([entry for entry, _ in known])
    for name, (_, curve) in zip(names, known, strict=True):
        shares = curve.micro if average == "micro" else curve.macro_family
        points = " ".join([f"{k},{share * 1000:.0f}" for k, share in enumerate(shares)])
        at_required = shares[round(1 / curve.step)]
        places = [round(tick / curve.step) for tick in x_scale.ticks]
        at_ticks = tuple([shares[at] if at < len(shares) else None for at in places])
        curves.append(Curve(name, points, at_required, at_ticks))
    along = (frame.right - frame.left) / reach * known[0][1].step
    up = (frame.top - frame.bottom) / 1000
    transform = f"matrix({along:.4f} 0 0 {up:.4f} {frame.left:g} {frame.bottom:g})"
    return CurveChart(
        frame=frame,
        required_x=px(x_scale.at(1.0)),
        x_ticks=tuple(Tick(px(x_scale.at(tick)), f"{tick:g}") for tick in x_scale.ticks),
        y_ticks=tuple(Tick(px(y_scale.at(tick)), f"{tick:.0%}"[:-1]) for tick in y_scale.ticks),
        transform=transform,
        curves=tuple(curves),
        description="Share of samples that keep the whole required clearance: "
        + ", ".join(f"{one.name} {digits.fraction(one.at_required)} %" for one in curves),
    )
