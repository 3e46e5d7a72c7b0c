"""The columns of the board: heads with their sort links, and which are shown."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.board import Board, BoardEntry, EntrySource
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_server.boards.entry_facts import challenge_of, values_of
from exceptiondrive_server.boards.query import BY_RANK, SOURCES, Average, BoardQuery
from exceptiondrive_server.web.numbers import unit_of

Order = Literal["ascending", "descending"]
Kind = Literal["primary", "diagnostic", "outcome", "date"]
_DIRECTION_WORDS = {
    "higher": {"descending": "best first", "ascending": "worst first"},
    "lower": {"ascending": "best first", "descending": "worst first"},
    None: {"descending": "largest first", "ascending": "smallest first"},
}
_BETTER_WORDS = {"higher": "higher is better", "lower": "lower is better", None: "not a score"}


@dataclass(frozen=True)
class Column:
    """One column head. `subscript` is set small behind the label."""

    key: str
    label: str
    subscript: str
    unit: str
    title: str
    kind: Kind
    sort_url: str | None
    aria_sort: Order | None
    sort_words: str


@dataclass(frozen=True)
class ColumnChoice:
    """A column that may be switched off."""

    key: str
    label: str
    is_shown: bool


def first_sort(challenge: Challenge, key: str) -> str:
    """Return how a column is sorted first: a metric best first, a date newest first."""
    if key == "method" or (
        key in challenge.metric_keys and challenge.metric(key).better == "lower"
    ):
        return key
    return f"-{key}"


def metric_columns(challenge: Challenge, query: BoardQuery) -> tuple[Column, ...]:
    """Return the heads of all shown metrics, in the challenge's order."""
    return tuple(
        _metric_column(challenge, metric, query)
        for metric in challenge.metrics
        if metric.key not in query.hidden
    )


def method_column(challenge: Challenge, query: BoardQuery) -> Column:
    """Return the head of the method column."""
    order, url = _sorting(challenge, query, "method")
    words = "sorted A to Z" if order == "ascending" else "sorted Z to A" if order else "sort A to Z"
    label = challenge.words.subject.capitalize()
    return Column("method", label, "", "", "Method and team", "date", url, order, words)


def date_column(challenge: Challenge, query: BoardQuery) -> Column:
    """Return the head of the date column."""
    order, url = _sorting(challenge, query, "date")
    words = {None: "sort, newest first", "descending": "sorted, newest first"}.get(
        order, "sorted, oldest first"
    )
    return Column("date", "Submitted", "", "", "Date of submission", "date", url, order, words)


def column_choices(challenge: Challenge, query: BoardQuery) -> tuple[ColumnChoice, ...]:
    """Return the columns that may be switched off: all but rank, method and primary metrics."""
    optional = [(m.key, m.label) for m in challenge.metrics if m.role == "diagnostic"]
    optional += [("outcome", "Outcome and families"), ("date", "Date")]
    return tuple(ColumnChoice(key, label, key not in query.hidden) for key, label in optional)


def _metric_column(challenge: Challenge, metric: Metric, query: BoardQuery) -> Column:
    order, url = _sorting(challenge, query, metric.key)
    first: Order = "descending" if first_sort(challenge, metric.key)[0] == "-" else "ascending"
    words = _DIRECTION_WORDS[metric.better][order or first]
    label, subscript = split_label(metric.label)
    return Column(
        key=metric.key,
        label=label,
        subscript=subscript,
        unit=unit_of(metric),
        title=f"{metric.title}, {_BETTER_WORDS[metric.better]}. {metric.meaning}",
        kind=metric.role,
        sort_url=url,
        aria_sort=order,
        sort_words=f"sorted, {words}" if order else f"sort, {words}",
    )


def split_label(label: str) -> tuple[str, str]:
    """Return the label and what is set as its subscript: `CTSx` -> `CTS`, `x`."""
    if label.startswith("CTS") and len(label) == 4:
        return label[:3], label[3:]
    return label, ""


def _sorting(challenge: Challenge, query: BoardQuery, key: str) -> tuple[Order | None, str]:
    """The direction in which `key` sorts now, if it does, and the address that sorts by it."""
    first = first_sort(challenge, key)
    is_by_rank = query.sort == BY_RANK and key == challenge.metrics[0].key
    sort = first if is_by_rank else query.sort
    if sort.removeprefix("-") != key:
        return None, query.url(sort=first)
    if sort.startswith("-"):
        return "descending", query.url(sort=key)
    return "ascending", query.url(sort=f"-{key}")


# Which entries a visitor sees, in which order: filter, sort, blocks, pages.


