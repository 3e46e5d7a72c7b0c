"""Which hazards are hardest: scores of the ranked entries by family and task, each and averaged."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_server.boards.charts import labels_of
from exceptiondrive_server.boards.entry_facts import challenge_of
from exceptiondrive_server.boards.table import SMALL_FAMILY, short_title
from exceptiondrive_server.web.numbers import Digits, Scale, nice_scale, px

MAX_SHEETS = 100
"""Of so many ranked entries, the best first, the tasks are read."""
DOT_WIDTH, DOT_WIDE, DOT_LEFT = 400, 760, 128.0
"""In a card beside another and on phones; in a card of its own on wide screens."""
ROW_HEIGHT = 46.0
DOT_GAP = 6.5
TOP, FOOT = 8.0, 42.0


class Hardness(NamedTuple):
    """A family or task with the mean over the entries that have a value there."""

    id: str
    title: str
    n: int
    """Samples."""
    mean: float
    best: float
    n_entries: int


Tasks = tuple[Hardness, ...]


def _hardest_first(lines: Iterable[Hardness], metric: Metric) -> tuple[Hardness, ...]:
    """Equal means stay in the order of the taxonomy."""
    return tuple(sorted(lines, key=lambda it: it.mean, reverse=metric.better == "lower"))


def hardest_tasks(sheets: Sequence[ScoreSheet], taxonomy: Taxonomy, metric: Metric) -> Tasks:
    """Return the tasks, hardest first, without those that some of these sheets lack."""
    found = []
    for task in taxonomy.tasks:
        rows = [row for sheet in sheets if (row := sheet.tasks.get(task.id)) is not None]
        values = [v for row in rows if (v := row.metrics.get(metric.key)) is not None]
        if values and len(values) == len(sheets):
            found.append(_hardness_row(task.id, task.title, rows[0].n or 0, values, metric))
    return _hardest_first(found, metric)


def _hardness_row(
    name: str, title: str, n: int, values: Sequence[float], metric: Metric
) -> Hardness:
    best = max(values) if metric.better == "higher" else min(values)
    return Hardness(name, title, n, fmean(values), best, len(values))


class Families(NamedTuple):
    """What the heat map of a board shows besides its rows."""

    hardest: tuple[Hardness, ...]
    order: list[int]
    """In which the families stand, as places among those of the board."""

    @property
    def whose(self) -> str:
        """The entries that the means are of, if the same in all families."""
        counts = {line.n_entries for line in self.hardest}
        if counts == {1}:
            return "the only one ranked"
        return f"all {counts.pop()} ranked" if len(counts) == 1 else "all ranked"

    @property
    def large(self) -> tuple[Hardness, ...]:
        """Those that are not small, of which alone one is called hardest; hardest first."""
        return tuple(line for line in self.hardest if line.n >= SMALL_FAMILY)

    @property
    def sentence(self) -> str:
        """Say which family is hardest, and which easiest, for all ranked entries together."""
        large = self.large
        if len(large) < 2 or large[0].mean == large[-1].mean:
            return ""
        of = "" if large == self.hardest else f" of those with at least {SMALL_FAMILY} samples"
        return (
            f"Hardest first: {large[0].title} is hardest and {large[-1].title} easiest{of}, "
            f"by the mean of {self.whose}.{self._hidden_families_note}"
        )

    @property
    def _hidden_families_note(self) -> str:
        n, of = len(self.order) - len(self.hardest), len(self.order)
        return f" {n} of {of} families {'is' if n == 1 else 'are'} not told." if n else ""


def families_of(board: Board) -> Families:
    """Return the families of a board, hardest first, by the first metric of its ranked entries.

    One in which no ranked entry has a value has no mean, and stands last.
    """
    metric = challenge_of(board).metrics[0]
    ranked = [entry for entry in board.entries if entry.rank is not None]
    found = []
    for head in board.families:
        cells = (entry.families.get(head.id) for entry in ranked)
        values = [v for cell in cells if cell and (v := cell.metrics.get(metric.key)) is not None]
        if values:
            found.append(_hardness_row(head.id, head.title, head.n, values, metric))
    hardest = _hardest_first(found, metric)
    places = {head.id: place for place, head in enumerate(board.families)}
    known = [places[line.id] for line in hardest]
    return Families(hardest, [*known, *(place for place in places.values() if place not in known)])


class Dot(NamedTuple):
    """One entry in one family, in SVG units."""

    place: int
    """Of the entry among those that are drawn: its colour and its shape."""
    x: str
    y: str
    whisker: tuple[str, str] | None
    title: str


class DotRow(NamedTuple):
    """One family."""

    title: str
    top: str
    y: str
    dots: tuple[Dot, ...]


@dataclass(frozen=True)
class DotPlot:
    """Some entries by family, with intervals; all on one axis in per cent."""

    width: int
    height: int
    left: str
    right: str
    bottom: str
    ticks: tuple[tuple[str, str], ...]
    rows: tuple[DotRow, ...]
    names: tuple[str, ...]
    metric: Metric
    has_whiskers: bool
    description: str


def dot_plot(
    board: Board,
    entries: Sequence[BoardEntry],
    digits: Digits,
    width: int = DOT_WIDTH,
    order: Sequence[int] | None = None,
) -> DotPlot | None:
    """Draw some entries of a board by family, hardest first; None where none of theirs is told.

    At most six, in the order of their colours; the `order` of the families is as `families_of` has
    it, where that is known.
    """
    metric = challenge_of(board).metrics[0]
    entries = [entry for entry in entries if entry.families]
    order = families_of(board).order if order is None else order
    families = [board.families[place] for place in order]
    if not entries or not families:
        return None
    left, right = DOT_LEFT, width - 14.0
    cells = [entry.families.get(head.id) for entry in entries for head in families]
    known = [v for cell in cells if cell and (v := cell.metrics.get(metric.key)) is not None]
    if not known:
        return None
    spans = [span for cell in cells if cell and (span := cell.intervals.get(metric.key))]
    ends = [100 * end for span in spans for end in span]
    scale = nice_scale(
        [*(100 * value for value in known), *ends],
        (left, right),
        floor=0.0,
        ceiling=100.0,
        include=(0.0, 10.0),
    )
    height = int(TOP + ROW_HEIGHT * len(families) + FOOT)
    names = labels_of(entries)
    rows = []
    for at, head in enumerate(families):
        top = TOP + at * ROW_HEIGHT
        middle = top + ROW_HEIGHT / 2
        dots = tuple(_dots(entries, names, head.id, middle, scale, metric, digits))
        rows.append(DotRow(short_title(head.title), px(top), px(middle), dots))
    said = "; ".join(
        f"{row.title}: {', '.join(dot.title for dot in row.dots) or 'none'}" for row in rows
    )
    return DotPlot(
        width=width,
        height=height,
        left=px(left),
        right=px(right),
        bottom=px(height - FOOT),
        ticks=tuple((px(scale.at(tick)), f"{tick:g}") for tick in scale.ticks),
        rows=tuple(rows),
        names=names,
        metric=metric,
        has_whiskers=bool(spans),
        description=f"{metric.label} by hazard family, hardest first. {said}.",
    )


def _dots(
    entries: Sequence[BoardEntry],
    names: Sequence[str],
    family: str,
    middle: float,
    scale: Scale,
    metric: Metric,
    digits: Digits,
) -> Iterator[Dot]:
    for place, entry in enumerate(entries):
        cell = entry.families.get(family)
        value = cell.metrics.get(metric.key) if cell else None
        if cell is None or value is None:
            continue
        span = cell.intervals.get(metric.key)
        y = middle + (place - (len(entries) - 1) / 2) * DOT_GAP
        title = f"{names[place]} {digits.text(metric, value)} %"
        if span:
            title += f" ({digits.interval(metric, span)})"
        ends = span and (px(scale.clamped(100 * span[0])), px(scale.clamped(100 * span[1])))
        yield Dot(place, px(scale.clamped(100 * value)), px(y), ends or None, title)
