"""The table of a board: rows and columns in order, with their whiskers and tiles.

Pure: computed from a board, the protocol's digits and a query.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from exceptiondrive_schemas.board import Board, BoardEntry, EntrySource
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.method_facts import NO_FACTS, FactsOfBoard
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument, RankingSection
from exceptiondrive_schemas.score_sheet import Interval, MetricRow
from exceptiondrive_server.boards.entry_facts import (
    BADGES,
    Badge,
    challenge_of,
    entry_key,
    entry_url,
    interval_of,
    is_listed,
    outcome_parts,
    primary_metrics,
    too_few_answers,
    values_of,
)
from exceptiondrive_server.boards.headline import what_else_tells
from exceptiondrive_server.boards.query import (
    AVERAGE_TITLES,
    BY_RANK,
    PAGE_ROWS,
    SOURCES,
    Average,
    BoardQuery,
)
from exceptiondrive_server.boards.selection import (
    FactChip,
    fact_choices,
    found_entries,
    sort_entries,
)
from exceptiondrive_server.web.numbers import (
    DASH,
    Digits,
    Scale,
    grouped,
    nice_scale,
    percent,
    unit_of,
    with_unit,
)

HEAT_STEPS = 10
HEAT_ROWS = 12
SMALL_FAMILY = 30
WIDE_COLUMNS = 9
NO_OTHER = "certain at {}"
"""What is said of an entry whose range of ranks is its rank alone."""


@dataclass(frozen=True)
class Whisker:
    """A value and its interval on the shared axis of its column, in per cent of the width."""

    point: float
    low: float | None
    width: float | None
    words: str


@dataclass(frozen=True)
class Cell:
    """One metric of one row; `text` is None where it is undefined or was not reported.

    `brief` has fewer decimals than `text`, `spread` is `±2.1`, `words` say all of it exactly.
    """

    key: str
    label: str
    role: str
    text: str | None
    brief: str | None
    spread: str
    words: str
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
    """Shares of samples: kind, start and width of each part in per cent of the bar."""

    parts: tuple[tuple[str, float, float], ...]
    words: str


@dataclass(frozen=True)
class FamilyTile:
    """The first metric in one family of one entry, as heat; `text` is None where it is unknown."""

    n_text: str
    text: str | None
    step: int | None
    is_best: bool
    is_small: bool
    interval: str | None
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
    tag: str
    """What kind of method its team says it is, in a word."""
    cells: tuple[Cell, ...]
    outcome: OutcomeBar | None
    tiles: tuple[FamilyTile, ...]

    @property
    def is_listed(self) -> bool:
        """Whether it is scored and takes no rank."""
        return is_listed(self.entry)


@dataclass(frozen=True)
class RowBuilder:
    """What all rows of one board share: axes, best values, the top of the heat scale.

    All come from every entry of the board, whatever page of it is shown; `query` names the columns.
    """

    board: Board
    average: Average
    digits: Digits
    query: BoardQuery = field(default_factory=BoardQuery)
    is_current: bool = True
    facts: FactsOfBoard = field(default_factory=lambda: NO_FACTS)

    @cached_property
    def challenge(self) -> Challenge:
        """The challenge of the board."""
        return challenge_of(self.board)

    @cached_property
    def first(self) -> Metric:
        """The first metric of the challenge, by which families are compared."""
        return self.challenge.metrics[0]

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """The metrics that are columns."""
        return shown_metrics(self.challenge, self.query)

    @cached_property
    def axes(self) -> dict[str, Scale]:
        """One axis for the column of each primary metric.

        Reference rows do not stretch it, and alone they stand on the whole of it.
        """
        entries = [entry for entry in self.board.entries if entry.source != "reference"]
        axes = {}
        for metric in primary_metrics(self.challenge):
            values = [] if entries else [0.0, 1.0]
            for entry in entries:
                value = values_of(entry, self.board, self.average).get(metric.key)
                values += [] if value is None else [value]
                values += interval_of(entry, self.board, self.average, metric.key) or ()
            axes[metric.key] = nice_scale(values, (0.0, 100.0), n_ticks=4, floor=0.0, ceiling=1.0)
        return axes

    @cached_property
    def _rivals(self) -> list[BoardEntry]:
        """The entries that may lead: none where there is only one, which is the best of nobody."""
        fit = [entry for entry in self.board.entries if entry.may_lead]
        return fit if len(fit) > 1 else []

    @cached_property
    def _best_texts(self) -> dict[str, str | None]:
        """Best published text per primary metric."""
        rows = [values_of(entry, self.board, self.average) for entry in self._rivals]
        return {
            metric.key: self.digits.best(metric, (row.get(metric.key) for row in rows))
            for metric in primary_metrics(self.challenge)
        }

    @cached_property
    def _best_by_family(self) -> dict[str, float]:
        """Best value of the first metric in each family."""
        best: dict[str, float] = {}
        better = min if self.first.better == "lower" else max
        for entry in self._rivals:
            for family, cell in entry.families.items():
                value = cell.metrics.get(self.first.key)
                if value is not None:
                    best[family] = better(best.get(family, value), value)
        return best

    @cached_property
    def heat_top(self) -> float:
        """A round maximum over the family cells of the ranked entries, as a fraction.

        Of all that are scored where none is ranked, of the reference rows where nothing else is
        scored. A planner without a rank, such as one that only brakes, does not wash out the colours
        of the others.
        """
        scored = [entry for entry in self.board.entries if entry.source != "reference"]
        ranked = [entry for entry in scored if entry.rank is not None]
        values = [
            value
            for entry in ranked or scored or self.board.entries
            for cell in entry.families.values()
            if (value := cell.metrics.get(self.first.key)) is not None
        ]
        return nice_scale(values, (0, 1), n_ticks=6, include=(0.0, 0.05), ceiling=1.0).domain[1]

    def row(self, entry: BoardEntry) -> Row:
        """Build one row."""
        told = self.facts.get(entry.submission_id or "")
        values = values_of(entry, self.board, self.average)
        return Row(
            key=entry_key(entry),
            entry=entry,
            url=entry_url(entry, self.board, self.is_current),
            rank=None if entry.rank is None else str(entry.rank),
            rank_interval=_rank_interval(entry),
            rank_words=_rank_words(entry, self.board),
            movement=_movement(entry, self.board),
            badge=BADGES[entry.source],
            tag=told.facts.tag if told else "",
            cells=tuple([self._cell(entry, m, values.get(m.key)) for m in self.metrics]),
            outcome=outcome_bar(self.challenge, values, self.digits),
            tiles=self._tiles(entry),
        )

    def _cell(self, entry: BoardEntry, metric: Metric, value: float | None) -> Cell:
        text = self.digits.text(metric, value)
        is_best = entry.may_lead and text is not None and text == self._best_texts.get(metric.key)
        axis = self.axes.get(metric.key)
        interval = interval_of(entry, self.board, self.average, metric.key)
        words = "" if text is None else f"{metric.label} {with_unit(metric, text)}"
        spread = "" if interval is None else self._interval_words(metric, interval)
        return Cell(
            key=metric.key,
            label=metric.label,
            role=metric.role,
            text=text,
            brief=self.digits.brief(metric, value),
            spread=self.digits.spread(metric, value, interval)
            if interval and value is not None
            else "",
            words=f"{words}, {spread}" if spread else words,
            is_best=is_best,
            whisker=_whisker(value, interval, axis, spread)
            if axis is not None and value is not None and axis.holds(value)
            else None,
        )

    def _interval_words(self, metric: Metric, interval: Interval) -> str:
        return f"{percent(self.board.confidence)} interval {self.digits.interval(metric, interval)}"

    def _tiles(self, entry: BoardEntry) -> tuple[FamilyTile, ...]:
        """One tile per family of the board, in its order; none if the entry has none."""
        if not entry.families:
            return ()
        return tuple([self._tile(entry, head.id, head.title) for head in self.board.families])

    def _tile(self, entry: BoardEntry, family: str, title: str) -> FamilyTile:
        metric, cell = self.first, entry.families.get(family)
        value = cell.metrics.get(metric.key) if cell else None
        n = cell.n if cell else None
        text = self.digits.text(metric, value)
        interval = cell.intervals.get(metric.key) if cell else None
        n_text = "n not told" if n is None else f"n = {grouped(n)}"
        return FamilyTile(
            n_text=n_text,
            text=text,
            step=None if value is None else self.heat_step(metric, value),
            is_best=entry.may_lead
            and value is not None
            and value == self._best_by_family.get(family),
            is_small=n is not None and n < SMALL_FAMILY,
            interval=self.digits.interval(metric, interval) or None,
            words=f"{title}: not told" if text is None else f"{title} {text} %, {n_text}",
        )

    def heat_step(self, metric: Metric, value: float) -> int:
        """Return 0 to 9; for a metric of which less is better it is reversed."""
        share = min(max(value / self.heat_top, 0.0), 1.0)
        step = min(int(share * HEAT_STEPS), HEAT_STEPS - 1)
        return HEAT_STEPS - 1 - step if metric.better == "lower" else step


def _whisker(value: float, interval: Interval | None, axis: Scale, words: str) -> Whisker:
    if interval is None:
        return Whisker(axis.at(value), None, None, "")
    low, high = axis.clamped(interval[0]), axis.clamped(interval[1])
    return Whisker(axis.at(value), low, high - low, words)


def short_title(title: str) -> str:
    """Return a family title for a narrow column: `Road-Surface Hazard` -> `Road-surface`."""
    return title.capitalize().removesuffix(" conflict").removesuffix(" hazard")


def outcome_bar(challenge: Challenge, values: MetricRow, digits: Digits) -> OutcomeBar | None:
    """Return the outcome bar of a row of metrics, or None where a part is undefined."""
    shares = outcome_parts(challenge, values)
    if shares is None:
        return None
    words = ", ".join([f"{part.words} {digits.fraction(share)} %" for part, share in shares])
    drawn, start = [], 0.0
    for part, share in shares:
        drawn.append((part.kind, start, share * 100))
        start += share * 100
    return OutcomeBar(tuple(drawn), words)


def _rank_interval(entry: BoardEntry) -> str | None:
    if entry.rank is None or entry.rank_interval is None:
        return None
    low, high = entry.rank_interval
    return f"{low}{DASH}{high}" if low < high else None


def _rank_words(entry: BoardEntry, board: Board) -> str:
    if entry.rank is None:
        return entry.unranked_because or BADGES[entry.source].meaning
    if entry.rank_interval is None:
        return f"rank {entry.rank}"
    low, high = entry.rank_interval
    if low < high:
        return f"rank {entry.rank}; it could be any from {low} to {high}"
    return f"rank {entry.rank}; {NO_OTHER.format(percent(board.confidence))}"


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


Order = Literal["ascending", "descending"]
_DIRECTION_WORDS: Mapping[str | None, Mapping[Order, str]] = {
    "higher": {"descending": "best first", "ascending": "worst first"},
    "lower": {"ascending": "best first", "descending": "worst first"},
    None: {"descending": "largest first", "ascending": "smallest first"},
    "method": {"ascending": "A to Z", "descending": "Z to A"},
    "date": {"descending": "newest first", "ascending": "oldest first"},
}
"""Of each way in which a metric is better, and of what is no metric: the direction that is asked for first,
and the other."""
_BETTER_WORDS = {"higher": "higher is better", "lower": "lower is better", None: "not a score"}


@dataclass(frozen=True)
class Column:
    """One column head. `subscript` is set small behind the label, `plain` above it."""

    key: str
    plain: str
    label: str
    subscript: str
    unit: str
    title: str
    kind: str
    sort_url: str
    aria_sort: Order | None
    sort_words: str


def metric_columns(
    challenge: Challenge, query: BoardQuery, ranks_by: str | None = None
) -> tuple[Column, ...]:
    """Return the heads of all shown metrics, in the challenge's order.

    `ranks_by` is the metric in whose order the rows stand by rank; None where that is none shown.
    """
    shown = shown_metrics(challenge, query)
    return tuple([_metric_column(challenge, metric, query, ranks_by) for metric in shown])


def shown_metrics(challenge: Challenge, query: BoardQuery) -> tuple[Metric, ...]:
    """Return the metrics that are columns: those not switched off, and the extra ones asked for."""
    off, extra = query.hidden, query.added
    kinds = {"column": lambda key: key not in off, "extra column": lambda key: key in extra}
    return tuple([m for m in challenge.metrics if m.shown in kinds and kinds[m.shown](m.key)])


def _metric_column(
    challenge: Challenge, metric: Metric, query: BoardQuery, ranks_by: str | None
) -> Column:
    is_component = metric.label.startswith("CTS") and len(metric.label) == 4
    return Column(
        metric.key,
        metric.plain,
        metric.label[:3] if is_component else metric.label,
        metric.label[3:] if is_component else "",
        unit_of(metric),
        f"{metric.title}, {_BETTER_WORDS[metric.better]}. {metric.meaning}",
        metric.role,
        *_sorting(query, metric.key, metric.better, is_by_rank=metric.key == ranks_by),
    )


def _sorting(
    query: BoardQuery, key: str, way: str | None, *, is_by_rank: bool = False
) -> tuple[str, Order | None, str]:
    """The address that sorts by a column, the direction in which it sorts now, if it does, and words."""
    words = _DIRECTION_WORDS[way]
    first, other = words
    order: Order | None = None
    if query.sort_key == key:
        order = "descending" if query.sort.startswith("-") else "ascending"
    elif query.sort == BY_RANK and is_by_rank:
        order = first
    asked = other if order == first else first
    url = query.url(sort=key if asked == "ascending" else f"-{key}", anchor=f"s-{key}")
    return url, order, f"sorted, {words[order]}" if order else f"sort, {words[first]}"


@dataclass(frozen=True)
class Block:
    """Rows of one source: those of this page."""

    source: EntrySource
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class BoardTable:
    """The rows of one page of a board; only the scored block is paged.

    `query` holds no hidden column that cannot be hidden.
    """

    board: Board
    query: BoardQuery
    builder: RowBuilder
    blocks: tuple[Block, ...]
    number: int
    n_pages: int
    n_found: int
    ranking: RankingSection

    @property
    def average_words(self) -> str:
        """Over what the metrics are averaged."""
        return AVERAGE_TITLES[self.builder.average]

    @cached_property
    def first_axis(self) -> tuple[str, str]:
        """Where the lines of the first column, a share, begin and end, in per cent."""
        low, high = self.builder.axes[self.builder.first.key].domain
        return f"{100 * low:g}", f"{100 * high:g}"

    @property
    def small_family(self) -> int:
        """Below so many samples a family is small."""
        return SMALL_FAMILY

    @cached_property
    def first_of_all(self) -> Mapping[str, BoardEntry]:
        """The entries that could be the first, by the keys of their rows, which are marked."""
        first = self.ranking.order_of(self.builder.challenge)[0]
        return {entry_key(entry): entry for entry in self.board.contenders(first)}

    @cached_property
    def first_sentence(self) -> str:
        """Say which rows are marked."""
        found = [*self.first_of_all.values()]
        if not found:
            return ""
        told_by = what_else_tells(self.board, found)
        if len(found) == 1:
            return f"Marked at the left: {found[0].method}, which alone could be first{told_by}."
        return f"Marked at the left: the {len(found)} that could be first{told_by}."

    @cached_property
    def best_sentence(self) -> str:
        """Say what a highlighted number is, where there is one."""
        is_shown = any(cell.is_best for row in self.rows for cell in row.cells)
        return "Highlighted: the best value in its column that may lead." if is_shown else ""

    @property
    def is_headline(self) -> bool:
        """Whether the average is the one that ranks."""
        return self.builder.average == self.board.headline

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """All rows of this page."""
        return tuple([row for block in self.blocks for row in block.rows])

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Heads of all shown metrics."""
        first = self.ranking.order_of(self.builder.challenge)[0].metric
        return metric_columns(
            self.builder.challenge, self.query, first if self.is_headline else None
        )

    @cached_property
    def method_column(self) -> Column:
        """Head of the column of methods."""
        label = self.builder.challenge.words.subject.capitalize()
        sorting = _sorting(self.query, "method", "method")
        return Column("method", "", label, "", "", "Method and team", "date", *sorting)

    @cached_property
    def date_column(self) -> Column | None:
        """Head of the column of dates, if it is shown."""
        if "date" not in self.query.added:
            return None
        sorting = _sorting(self.query, "date", "date")
        return Column("date", "", "Submitted", "", "", "Date of submission", "date", *sorting)

    @cached_property
    def fact_choices(self) -> list[tuple[str, list[FactChip]]]:
        """The facts by which these rows may be filtered, by field."""
        return fact_choices(self.board, self.query, self.builder.facts)

    @property
    def row_choices(self) -> list[tuple[str, str, bool]]:
        """How many rows a page may have: value, words, whether it is so now."""
        return [(rows, rows, rows == self.query.rows) for rows in PAGE_ROWS]

    @property
    def is_wide(self) -> bool:
        """Whether there are more columns than fit on a desktop screen."""
        return self.n_columns > WIDE_COLUMNS

    @cached_property
    def sort_choices(self) -> list[tuple[str, str, bool]]:
        """What a reader may sort by without the head of the table, as `row_choices`."""
        offered = [(BY_RANK, "rank"), ("method", "name"), ("-date", "newest first")]
        for column in self.columns:
            metric = self.builder.challenge.metric(column.key)
            for order, words in _DIRECTION_WORDS[metric.better].items():
                sort = metric.key if order == "ascending" else f"-{metric.key}"
                offered.append((sort, f"{metric.label}, {words}"))
        for id, _, short, *_ in self.family_heads:
            offered.append((f"-family.{id}", f"{self.builder.first.label} in {short.lower()}"))
        if self.query.sort not in dict(offered):
            offered.append((self.query.sort, self.query.sort))
        return [(key, words, key == self.query.sort) for key, words in offered]

    @cached_property
    def page_numbers(self) -> list[int | None]:
        """The numbers of the first and last page and of those about this one; None is a gap."""
        near = {1, self.n_pages, *range(self.number - 2, self.number + 3)}
        numbers: list[int | None] = []
        for number in sorted(near & set(range(1, self.n_pages + 1))):
            if numbers and number - (numbers[-1] or 0) > 1:
                numbers.append(None)
            numbers.append(number)
        return numbers

    @property
    def found_sentence(self) -> str:
        """Say how many entries a search finds; nothing where none is asked for."""
        if not (self.query.search or self.query.source or self.query.facts):
            return ""
        words = self.builder.challenge.words
        count = counted(self.n_found, words.subject, words.subjects)
        looked = f" for \u201c{self.query.search}\u201d" if self.query.search else ""
        return f"{count} of {grouped(len(self.board.entries))} found{looked}."

    @property
    def shows_outcome(self) -> bool:
        """Whether the outcome column is shown."""
        return "outcome" not in self.query.hidden

    @property
    def n_columns(self) -> int:
        """Columns of the table."""
        return 2 + len(self.columns) + self.shows_outcome + (self.date_column is not None)

    @cached_property
    def optional_columns(self) -> list[tuple[str, str]]:
        """Key and label of each column that may be switched off."""
        return _optional_columns(self.builder.challenge)

    @cached_property
    def extra_columns(self) -> list[tuple[str, str]]:
        """Key and label of each column that is off unless it is asked for."""
        return _extra_columns(self.builder.challenge)

    @cached_property
    def sources(self) -> list[tuple[EntrySource | None, str, int]]:
        """Source, title and count of each filter by source."""
        counts = {source: 0 for source in SOURCES}
        for entry in self.board.entries:
            counts[entry.source] += 1
        kept = [
            (source, BADGES[source].word, count)
            for source, count in counts.items()
            if count or source in ("scored", self.query.source)
        ]
        return [(None, "All", len(self.board.entries)), *kept]

    def heading(self, source: EntrySource, are_listed: bool) -> tuple[str, str]:
        """Return title and note over the rows of a source; empty where they need none."""
        if source == "reference":
            return "Reference rows", "Yardsticks scored by the same code, never ranked."
        if are_listed:
            return "Listed without a rank", "Scored like the others; each row says what it lacks."
        if self.is_headline:
            return "", ""
        words = "Ranked by the protocol's headline average; this view shows the other one."
        return "Scored by this server", words

    def lacks(self, entry: BoardEntry) -> str:
        """Say in a few words why a scored entry takes no rank."""
        labels = [flag.label for flag in entry.flags if flag.code in entry.unranked_flags]
        labels += too_few_answers(entry, self.ranking, self.builder.digits)
        return ", ".join(labels) or _rank_words(entry, self.board)

    @cached_property
    def sort_sentence(self) -> str:
        """Say how the rows are sorted."""
        query, challenge = self.query, self.builder.challenge
        if query.sort == BY_RANK:
            order = self.ranking.order_of(challenge)
            labels = ", then ".join([challenge.metric(key.metric).label for key in order])
            average = "" if self.is_headline else f" of the {AVERAGE_TITLES[self.board.headline]}"
            return f"Sorted by rank{average}: {labels}."
        column = next((column for column in self.columns if column.key == query.sort_key), None)
        if column:
            return f"{column.label}{column.subscript} {column.sort_words}; ranks stay as they are."
        if query.sort_key.startswith("family."):
            return "Sorted by one family; ranks stay as they are."
        return f"Sorted by {query.sort_key}; ranks stay as they are."

    @property
    def heat_rows(self) -> tuple[Row, ...]:
        """The rows of the heat map."""
        return self.rows[:HEAT_ROWS]

    @cached_property
    def family_heads(self) -> list[tuple[str, str, str, int, float]]:
        """Id, title, short title, samples and share of samples of each family.

        Empty where no entry tells the first metric of any.
        """
        first = self.builder.first.key
        cells = (cell for entry in self.board.entries for cell in entry.families.values())
        if all(cell.metrics.get(first) is None for cell in cells):
            return []
        total = sum([head.n for head in self.board.families]) or 1
        return [
            (head.id, head.title, short_title(head.title), head.n, head.n / total)
            for head in self.board.families
        ]


