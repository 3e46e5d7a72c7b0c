"""The datasheet of a split: what anyone may know of how it was made. No region, no sample's task.

The workshop writes it when a split is frozen; the worker takes it along when the split is registered;
the page of the split shows it and nothing else. Made of counts over decisions, and of the organizers'
own words.
"""

from typing import Annotated, Literal

from pydantic import Base64Bytes, Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.split import SplitName

Interval = tuple[float, float]
Count = Annotated[int, Field(ge=0)]


class SplitWarning(Document):
    """One kind of doubt about a split: how many samples have it, never which."""

    code: str
    what: str
    count: Count


class Words(Document):
    """What organizers say of their split, in their own words; empty where they say nothing."""

    purpose: str = ""
    source: str = ""
    licence: str = ""
    licence_url: str = ""
    contact: str = ""
    uses: str = ""
    limits: str = ""
    maintenance: str = ""


class Stage(Document):
    """How many candidates came through a stage, of how many that entered it."""

    id: str
    title: str
    n: Count
    of: Count


class Cell(Document):
    """A family or a task: how many of its candidates came how far."""

    id: str
    title: str
    candidates: Count
    suitable: Count
    accepted: Count
    n: Count
    """Samples of the split that count."""


class Audit(Document):
    """A random draw of accepted edits, looked at by people."""

    accepted: Count
    drawn: Count
    passed: Count
    confidence: float
    wilson: Interval
    finite_population: Interval


class Agreement(Document):
    """How far two readers, blind to each other, agree about regions."""

    twice_read: Count
    third_read: Count
    alpha: float | None
    """Krippendorff's alpha over accept and reject; undefined where all say the same."""
    iou_median: float | None
    corner_distance_median_m: float | None
    corner_distance_max_m: float | None


class Decider(Document):
    """Who or what took the decisions of a stage; people are numbered, not named."""

    stage: str
    by: str
    is_person: bool
    decisions: Count


class WithdrawnSamples(Document):
    """Samples that files still answer and no sheet counts, by the reason given."""

    reason: str
    n: Count


class Revision(Document):
    """What changed since the revision before, in words for readers."""

    previous: str
    words: str
    moved: Count
    """Samples whose region changed."""
    withdrawn: Count
    """Samples that counted before."""


class Example(Document):
    """A pair of pictures that the licence allows to be shown; JPEG."""

    caption: str
    source: Base64Bytes
    edited: Base64Bytes


class Datasheet(Document):
    """All of it."""

    schema_: Literal["exceptiondrive.datasheet/1"] = Field(alias="schema")
    name: SplitName
    title: str
    revision: str
    protocol: str
    """Version of the protocol whose tasks the split uses."""
    decided_until: str
    """Time of the last decision that the split is made of."""
    n_samples: Count
    n_scenes: Count
    n_controls: Count = 0
    n_recorded: Count = 0
    withdrawn: tuple[WithdrawnSamples, ...] = ()
    changes: Revision | None = None
    words: Words = Words()
    stages: tuple[Stage, ...]
    families: tuple[Cell, ...]
    tasks: tuple[Cell, ...]
    audit: Audit | None = None
    agreement: Agreement | None = None
    deciders: tuple[Decider, ...] = ()
    warnings: tuple[SplitWarning, ...] = ()
    examples: tuple[Example, ...] = ()

    @property
    def n_withdrawn(self) -> int:
        """Samples that files answer and no sheet counts."""
        return sum(group.n for group in self.withdrawn)


class SplitWarnings(Document):
    """The lint of a split as the server knows it."""

    found: tuple[SplitWarning, ...] = ()
