"""The rows of the board: who, which rank, which numbers, which marks."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_server.boards.entry_facts import (
    BADGES,
    Badge,
    challenge_of,
    entry_key,
    entry_url,
    interval_of,
    outcome_parts,
    primary_metrics,
    values_of,
)
from exceptiondrive_server.boards.family_tiles import FamilyTile, HeatScale, family_tiles
from exceptiondrive_server.boards.query import Average
from exceptiondrive_server.boards.scales import Scale, nice_scale
from exceptiondrive_server.web.numbers import DASH, Digits, day, iso


@dataclass(frozen=True)
class Whisker:
    """A value and its interval on the shared axis of its column, in per cent of the width."""

    point: float
    low: float | None
    width: float | None
    is_outside: bool
    words: str


@dataclass(frozen=True)
class Cell:
    """One metric of one row; `text` is None where it is undefined or was not reported."""

    key: str
    label: str
    role: str
    text: str | None
    is_best: bool
    whisker: Whisker | None


@dataclass(frozen=True)
class Movement:
    """How the rank changed since the last board."""

    kind: str
    steps: str
    words: str


@dataclass(frozen=True)
class OutcomeBar:
    """HCC + lost clearance + UR = 100 %, in per cent of the bar."""

    kept: float
    lost: float
    hit: float
    words: str


@dataclass(frozen=True)
class Row:
    """One row of the board, ready to be set."""

    key: str
    entry: BoardEntry
    url: str
    rank: str | None
    rank_interval: str | None
    rank_words: str
    movement: Movement | None
    badge: Badge
    cells: tuple[Cell, ...]
    outcome: OutcomeBar | None
    tiles: tuple[FamilyTile, ...]
    date: str | None
    date_iso: str | None


@dataclass(frozen=True)
class RowSetter:
    """What all rows of one board share: average, digits, axes, best values, heat scale."""

    board: Board
    challenge: Challenge
    average: Average
    digits: Digits
    axes: dict[str, Scale]
    best: dict[str, str]
    heat: HeatScale
    hidden: frozenset[str]
    is_current: bool = True

    @classmethod
    def of(
        cls,
        board: Board,
        average: Average,
        digits: Digits,
        hidden: frozenset[str] = frozenset(),
        is_current: bool = True,
    ) -> "RowSetter":
        """Prepare axes and best values from all entries of a board."""
        challenge = challenge_of(board)
        return cls(
            board=board,
            challenge=challenge,
            average=average,
            digits=digits,
            axes={m.key: _axis(board, average, m) for m in primary_metrics(challenge)},
            best=_best(board, challenge, average, digits),
            heat=HeatScale.of(board, challenge.metrics[0]),
            hidden=hidden,
            is_current=is_current,
        )

    def row(self, entry: BoardEntry) -> Row:
        """Set one entry."""
        key = entry_key(entry)
        return Row(
            key=key,
            entry=entry,
            url=entry_url(entry, self.board, self.is_current),
            rank=None if entry.rank is None else str(entry.rank),
            rank_interval=_rank_interval(entry),
            rank_words=_rank_words(entry),
            movement=_movement(entry, self.board),
            badge=BADGES[entry.source],
            cells=tuple(
                self._cell(entry, m) for m in self.challenge.metrics if m.key not in self.hidden
            ),
            outcome=self.outcome(entry),
            tiles=family_tiles(entry, self.board, self.heat, self.digits),
            date=day(entry.submitted_at) if entry.submitted_at else None,
            date_iso=iso(entry.submitted_at) if entry.submitted_at else None,
        )

    def leader_line(self, key: str) -> float | None:
        """Return where the leader's nearer interval end stands on an axis, in per cent."""
        metric = self.challenge.metric(key)
        leader = next((entry for entry in self.board.entries if entry.rank == 1), None)
        interval = interval_of(leader, self.board, self.average, key) if leader else None
        if interval is None:
            return None
        return self.axes[key].clamped(interval[0 if metric.better == "higher" else 1])

    def outcome(self, entry: BoardEntry) -> OutcomeBar | None:
        """Return the outcome bar of an entry, or None where a part is undefined."""
        parts = outcome_parts(self.challenge, values_of(entry, self.board, self.average))
        if parts is None:
            return None
        text = {name: self.digits.fraction(share) for name, share in parts.items()}
        first, second = primary_metrics(self.challenge)[:2]
        between = self.challenge.words.outcome["lost"]
        words = (
            f"{first.label} {text['kept']} %, {between} {text['lost']} %, "
            f"{second.label} {text['hit']} %"
        )
        return OutcomeBar(parts["kept"] * 100, parts["lost"] * 100, parts["hit"] * 100, words)

    def _cell(self, entry: BoardEntry, metric: Metric) -> Cell:
        value = values_of(entry, self.board, self.average).get(metric.key)
        text = self.digits.text(metric, value)
        return Cell(
            key=metric.key,
            label=metric.label,
            role=metric.role,
            text=text,
            is_best=entry.source == "scored"
            and text is not None
            and text == self.best.get(metric.key),
            whisker=self._whisker(entry, metric, value),
        )

    def _whisker(self, entry: BoardEntry, metric: Metric, value: float | None) -> Whisker | None:
        if metric.key not in self.axes or value is None:
            return None
        axis = self.axes[metric.key]
        interval = interval_of(entry, self.board, self.average, metric.key)
        if interval is None:
            return Whisker(axis.clamped(value), None, None, not axis.holds(value), "")
        low, high = axis.clamped(interval[0]), axis.clamped(interval[1])
        words = (
            f"{self.board.confidence:.0%} interval {self.digits.text(metric, interval[0])} "
            f"to {self.digits.text(metric, interval[1])}"
        )
        return Whisker(axis.clamped(value), low, high - low, not axis.holds(value), words)


