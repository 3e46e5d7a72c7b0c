"""Two entries side by side: differences, a dumbbell chart by family, a plain verdict."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.boards.family_tiles import short_title
from exceptiondrive_server.boards.scales import Scale, nice_scale, px
from exceptiondrive_server.entries.difference_table import PairedTable, paired_table
from exceptiondrive_server.entries.facts import (
    challenge_of,
    entry_key,
    interval_of,
    primary_metrics,
    values_of,
)
from exceptiondrive_server.web.numbers import Digits, fixed, listed, unit_of

LINE_HEIGHT = 40
WIDTH, LEFT, RIGHT, TOP = 480, 128, 462, 16
NARROW = 310


@dataclass(frozen=True)
class MetricLine:
    """One metric of both entries and their difference, as text."""

    label: str
    unit: str
    a: str | None
    b: str | None
    a_interval: str | None
    b_interval: str | None
    difference: str | None
    better: str | None


@dataclass(frozen=True)
class Dumbbell:
    """One family: two dots and the difference between them."""

    label: str
    title: str
    y: str
    a_x: str | None
    b_x: str | None
    a_text: str | None
    b_text: str | None
    n_text: str
    difference: str | None
    difference_x: str
    difference_anchor: str


@dataclass(frozen=True)
class DumbbellChart:
    """All families, with the axis."""

    width: int
    height: int
    left: str
    right: str
    bottom: str
    ticks: tuple[tuple[str, str], ...]
    lines: tuple[Dumbbell, ...]
    axis_title: str
    axis_x: str


@dataclass(frozen=True)
class Comparison:
    """Everything that a comparison shows."""

    a: BoardEntry
    b: BoardEntry
    a_key: str
    b_key: str
    metrics: tuple[MetricLine, ...]
    chart: DumbbellChart | None
    narrow: DumbbellChart | None
    verdict: str
    families_sentence: str
    paired: PairedTable | None


def compare_entries(board: Board, a: BoardEntry, b: BoardEntry, digits: Digits) -> Comparison:
    """Compare two entries of one board under its headline average."""
    challenge = challenge_of(board)
    first = challenge.metrics[0]
    paired = paired_table(board, entry_key(a), entry_key(b), challenge, digits)
    return Comparison(
        a=a,
        b=b,
        a_key=entry_key(a),
        b_key=entry_key(b),
        metrics=tuple(_metric_line(board, a, b, metric, digits) for metric in challenge.metrics),
        chart=_chart(board, a, b, first, digits, WIDTH),
        narrow=_chart(board, a, b, first, digits, NARROW),
        verdict=verdict(board, a, b, digits, paired),
        paired=paired,
        families_sentence=_families_sentence(board, a, b, first, digits),
    )


def default_pair(board: Board) -> tuple[BoardEntry, BoardEntry] | None:
    """Return the two best ranked entries; else two reported ones with families; else None."""
    ranked = sorted((e for e in board.entries if e.rank is not None), key=lambda e: e.rank or 0)
    metric = challenge_of(board).metrics[0]
    reported = [entry for entry in board.entries if entry.source == "reported" and entry.families]
    reported.sort(key=lambda entry: -(entry.metrics.get(metric.key) or 0.0))
    for group in (ranked, reported):
        if len(group) >= 2:
            return group[0], group[1]
    return None


def verdict(
    board: Board,
    a: BoardEntry,
    b: BoardEntry,
    digits: Digits,
    paired: PairedTable | None = None,
) -> str:
    """Say in plain words which entry is ahead and whether the data can tell."""
    first = primary_metrics(challenge_of(board))[0]
    x, y = a.metrics.get(first.key), b.metrics.get(first.key)
    if x is None or y is None:
        missing = a if x is None else b
        return f"{missing.method} has no {first.label}, so the two cannot be compared."
    if digits.text(first, x) == digits.text(first, y):
        return f"Both stand at {digits.text(first, x)} {unit_of(first)} {first.label}."
    is_a_ahead = (x > y) == (first.better == "higher")
    ahead, behind = (a, b) if is_a_ahead else (b, a)
    gap = digits.text(first, abs(x - y))
    lead = f"{ahead.method} leads {behind.method} by {gap} points of {first.label}."
    sure = paired.sentence if paired else _certainty(board, ahead, behind, first)
    return f"{lead} {sure}"


def _certainty(board: Board, ahead: BoardEntry, behind: BoardEntry, metric: Metric) -> str:
    if "reported" in (ahead.source, behind.source):
        return (
            "At least one of the two is reported, not scored here: no interval is known, "
            "and the samples may differ."
        )
    if ahead.rank_interval and behind.rank_interval:
        if ahead.rank_interval[1] < behind.rank_interval[0]:
            return "Their rank intervals do not overlap: the order is sure on this split."
        return "Their rank intervals overlap: this split does not settle which is better."
    one = interval_of(ahead, board, board.headline, metric.key)
    two = interval_of(behind, board, board.headline, metric.key)
    if one is None or two is None:
        return "Without intervals for both, this board does not say whether the order is sure."
    if one[0] > two[1] or two[0] > one[1]:
        return "Their intervals do not overlap."
    return "Their intervals overlap: this split does not settle which is better."


def _metric_line(
    board: Board, a: BoardEntry, b: BoardEntry, metric: Metric, digits: Digits
) -> MetricLine:
    x = values_of(a, board, board.headline).get(metric.key)
    y = values_of(b, board, board.headline).get(metric.key)
    difference = None if x is None or y is None else digits.signed(metric, x - y)
    better = None
    if x is not None and y is not None and x != y and metric.better:
        better = "a" if (x > y) == (metric.better == "higher") else "b"
    return MetricLine(
        label=metric.label,
        unit=unit_of(metric),
        a=digits.text(metric, x),
        b=digits.text(metric, y),
        a_interval=_interval_text(board, a, metric, digits),
        b_interval=_interval_text(board, b, metric, digits),
        difference=difference,
        better=better,
    )


def _interval_text(board: Board, entry: BoardEntry, metric: Metric, digits: Digits) -> str | None:
    interval = interval_of(entry, board, board.headline, metric.key)
    if interval is None:
        return None
    return f"{digits.text(metric, interval[0])} to {digits.text(metric, interval[1])}"


def family_value(entry: BoardEntry, family: str, metric: Metric) -> float | None:
    """Return a metric of one family; None where it is unknown."""
    cell = entry.families.get(family)
    return None if cell is None else cell.metrics.get(metric.key)


def _chart(
    board: Board, a: BoardEntry, b: BoardEntry, metric: Metric, digits: Digits, width: int
) -> DumbbellChart | None:
    values = [
        (family_value(a, head.id, metric), family_value(b, head.id, metric))
        for head in board.families
    ]
    known = [value for pair in values for value in pair if value is not None]
    if not known:
        return None
    left, right = (LEFT, width - 18) if width > 400 else (102, width - 10)
    scale = nice_scale(
        [value * 100 for value in known], (left + 22, right - 30), n_ticks=5, floor=0, ceiling=100
    )
    bottom = TOP + LINE_HEIGHT * len(values)
    lines = tuple(
        _dumbbell(head.title, head.n, index, pair, metric, digits, scale)
        for index, (head, pair) in enumerate(zip(board.families, values, strict=True))
    )
    return DumbbellChart(
        width=width,
        height=bottom + 46,
        left=px(left),
        right=px(right),
        bottom=px(bottom),
        ticks=tuple((px(scale.at(t)), fixed(t, scale.tick_decimals)) for t in scale.ticks),
        lines=lines,
        axis_title=f"{metric.label} {unit_of(metric)}",
        axis_x=px((left + right) / 2),
    )


def _dumbbell(
    title: str,
    n: int,
    index: int,
    pair: tuple[float | None, float | None],
    metric: Metric,
    digits: Digits,
    scale: Scale,
) -> Dumbbell:
    a, b = pair
    positions = [None if value is None else scale.at(value * 100) for value in pair]
    known = [position for position in positions if position is not None]
    difference = None if a is None or b is None else digits.signed(metric, a - b)
    is_room_right = not known or max(known) + 62 <= scale.extent[1] + 30
    label_x = (max(known) + 12 if is_room_right else min(known) - 12) if known else scale.extent[0]
    return Dumbbell(
        label=short_title(title),
        title=title,
        y=px(TOP + LINE_HEIGHT * (index + 0.5)),
        a_x=None if positions[0] is None else px(positions[0]),
        b_x=None if positions[1] is None else px(positions[1]),
        a_text=digits.text(metric, a),
        b_text=digits.text(metric, b),
        n_text=f"n = {n}",
        difference=difference,
        difference_x=px(label_x),
        difference_anchor="start" if is_room_right else "end",
    )


def _families_sentence(
    board: Board, a: BoardEntry, b: BoardEntry, metric: Metric, digits: Digits
) -> str:
    """Name the families in which each leads, and the widest gap."""
    gaps: list[tuple[float, str]] = []
    n_known = 0
    for head in board.families:
        x, y = family_value(a, head.id, metric), family_value(b, head.id, metric)
        if x is None or y is None:
            continue
        n_known += 1
        if digits.text(metric, x) != digits.text(metric, y):
            sign = 1 if metric.better == "higher" else -1
            gaps.append((sign * (x - y), short_title(head.title).lower()))
    if not n_known:
        return "No family split is known for both."
    if not gaps:
        return "They are equal in every family."
    parts = []
    for entry, sign in ((a, 1), (b, -1)):
        names = [name for gap, name in gaps if gap * sign > 0]
        if names:
            where = (
                "in every family"
                if len(names) == len(board.families)
                else f"in {listed(names)} scenes"
            )
            parts.append(f"{entry.method} is ahead {where}")
    widest = max(gaps, key=lambda gap: abs(gap[0]))
    size = digits.text(metric, abs(widest[0]))
    return f"{'; '.join(parts)}. The widest gap is {size} points, in {widest[1]} scenes."
