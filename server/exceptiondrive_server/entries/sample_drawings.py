"""Drawings of an entry's samples, set for a page. There are some for public splits alone."""

from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from exceptiondrive_schemas.drawing import SampleDrawing, outcome, shapes
from exceptiondrive_schemas.taxonomy import Task
from exceptiondrive_server.boards.entry_facts import challenge_of, entry_url
from exceptiondrive_server.entries.queries import EntryReading
from exceptiondrive_server.web.numbers import Digits
from exceptiondrive_server.web.responses import template_filter


@dataclass(frozen=True)
class Panel:
    """One drawn sample: who, what happened, where its own page is."""

    group: str
    """`worst` or `middle` of its family."""
    place: str
    url: str
    sample: SampleDrawing
    family: str
    task: Task

    @property
    def title(self) -> str:
        """Its task, as readers see it."""
        return f"{self.task.id} {self.task.title}"

    @property
    def outcome(self) -> str:
        """What happened, in a sentence without capital and full stop."""
        return outcome(self.sample)

    @property
    def words(self) -> str:
        """What the picture shows, for those who do not see it."""
        happened = self.outcome
        return f"{self.title}: {self.sample.hazard}. {happened[0].upper()}{happened[1:]}."


def panels(reading: EntryReading) -> tuple[Panel, ...]:
    """Return the drawn samples of an entry: the worst of each family, then the middle ones."""
    path, _, query = entry_url(reading.entry, reading.board, reading.is_current).partition("?")
    families = {family.id: family.title for family in reading.protocol.families}
    found = []
    for drawn in reading.drawings.samples if reading.drawings else ():
        sample = drawn.drawing
        place = f"{drawn.chosen_as}-{sample.family}"
        url = f"{path}/samples/{place}" + (f"?{query}" if query else "")
        task = reading.protocol.taxonomy.task(sample.task)
        found.append(Panel(drawn.chosen_as, place, url, sample, families[sample.family], task))
    return tuple(sorted(found, key=lambda panel: panel.group != "worst"))


@template_filter
def drawn(sample: SampleDrawing, width: int, height: int) -> Markup:
    """Draw a sample as SVG shapes for a box; colours come from the style sheet."""
    return Markup(shapes(sample, width, height))


def sample_page(reading: EntryReading, place: str) -> dict[str, Any] | None:
    """Return what `sample.html` shows of one drawn sample; None where none stands at this place."""
    drawn = panels(reading)
    index = next((i for i, panel in enumerate(drawn) if panel.place == place), None)
    if index is None:
        return None
    return {
        "reading": reading,
        "panel": drawn[index],
        "metrics": challenge_of(reading.board).metrics,
        "digits": Digits.of(reading.protocol.publication),
        "before": drawn[index - 1] if index else None,
        "after": drawn[index + 1] if index + 1 < len(drawn) else None,
        "entry_url": entry_url(reading.entry, reading.board, reading.is_current),
    }
