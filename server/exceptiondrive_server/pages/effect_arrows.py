"""What a reminder changed, as arrows: from the submission without it to the one with it."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry, ReminderEffect
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.score_sheet import Interval
from exceptiondrive_server.pages.entry_facts import challenge_of, entry_key, primary_metrics
from exceptiondrive_server.pages.numbers import Digits
from exceptiondrive_server.pages.scales import Scale, px

HEAD = 9.0
GAP = 9.0
"""Arrows end before the point that they lead to."""


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
