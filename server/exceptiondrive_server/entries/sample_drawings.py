"""Drawings of an entry's samples, set for a page. There are some for public splits alone."""

from dataclasses import dataclass

from markupsafe import Markup

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.drawing import (
    DrawnSample,
    EntryDrawings,
    SampleDrawing,
    outcome,
    shapes,
)
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_server.entries.facts import challenge_of, entry_url
from exceptiondrive_server.web.numbers import Digits, unit_of, with_unit

Size = tuple[int, int]
PANEL: Size = (430, 250)
WIDE: Size = (960, 420)
NARROW: Size = (400, 360)
GROUPS = {
    "worst": ("Where it does worst", "The sample with the least HCC of each family."),
    "middle": ("How it usually does", "The sample in the middle of each family, by HCC."),
}


@dataclass(frozen=True)
class Drawing:
    """SVG shapes for a box; colours come from the style sheet."""

    width: int
    height: int
    shapes: Markup


@dataclass(frozen=True)
class Panel:
    """One drawn sample: who, what happened, where its own page is."""

    place: str
    url: str
    group: str
    sample: SampleDrawing
    family: str
    task: str
    outcome: str
    drawing: Drawing

    @property
    def words(self) -> str:
        """What the picture shows, for those who do not see it."""
        return f"{self.task}: {self.sample.hazard}. {self.outcome[0].upper()}{self.outcome[1:]}."


@dataclass(frozen=True)
class DrawnGroup:
    """One contact sheet."""

    title: str
    note: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True)
class SamplePage:
    """Everything that `sample.html` needs besides the entry."""

    panel: Panel
    wide: Drawing
    narrow: Drawing
    values: tuple[tuple[Metric, str], ...]
    before: Panel | None
    after: Panel | None
    command: str


def drawn_groups(
    drawings: EntryDrawings | None,
    board: Board,
    entry: BoardEntry,
    protocol: Protocol,
    is_current: bool,
) -> tuple[DrawnGroup, ...]:
    """Return the contact sheets of an entry; none where nothing was drawn."""
    panels = _panels(drawings, board, entry, protocol, is_current)
    groups = (
        DrawnGroup(title, note, tuple(panel for panel in panels if panel.group == key))
        for key, (title, note) in GROUPS.items()
    )
    return tuple(group for group in groups if group.panels)


def sample_page(
    groups: tuple[DrawnGroup, ...], place: str, board: Board, protocol: Protocol
) -> SamplePage | None:
    """Set one drawn sample; None where no sample stands at this place."""
    panels = [panel for group in groups for panel in group.panels]
    index = next((i for i, panel in enumerate(panels) if panel.place == place), None)
    if index is None:
        return None
    panel, digits = panels[index], Digits.of(protocol.publication)
    values = ((m, panel.sample.metrics.get(m.key)) for m in challenge_of(board).metrics)
    return SamplePage(
        panel=panel,
        wide=_drawing(panel.sample, WIDE),
        narrow=_drawing(panel.sample, NARROW),
        values=tuple(
            (metric, "undefined" if value is None else _text(digits, metric, value))
            for metric, value in values
        ),
        before=panels[index - 1] if index else None,
        after=panels[index + 1] if index + 1 < len(panels) else None,
        command=f"exceptiondrive plot planner.json.gz --split {board.split.name}.json "
        f"--sample {panel.sample.sample_id} -o sample.svg",
    )


def _text(digits: Digits, metric: Metric, value: float) -> str:
    return with_unit(metric, digits.text(metric, value) or "") if unit_of(metric) else ""


def _panels(
    drawings: EntryDrawings | None,
    board: Board,
    entry: BoardEntry,
    protocol: Protocol,
    is_current: bool,
) -> list[Panel]:
    if drawings is None:
        return []
    path, _, query = entry_url(entry, board, is_current).partition("?")
    families = {family.id: family.title for family in protocol.families}
    return [
        _panel(each, f"{path}/samples/", query, families, protocol) for each in drawings.samples
    ]


def _panel(
    drawn: DrawnSample, base: str, query: str, families: dict[str, str], protocol: Protocol
) -> Panel:
    sample = drawn.drawing
    place = f"{drawn.chosen_as}-{sample.family}"
    task = protocol.taxonomy.task(sample.task)
    return Panel(
        place=place,
        url=f"{base}{place}" + (f"?{query}" if query else ""),
        group=drawn.chosen_as,
        sample=sample,
        family=families[sample.family],
        task=f"{task.id} {task.name.replace('_', ' ').capitalize()}",
        outcome=outcome(sample),
        drawing=_drawing(sample, PANEL),
    )


def _drawing(sample: SampleDrawing, size: Size) -> Drawing:
    width, height = size
    return Drawing(width, height, Markup(shapes(sample, width, height)))
