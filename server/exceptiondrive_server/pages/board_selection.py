"""Which entries a visitor sees, in which order: filter, sort, blocks, pages."""

from collections.abc import Callable
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry, EntrySource
from exceptiondrive_server.pages.board_columns import default_order
from exceptiondrive_server.pages.board_query import DEFAULT_SORT, SOURCES, Average, BoardQuery
from exceptiondrive_server.pages.entry_facts import challenge_of, values_of

PAGE_ROWS = 20
_Key = Callable[[BoardEntry], float | str | None]


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
    sort = _sorter(board, query, average)
    n_scored = sum(entry.source == "scored" for entry in found)
    n_pages = max(1, -(-n_scored // PAGE_ROWS))
    number = min(query.page, n_pages)
    blocks = []
    for source in SOURCES:
        entries = sort([entry for entry in found if entry.source == source])
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


def _sorter(
    board: Board, query: BoardQuery, average: Average
) -> Callable[[list[BoardEntry]], list[BoardEntry]]:
    """Return a stable sort; entries without the value stand last in either direction."""
    key = _sort_key(board, query.sort, average)
    order = query.order or default_order(challenge_of(board), query.sort)

    def sort(entries: list[BoardEntry]) -> list[BoardEntry]:
        if query.sort == DEFAULT_SORT:
            return sorted(entries, key=_rank_order(board, average))
        known = [entry for entry in entries if key(entry) is not None]
        unknown = [entry for entry in entries if key(entry) is None]
        known.sort(key=lambda entry: key(entry) or 0, reverse=order == "descending")
        return known + unknown

    return sort


def _rank_order(board: Board, average: Average) -> Callable[[BoardEntry], tuple[float, ...]]:
    """Rank where there is one, else the first primary metric, else last."""
    metric = challenge_of(board).metrics[0]

    def order(entry: BoardEntry) -> tuple[float, ...]:
        value = values_of(entry, board, average).get(metric.key)
        by_value = 0.0 if value is None else -value if metric.better == "higher" else value
        return (entry.rank is None, entry.rank or 0, value is None, by_value)

    return order


def _sort_key(board: Board, sort: str, average: Average) -> _Key:
    challenge = challenge_of(board)
    if sort == "method":
        return lambda entry: entry.method.casefold()
    if sort == "date":
        return lambda entry: entry.submitted_at.timestamp() if entry.submitted_at else None
    if sort.startswith("family."):
        family = sort.removeprefix("family.")
        return lambda entry: (
            cell.metrics.get(challenge.metrics[0].key)
            if (cell := entry.families.get(family))
            else None
        )
    return lambda entry: values_of(entry, board, average).get(sort)
