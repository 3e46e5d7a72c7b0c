"""Which entries of a board a query selects, and in which order, for page, API and exports."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.method_facts import LABELS, FactsOfBoard, MethodFacts
from exceptiondrive_server.boards.entry_facts import challenge_of, is_listed, values_of
from exceptiondrive_server.boards.query import BY_RANK, SOURCES, Average, BoardQuery, sort_words

_NOTHING_TOLD = MethodFacts()
_Value = Callable[[BoardEntry], float | str | None]


def sort_entries(
    board: Board, entries: Sequence[BoardEntry], sort: str, average: Average | None = None
) -> list[BoardEntry]:
    """Sort entries of a board within scored, reference, reported; ranks stay as they are.

    Entries that are listed without a rank stand below the others, whatever the sort. The sort is
    `rank`, `method`, `date`, `family.ID` or a metric, `-` in front for descending; without the
    value entries come last in either direction, in the order of the board. A metric is that of the
    headline, unless another average is given.

    Raises:
        InvalidRecord: This board has nothing of that name to sort by.
    """
    descending, key = sort.startswith("-"), sort.removeprefix("-")
    average = average or board.headline
    value = _sort_value(board, key, average)
    keyed = [(value(entry), entry) for entry in entries]
    known = [(found, entry) for found, entry in keyed if found is not None]
    unknown = [entry for found, entry in keyed if found is None]
    known.sort(key=lambda pair: pair[0], reverse=descending)
    found = sorted([*(e for _, e in known), *unknown], key=is_listed)
    return [entry for source in SOURCES for entry in found if entry.source == source]


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
    words = sort_words(key, challenge.metric_keys)
    raise InvalidRecord("There is nothing of that name to sort this board by.", {"sort": words})


def found_entries(board: Board, query: BoardQuery, facts: FactsOfBoard) -> list[BoardEntry]:
    """Return the entries that a query asks for: of its source, by its words and of its facts."""
    words = query.search.casefold().split()
    return [
        entry
        for entry in board.entries
        if query.source in (None, entry.source)
        and all(word in _haystack(entry) for word in words)
        and (not query.facts or _has_facts(facts_of(entry, facts), query.facts))
    ]


def _haystack(entry: BoardEntry) -> str:
    return f"{entry.method} {entry.team} {entry.description}".casefold()


def facts_of(entry: BoardEntry, facts: FactsOfBoard) -> MethodFacts:
    """Return what the team of an entry tells of it; nothing where it tells nothing."""
    told = facts.get(entry.submission_id or "")
    return told.facts if told else _NOTHING_TOLD


def _values_told(told: MethodFacts, name: str) -> tuple[str, ...]:
    value = getattr(told, name)
    return value if isinstance(value, tuple) else () if value is None else (value,)


def _has_facts(told: MethodFacts, asked: frozenset[str]) -> bool:
    """Whether of every field that is asked for any asked value is told."""
    fields = {fact.partition(":")[0] for fact in asked}
    return all(
        any(f"{name}:{value}" in asked for value in _values_told(told, name)) for name in fields
    )


class FactChip(NamedTuple):
    """A value of a fact that entries of the board have: how many, and the address that turns it."""

    title: str
    n: int
    is_on: bool
    url: str


def fact_choices(
    board: Board, query: BoardQuery, facts: FactsOfBoard
) -> list[tuple[str, list[FactChip]]]:
    """Return the facts by which a board may be filtered, by field; none that no entry has."""
    told = [facts_of(entry, facts) for entry in board.entries]
    fields = []
    for name, labels in LABELS.items():
        counts = Counter(value for each in told for value in _values_told(each, name))
        chips = []
        for value, title in labels.items():
            fact = f"{name}:{value}"
            if counts[value] or fact in query.facts:
                url = query.url(facts=query.facts ^ {fact})
                chips.append(FactChip(title, counts[value], fact in query.facts, url))
        if chips:
            fields.append((str(MethodFacts.model_fields[name].title), chips))
    return fields


def is_as_kept(query: BoardQuery) -> bool:
    """Whether a query asks for all entries in the order in which boards are kept."""
    return query.sort == BY_RANK and not (query.source or query.search or query.facts)


def selected_board(board: Board, query: BoardQuery, facts: FactsOfBoard) -> Board:
    """Return the board with the entries that a query asks for, in its order; ranks stay."""
    if is_as_kept(query):
        return board
    found = sort_entries(board, found_entries(board, query, facts), query.sort)
    return board.model_copy(update={"entries": tuple(found)})