def _optional_columns(challenge: Challenge) -> list[tuple[str, str]]:
    """The columns that may be switched off: all but rank, method and primary metrics."""
    columns = [metric for metric in challenge.metrics if metric.shown == "column"]
    diagnostic = [(m.key, m.label) for m in columns if m.role == "diagnostic"]
    return [*diagnostic, ("outcome", "Outcome and families")]


def _extra_columns(challenge: Challenge) -> list[tuple[str, str]]:
    metrics = [(m.key, m.label) for m in challenge.metrics if m.shown == "extra column"]
    return [*metrics, ("date", "Date of submission")]


def board_table(
    board: Board,
    protocol: ProtocolDocument,
    query: BoardQuery,
    is_current: bool = True,
    facts: FactsOfBoard = NO_FACTS,
) -> BoardTable:
    """Filter, sort and cut a board, and build the rows that are shown.

    Blocks are never mixed: scored entries first, then reference rows, then reported ones.

    Raises:
        InvalidRecord: This board has nothing of the name that the query sorts by.
    """
    challenge = challenge_of(board)
    columns = {
        "hidden": query.hidden & dict(_optional_columns(challenge)).keys(),
        "added": query.added & dict(_extra_columns(challenge)).keys(),
    }
    query = query.model_copy(update=columns)
    average = query.average or board.headline
    digits = Digits.of(protocol.publication, has_fine_intervals=board.has_fine_intervals)
    builder = RowBuilder(board, average, digits, query, is_current, facts)
    found = sort_entries(board, found_entries(board, query, facts), query.sort, average)
    by_source = {source: [e for e in found if e.source == source] for source in SOURCES}
    n_rows = PAGE_ROWS[query.rows]
    n_pages = max(1, -(-len(by_source["scored"]) // n_rows))
    number = min(query.page, n_pages)
    blocks = []
    for source, entries in by_source.items():
        start = (number - 1) * n_rows
        shown = entries[start : start + n_rows] if source == "scored" else entries
        if shown:
            rows = tuple([builder.row(entry) for entry in shown])
            blocks.append(Block(source, rows))
    return BoardTable(
        board, query, builder, tuple(blocks), number, n_pages, len(found), protocol.ranking
    )