PAGE_ROWS = 20
_Value = Callable[[BoardEntry], float | str | None]


@dataclass(frozen=True)
class Selection:
    """The entries of one block on this page, and how many the block holds in all."""

    source: EntrySource
    entries: tuple[BoardEntry, ...]
    n_all: int


@dataclass(frozen=True)
class Page:
    """Blocks of one page of the board; only the scored block is paged."""

    blocks: tuple[Selection, ...]
    number: int
    n_pages: int
    n_found: int


def count_by_source(board: Board) -> dict[EntrySource, int]:
    """Return how many entries of each source a board holds."""
    return {source: sum(entry.source == source for entry in board.entries) for source in SOURCES}


def select(board: Board, query: BoardQuery, average: Average) -> Page:
    """Filter, sort and cut a board.

    Blocks are never mixed: scored entries first, then reference rows, then reported ones.
    """
    found = [entry for entry in board.entries if _matches(entry, query)]
    found = sort_entries(board, found, query.sort, average)
    n_scored = sum(entry.source == "scored" for entry in found)
    n_pages = max(1, -(-n_scored // PAGE_ROWS))
    number = min(query.page, n_pages)
    blocks = []
    for source in SOURCES:
        entries = [entry for entry in found if entry.source == source]
        n_all = len(entries)
        if source == "scored":
            entries = entries[(number - 1) * PAGE_ROWS : number * PAGE_ROWS]
        if entries:
            blocks.append(Selection(source, tuple(entries), n_all))
    return Page(tuple(blocks), number, n_pages, len(found))


def _matches(entry: BoardEntry, query: BoardQuery) -> bool:
    if query.source is not None and entry.source != query.source:
        return False
    haystack = f"{entry.method} {entry.team} {entry.description}".casefold()
    return all(word in haystack for word in query.search.casefold().split())


def sort_entries(
    board: Board, entries: Sequence[BoardEntry], sort: str, average: Average | None = None
) -> list[BoardEntry]:
    """Sort entries of a board within scored, reference, reported; ranks stay as they are.

    Args:
        board: The board they stand on.
        entries: Some or all of its entries.
        sort: `rank`, `method`, `date`, `family.ID` or a metric; `-` in front for descending.
            Entries without the value come last in either direction.
        average: Which average a metric is taken from; by default the headline.

    Raises:
        InvalidRecord: This board has nothing of that name to sort by.
    """
    descending, key = sort.startswith("-"), sort.removeprefix("-")
    average = average or board.headline
    value = _sort_value(board, key, average)
    known = [entry for entry in entries if value(entry) is not None]
    unknown = [entry for entry in entries if value(entry) is None]
    known.sort(key=lambda entry: value(entry) or 0, reverse=descending)
    if key == BY_RANK:  # what has no rank stands by the first metric, the best first
        unknown.sort(key=_by_first_metric(board, average))
    return sorted([*known, *unknown], key=lambda entry: SOURCES.index(entry.source))


def sorted_board(board: Board, sort: str) -> Board:
    """Return the board with its entries sorted; by rank is how boards are kept."""
    if sort == BY_RANK:
        return board
    return board.model_copy(update={"entries": tuple(sort_entries(board, board.entries, sort))})


def _by_first_metric(board: Board, average: Average) -> Callable[[BoardEntry], tuple[bool, float]]:
    metric = challenge_of(board).metrics[0]

    def order(entry: BoardEntry) -> tuple[bool, float]:
        value = values_of(entry, board, average).get(metric.key)
        return (
            value is None,
            0.0 if value is None else -value if metric.better == "higher" else value,
        )

    return order


def _sort_value(board: Board, key: str, average: Average) -> _Value:
    challenge = challenge_of(board)
    if key == BY_RANK:
        return lambda entry: entry.rank
    if key == "method":
        return lambda entry: entry.method.casefold()
    if key == "date":
        return lambda entry: entry.submitted_at.timestamp() if entry.submitted_at else None
    family = key.removeprefix("family.")
    shown = {head.id for head in board.families}
    if family != key and (family in shown or not shown):
        first = challenge.metrics[0].key
        return lambda entry: (
            cell.metrics.get(first) if (cell := entry.families.get(family)) else None
        )
    if key in challenge.metric_keys:
        return lambda entry: values_of(entry, board, average).get(key)
    words = (
        f"sort by {BY_RANK}, method, date, a family, or one of {', '.join(challenge.metric_keys)}, "
        "with - in front for descending"
    )
    raise InvalidRecord("There is nothing of that name to sort this board by.", {"sort": words})
