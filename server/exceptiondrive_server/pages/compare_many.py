"""More than two entries side by side, and each against each."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.pages.comparison import family_value
from exceptiondrive_server.pages.entry_facts import (
    challenge_of,
    entry_key,
    entry_url,
    interval_of,
    values_of,
)
from exceptiondrive_server.pages.numbers import Digits, listed, unit_of
from exceptiondrive_server.pages.paired_table import NOT_SEPARABLE, find_pair

MAX_COMPARED = 6


@dataclass(frozen=True)
class ManyCell:
    """A value with what stands small under it."""

    text: str
    note: str
    is_best: bool


@dataclass(frozen=True)
class ManyLine:
    """One metric or family over all entries."""

    label: str
    cells: tuple[ManyCell, ...]


@dataclass(frozen=True)
class AgainstCell:
    """The entry of the line against that of the column: sure, open, unknown, or itself."""

    text: str
    note: str
    kind: str


@dataclass(frozen=True)
class ManyTable:
    """Everything that the page shows of more than two entries."""

    methods: tuple[tuple[str, str], ...]
    metrics: tuple[ManyLine, ...]
    families: tuple[ManyLine, ...]
    against: tuple[tuple[str, tuple[AgainstCell, ...]], ...]
    metric_label: str
    verdict: str


def many_table(
    board: Board, entries: Sequence[BoardEntry], digits: Digits, is_current: bool = True
) -> ManyTable:
    """Compare three or more entries of one board under its headline average."""
    challenge = challenge_of(board)
    first = challenge.metrics[0]
    return ManyTable(
        methods=tuple((e.method, entry_url(e, board, is_current)) for e in entries),
        metrics=tuple(_metric_line(board, entries, metric, digits) for metric in challenge.metrics),
        families=tuple(
            ManyLine(
                head.title,
                _cells([family_value(e, head.id, first) for e in entries], first, digits),
            )
            for head in board.families
        ),
        against=tuple(
            (one.method, tuple(_against(board, one, other, first, digits) for other in entries))
            for one in entries
        ),
        metric_label=first.label,
        verdict=_verdict(board, entries, first, digits),
    )


def _metric_line(
    board: Board, entries: Sequence[BoardEntry], metric: Metric, digits: Digits
) -> ManyLine:
    values = [values_of(entry, board, board.headline).get(metric.key) for entry in entries]
    notes = []
    for entry in entries:
        interval = interval_of(entry, board, board.headline, metric.key)
        ends = [digits.text(metric, end) or "" for end in interval] if interval else []
        notes.append(" to ".join(ends))
    return ManyLine(f"{metric.label} {unit_of(metric)}", _cells(values, metric, digits, notes))


def _cells(
    values: Sequence[float | None],
    metric: Metric,
    digits: Digits,
    notes: Sequence[str] | None = None,
) -> tuple[ManyCell, ...]:
    known = [value for value in values if value is not None]
    best = None
    if known and metric.better:
        best = digits.text(metric, max(known) if metric.better == "higher" else min(known))
    texts = [digits.text(metric, value) for value in values]
    return tuple(
        ManyCell(text or "none", note, text is not None and text == best)
        for text, note in zip(texts, notes or [""] * len(texts), strict=True)
    )


def _against(
    board: Board, one: BoardEntry, other: BoardEntry, first: Metric, digits: Digits
) -> AgainstCell:
    if one is other:
        return AgainstCell("", "", "self")
    x, y = one.metrics.get(first.key), other.metrics.get(first.key)
    text = "none" if x is None or y is None else digits.signed(first, x - y)
    pair = find_pair(board, entry_key(one), entry_key(other))
    if pair is None:
        return AgainstCell(text, "no interval", "unknown")
    found = pair.overall[first.key]
    if found.verdict == NOT_SEPARABLE:
        return AgainstCell(text, "not separable", "open")
    is_ahead = (found.difference or 0) > 0
    is_better = is_ahead == (first.better == "higher")
    return AgainstCell(text, "surely better" if is_better else "surely worse", "sure")


def _verdict(board: Board, entries: Sequence[BoardEntry], first: Metric, digits: Digits) -> str:
    """Say whom the leader of these is surely ahead of, and from whom the split cannot tell it."""
    sign = -1 if first.better == "higher" else 1
    known = [entry for entry in entries if entry.metrics.get(first.key) is not None]
    if not known:
        return f"None of them has {first.label}."
    leader = min(known, key=lambda entry: sign * (entry.metrics[first.key] or 0.0))
    groups: dict[str, list[str]] = {"sure": [], "open": [], "unknown": []}
    for other in entries:
        if other is not leader:
            groups[_against(board, leader, other, first, digits).kind].append(other.method)
    parts = [f"Of these, {leader.method} has the best {first.label}"]
    if groups["sure"]:
        parts.append(f"it is surely better than {listed(groups['sure'])}")
    if groups["open"]:
        parts.append(f"this split does not tell it from {listed(groups['open'], 'or')}")
    if groups["unknown"]:
        parts.append(f"against {listed(groups['unknown'])} no paired interval is known")
    return "; ".join(parts) + "."