def _axis(board: Board, average: Average, metric: Metric) -> Scale:
    """One axis for the column; reference rows do not stretch it."""
    entries: Sequence[BoardEntry] = [e for e in board.entries if e.source != "reference"]
    values: list[float] = []
    for entry in entries or board.entries:
        value = values_of(entry, board, average).get(metric.key)
        interval = interval_of(entry, board, average, metric.key)
        values += [] if value is None else [value]
        values += [] if interval is None else list(interval)
    return nice_scale(values, (0.0, 100.0), n_ticks=4, floor=0.0, ceiling=1.0)


def _best(board: Board, challenge: Challenge, average: Average, digits: Digits) -> dict[str, str]:
    """Best published text per metric that has a direction, among ranked entries."""
    best: dict[str, str] = {}
    ranked = [entry for entry in board.entries if entry.rank is not None]
    for metric in primary_metrics(challenge):
        known = [
            v for e in ranked if (v := values_of(e, board, average).get(metric.key)) is not None
        ]
        if known:
            value = max(known) if metric.better == "higher" else min(known)
            best[metric.key] = digits.text(metric, value) or ""
    return best


def _rank_interval(entry: BoardEntry) -> str | None:
    if entry.rank is None or entry.rank_interval is None:
        return None
    low, high = entry.rank_interval
    return str(low) if low == high else f"{low}{DASH}{high}"


def _rank_words(entry: BoardEntry) -> str:
    if entry.rank is None:
        return entry.unranked_because or BADGES[entry.source].meaning
    if entry.rank_interval is None:
        return f"rank {entry.rank}"
    low, high = entry.rank_interval
    return f"rank {entry.rank}; the intervals allow {low} to {high}"


def _movement(entry: BoardEntry, board: Board) -> Movement | None:
    if entry.rank is None or board.board <= 1 or board.view == "late":
        return None
    if entry.previous_rank is None:
        return Movement("new", "new", "new on this board")
    steps = entry.previous_rank - entry.rank
    if steps == 0:
        return None
    kind = "up" if steps > 0 else "down"
    return Movement(kind, str(abs(steps)), f"{kind} {abs(steps)} since the last board")
