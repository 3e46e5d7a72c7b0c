"""The compare page: entries of one board, the first two in full, all of them side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import urlencode

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, Metric
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.boards.page import BoardReading, entry_choices
from exceptiondrive_server.boards.rows import Row, RowSetter
from exceptiondrive_server.entries.comparison import (
    Comparison,
    compare_entries,
    default_pair,
    family_value,
)
from exceptiondrive_server.entries.difference_table import (
    NOT_SEPARABLE,
    DifferenceTable,
    difference_table,
    find_pair,
)
from exceptiondrive_server.entries.facts import (
    board_fields,
    challenge_of,
    entry_key,
    entry_url,
    find_entry,
    interval_of,
    values_of,
)
from exceptiondrive_server.web.numbers import Digits, listed, unit_of
from exceptiondrive_server.web.page_parts import PhaseLink

# More than two entries side by side, and each against each.


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


@dataclass(frozen=True)
class ComparePage:
    """Everything that `compare.html` needs; `both` is None where two entries are not there."""

    phase: PhaseLink | None
    board: Board | None
    challenge: Challenge
    both: Comparison | None
    rows: tuple[Row, ...]
    choices: tuple[tuple[str, str], ...]
    differences: DifferenceTable | None = None
    many: ManyTable | None = None
    keys: tuple[str, ...] = ()
    address: str = "/compare"
    """The whole comparison on this very board, to be shared."""
    swap_url: str = "/compare"
    is_current: bool = True

    @property
    def kept_fields(self) -> tuple[tuple[str, str], ...]:
        """What the form carries on unseen: which board is compared."""
        return board_fields(self.board, self.is_current) if self.board else ()

    @property
    def picture_url(self) -> str:
        """Address of the picture that other sites show."""
        board = self.board
        fields = board_fields(board) if board and board.view == "main" else ()
        return "/pictures/board.png" + (f"?{urlencode(fields)}" if fields else "")

    @property
    def more_keys(self) -> tuple[str, ...]:
        """Keys after the first two."""
        return self.keys[2:]

    @property
    def has_room(self) -> bool:
        """Whether one more may be added."""
        return len(self.keys) < MAX_COMPARED


def wanted_keys(pairs: Sequence[tuple[str, str]]) -> tuple[str | None, str | None, tuple[str, ...]]:
    """Read `a`, `b` and any number of `more` from an address; empty ones are nobody."""
    given = dict(pairs)
    more = dict.fromkeys(value for key, value in pairs if key == "more" and value)
    return given.get("a") or None, given.get("b") or None, tuple(more)


def chosen_entries(
    reading: BoardReading, a: str | None, b: str | None, more: Sequence[str] = ()
) -> tuple[BoardEntry, ...]:
    """Return the entries named `a`, `b` and `more`; without names the two best; () if there are none.

    Raises:
        NotFound: A named entry does not stand on this board.
    """
    board = reading.board
    pair = _pair(board, a, b) if board else None
    return _all_of(board, pair, more) if board and pair else ()


def compare_page(
    reading: BoardReading, entries: Sequence[BoardEntry], sheets: Mapping[str, ScoreSheet]
) -> ComparePage:
    """Compare entries of the board that was read.

    Args:
        reading: The board.
        entries: Two or more entries of it, or none.
        sheets: Published score sheets of the first two by key, where they were scored here.
    """
    board = reading.board
    if board is None or len(entries) < 2:
        phase = reading.phase
        challenge = phase.challenge if phase else next(iter(CHALLENGES.values()))
        choices = entry_choices(board) if board else ()
        return ComparePage(phase, board, challenge, None, (), choices)
    pair = (entries[0], entries[1])
    digits = Digits.of(reading.protocol.publication)
    setter = RowSetter.of(board, board.headline, digits, is_current=reading.is_current)
    keys = tuple(entry_key(entry) for entry in entries)
    return ComparePage(
        phase=reading.phase,
        board=board,
        challenge=challenge_of(board),
        both=compare_entries(board, *pair, digits),
        rows=tuple(setter.row(entry) for entry in entries),
        choices=_choices(board, entries),
        differences=difference_table(
            board,
            reading.protocol,
            pair,
            (sheets.get(keys[0]), sheets.get(keys[1])),
            find_pair(board, keys[0], keys[1]),
            digits,
        ),
        many=many_table(board, entries, digits, reading.is_current) if len(entries) > 2 else None,
        keys=keys,
        address=_address(board_fields(board), keys),
        swap_url=_address(board_fields(board, reading.is_current), (keys[1], keys[0], *keys[2:])),
        is_current=reading.is_current,
    )


def _all_of(
    board: Board, pair: tuple[BoardEntry, BoardEntry], more: Sequence[str]
) -> tuple[BoardEntry, ...]:
    """The pair, then the others once each, as many as are compared at once."""
    found = [entry for key in more if (entry := _named(board, key)) and entry not in pair]
    return (*pair, *found)[:MAX_COMPARED]


def _choices(board: Board, entries: Sequence[BoardEntry]) -> tuple[tuple[str, str], ...]:
    """The usual choices, and whoever else is compared."""
    offered = entry_choices(board)
    missing = [e for e in entries if entry_key(e) not in dict(offered)]
    return (*offered, *((entry_key(entry), entry.method) for entry in missing))


def _address(fields: Sequence[tuple[str, str]], keys: Sequence[str]) -> str:
    given = (*fields, ("a", keys[0]), ("b", keys[1]), *(("more", key) for key in keys[2:]))
    return f"/compare?{urlencode(given)}"


def _pair(board: Board, a: str | None, b: str | None) -> tuple[BoardEntry, BoardEntry] | None:
    named = [_named(board, key) for key in (a, b)]
    fallback = default_pair(board)
    if named[0] and named[1]:
        return named[0], named[1]
    if fallback is None:
        return None
    if named[0] or named[1]:
        given = named[0] or named[1]
        assert given is not None
        other = fallback[0] if fallback[0] is not given else fallback[1]
        return (given, other) if named[0] else (other, given)
    return fallback


def _named(board: Board, key: str | None) -> BoardEntry | None:
    if not key:
        return None
    entry = find_entry(board, key)
    if entry is None:
        raise NotFound("entry on this board", key)
    return entry
