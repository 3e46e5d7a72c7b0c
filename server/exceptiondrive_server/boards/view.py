"""Everything the board page shows, as one value: pure, from a board and a query."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_server.boards.ceiling_chart import (
    CeilingChart,
    EffectLine,
    ceiling_chart,
    effect_lines,
)
from exceptiondrive_server.boards.columns import (
    Column,
    ColumnChoice,
    column_choices,
    count_by_source,
    date_column,
    method_column,
    metric_columns,
    select,
)
from exceptiondrive_server.boards.comparison import Comparison, default_pair
from exceptiondrive_server.boards.entry_facts import BADGES, challenge_of
from exceptiondrive_server.boards.family_tiles import HEAT_STEPS, HeatScale, short_title
from exceptiondrive_server.boards.query import AVERAGE_TITLES, BY_RANK, SOURCES, Average, BoardQuery
from exceptiondrive_server.boards.rows import Row, RowSetter
from exceptiondrive_server.web.numbers import Digits, fixed, grouped

# The family heat map: one line per entry, one cell per family.


MAX_LINES = 12


@dataclass(frozen=True)
class HeatHead:
    """The head of a family column."""

    id: str
    title: str
    short: str
    n_text: str
    share_text: str
    sort_url: str
    is_sorted: bool


@dataclass(frozen=True)
class HeatMap:
    """Heads, lines and the legend."""

    metric_label: str
    subject: str
    heads: tuple[HeatHead, ...]
    rows: tuple[Row, ...]
    n_left_out: int
    legend_top: str
    legend_steps: tuple[int, ...]


def heat_map(board: Board, heat: HeatScale, rows: Sequence[Row], query: BoardQuery) -> HeatMap:
    """Return the heat map of the rows on this page, the first twelve of them."""
    total = sum(head.n for head in board.families) or 1
    heads = tuple(
        HeatHead(
            id=head.id,
            title=head.title,
            short=short_title(head.title),
            n_text=f"n = {grouped(head.n)}",
            share_text=f"{fixed(100 * head.n / total, 1)} % of samples",
            sort_url=query.url(sort=f"-family.{head.id}", anchor="families"),
            is_sorted=query.sort_key == f"family.{head.id}",
        )
        for head in board.families
    )
    return HeatMap(
        metric_label=heat.metric.label,
        subject=challenge_of(board).words.subject.capitalize(),
        heads=heads,
        rows=tuple(rows[:MAX_LINES]),
        n_left_out=max(0, len(rows) - MAX_LINES),
        legend_top=fixed(heat.top * 100, 0),
        legend_steps=tuple(range(HEAT_STEPS)),
    )


@dataclass(frozen=True)
class SourceLink:
    """A filter by source."""

    title: str
    count: int
    url: str
    is_current: bool


@dataclass(frozen=True)
class Block:
    """Rows of one source, under their own heading."""

    source: str
    title: str
    note: str
    rows: tuple[Row, ...]
    n_all: int


@dataclass(frozen=True)
class AxisEnds:
    """Ends of a shared axis, written in the column head, and the leader's line."""

    low: str
    high: str
    leader: float | None


@dataclass(frozen=True)
class PageLinks:
    """Where to go on in a long board."""

    number: int
    n_pages: int
    previous_url: str | None
    next_url: str | None


@dataclass(frozen=True)
class BoardView:
    """The board as a page shows it."""

    board: Board
    challenge: Challenge
    query: BoardQuery
    average: Average
    average_words: str
    is_headline: bool
    columns: tuple[Column, ...]
    method_column: Column
    date_column: Column
    choices: tuple[ColumnChoice, ...]
    sources: tuple[SourceLink, ...]
    blocks: tuple[Block, ...]
    axes: dict[str, AxisEnds]
    outcome_words: dict[str, str]
    pages: PageLinks
    n_found: int
    chart: CeilingChart | None
    narrow_chart: CeilingChart | None
    heat: HeatMap
    comparison: Comparison | None
    sort_sentence: str
    effects: tuple[EffectLine, ...]

    @property
    def shows_outcome(self) -> bool:
        """Whether the outcome column is on."""
        return "outcome" not in self.query.hidden

    @property
    def shows_date(self) -> bool:
        """Whether the date column is on."""
        return "date" not in self.query.hidden

    @property
    def n_columns(self) -> int:
        """Columns of the table."""
        return 2 + len(self.columns) + self.shows_outcome + self.shows_date


