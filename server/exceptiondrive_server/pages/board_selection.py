"""Which entries a visitor sees, in which order: filter, sort, blocks, pages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_schemas.board import Board, BoardEntry, EntrySource
from exceptiondrive_server.pages.board_query import BY_RANK, SOURCES, Average, BoardQuery
from exceptiondrive_server.pages.entry_facts import challenge_of, values_of

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