_BLOCK_TITLES = {
    "scored": "Scored by this server",
    "reference": "Reference rows",
    "reported": "Reported in the paper",
}


def board_view(
    board: Board, protocol: Protocol, query: BoardQuery, is_current: bool = True
) -> BoardView:
    """Set a board for a query."""
    challenge = challenge_of(board)
    offered = {choice.key for choice in column_choices(challenge, query)}
    query = query.model_copy(update={"hidden": query.hidden & offered})
    average: Average = query.average or board.headline
    digits = Digits.of(protocol.publication)
    setter = RowSetter.of(board, average, digits, query.hidden, is_current)
    page = select(board, query, average)
    blocks = tuple(
        Block(
            source=part.source,
            title=_BLOCK_TITLES[part.source],
            note=_block_note(part.source, board, average),
            rows=tuple(setter.row(entry) for entry in part.entries),
            n_all=part.n_all,
        )
        for part in page.blocks
    )
    rows = [row for block in blocks for row in block.rows]
    drawn = [row.entry for row in rows]
    pair = default_pair(board)
    return BoardView(
        board=board,
        challenge=challenge,
        query=query,
        average=average,
        average_words=AVERAGE_TITLES[average],
        is_headline=average == board.headline,
        columns=metric_columns(challenge, query),
        method_column=method_column(challenge, query),
        date_column=date_column(challenge, query),
        choices=column_choices(challenge, query),
        sources=_source_links(board, query),
        blocks=blocks,
        axes={key: _axis_ends(setter, key) for key in setter.axes},
        outcome_words={str(k): v for k, v in challenge.words.outcome.items()},
        pages=_page_links(query, page.number, page.n_pages),
        n_found=page.n_found,
        chart=ceiling_chart(board, drawn, average) if pair else None,
        narrow_chart=ceiling_chart(board, drawn, average, width=350, height=400) if pair else None,
        heat=heat_map(board, setter.heat, rows, query),
        comparison=Comparison(board, *pair, digits) if pair else None,
        effects=effect_lines(board, digits),
        sort_sentence=_sort_sentence(challenge, query, metric_columns(challenge, query)),
    )


def _block_note(source: str, board: Board, average: Average) -> str:
    if source == "scored":
        return (
            "Ranked by the protocol's headline average; this view shows the other one."
            if average != board.headline
            else ""
        )
    if source == "reference":
        return "Yardsticks scored by the same code, never ranked."
    other = "" if average == board.headline else " The paper prints one average only."
    return BADGES["reported"].meaning + other


def _source_links(board: Board, query: BoardQuery) -> tuple[SourceLink, ...]:
    counts = count_by_source(board)
    links = [SourceLink("All", len(board.entries), query.url(source=None), query.source is None)]
    links += [
        SourceLink(
            BADGES[source].word, counts[source], query.url(source=source), query.source == source
        )
        for source in SOURCES
        if counts[source] or query.source == source or source == "scored"
    ]
    return tuple(links)


def _axis_ends(setter: RowSetter, key: str) -> AxisEnds:
    low, high = setter.axes[key].domain
    return AxisEnds(fixed(low * 100, 0), fixed(high * 100, 0), setter.leader_line(key))


def _page_links(query: BoardQuery, number: int, n_pages: int) -> PageLinks:
    return PageLinks(
        number=number,
        n_pages=n_pages,
        previous_url=query.url(page=number - 1) if number > 1 else None,
        next_url=query.url(page=number + 1) if number < n_pages else None,
    )


def _sort_sentence(challenge: Challenge, query: BoardQuery, columns: Sequence[Column]) -> str:
    if query.sort == BY_RANK:
        return f"Sorted by rank: {challenge.metrics[0].label}, then {challenge.metrics[1].label}."
    column = next((column for column in columns if column.key == query.sort_key), None)
    if column:
        return f"{column.label}{column.subscript} {column.sort_words}; ranks stay as they are."
    if query.sort_key.startswith("family."):
        return "Sorted by one family; ranks stay as they are."
    return f"Sorted by {query.sort_key}; ranks stay as they are."
