"""The datasheet of a split: public facts about how it was made. No region, no sample's task.

The workshop writes it when a split is frozen; the worker takes it along when the split is
registered; the page of the split shows it, with the worker's own warnings. It consists of counts
over decisions, and of the organizers' own texts.
"""

from typing import Annotated, Literal

from pydantic import Base64Bytes, Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.split import Split, SplitName

Interval = tuple[float, float]
NO_RECORDED_DRIVE = "no_recorded_drive"
"""Code of the warning about samples without a recorded drive."""
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
    published: Annotated[str, Field(pattern=r"^(\d{4}-\d{2}-\d{2})?$")] = ""
    """The day, such as 2026-11-22."""
    url: str = ""
    """Where pictures and files are to be had."""


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
    """Those of the draw that people have looked at."""
    waiting: Count = 0
    """Further ones of the draw, which nobody has looked at yet."""
    passed: Count
    confidence: float
    wilson: Interval
    finite_population: Interval


class Agreement(Document):
    """How far two readers, blind to each other, agree about regions."""

    n: Count
    """Candidates that two people have read."""
    both_accepted: Count
    same_word: Count
    beyond: Count
    """Those that a third reader has to decide."""
    iou_mean: float | None
    iou_median: float | None
    corner_m_max: float | None
    alpha: float | None
    """Krippendorff's alpha over accepted and rejected; null where all words are the same."""


class Decider(Document):
    """Who or what took the decisions of a stage that stand; people are numbered, not named."""

    stage: str
    by: str
    is_person: bool
    decisions: Count
    prompt: str = ""
    """Digest of the words that a model is asked with, before a task's own are put in."""


class WithdrawnSamples(Document):
    """Samples that files still answer and no sheet counts, by the reason given."""

    reason: str
    n: Count


class SplitChange(Document):
    """What changed since the revision before, in words for readers."""

    previous: str
    words: str
    moved: Count
    """Samples whose region changed."""
    withdrawn: Count
    """Samples that counted before."""
    restored: Count = 0
    """Samples that were withdrawn before, and count again."""
    drives: Count = 0
    """Samples of which another drive is recorded, or one where none was, or none where one was."""
    marks: Count = 0
    """Samples that are a control and were none, or were one and are none."""

    @classmethod
    def between(cls, before: Split, after: Split, words: str) -> Self:
        """Count the changes of a revision in the samples that it shares with the one before."""
        earlier = {sample.sample_id: sample for sample in before.samples}
        pairs = [(earlier[it.sample_id], it) for it in after.samples if it.sample_id in earlier]
        return cls(
            previous=before.revision,
            words=words,
            moved=sum(old.region != new.region for old, new in pairs),
            withdrawn=sum(
                old.withdrawn is None and new.withdrawn is not None for old, new in pairs
            ),
            restored=sum(old.withdrawn is not None and new.withdrawn is None for old, new in pairs),
            drives=sum(old.recorded != new.recorded for old, new in pairs),
            marks=sum(old.control != new.control for old, new in pairs),
        )

    @property
    def counts(self) -> tuple[str, ...]:
        """The numbers of affected samples, in words."""
        moved = (
            "the region of 1 sample changes"
            if self.moved == 1
            else f"the regions of {self.moved:,} samples change"
        )
        withdrawn = (
            f"{counted(self.withdrawn, 'sample')} withdrawn: files still answer, none counts"
        )
        told = (
            (self.moved, moved),
            (self.withdrawn, withdrawn),
            (self.restored, f"{counted(self.restored, 'sample')} restored: counted again"),
            (self.drives, f"the recorded drive of {counted(self.drives, 'sample')} changed"),
            (self.marks, f"the control mark of {counted(self.marks, 'sample')} changed"),
        )
        return tuple(sentence for n, sentence in told if n)


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
    n_samples: Count
    n_scenes: Count
    n_controls: Count = 0
    n_recorded: Count = 0
    withdrawn: tuple[WithdrawnSamples, ...] = ()
    changes: SplitChange | None = None
    words: Words = Words()
    stages: tuple[Stage, ...]
    families: tuple[Cell, ...]
    tasks: tuple[Cell, ...]
    audit: Audit | None = None
    agreement: Agreement | None = None
    deciders: tuple[Decider, ...] = ()
    warnings: tuple[SplitWarning, ...] = ()
    examples: tuple[Example, ...] = ()
    picture_licence: str = ""
    """Under which the examples are shown."""

    @property
    def n_withdrawn(self) -> int:
        """Number of samples that files answer and no sheet counts."""
        return sum(group.n for group in self.withdrawn)


class SplitWarnings(Document):
    """The lint of a split as the server knows it."""

    found: tuple[SplitWarning, ...] = ()

    def count_of(self, code: str) -> int:
        """Return the number of samples that a warning is about; 0 if there is no such warning."""
        return sum(warning.count for warning in self.found if warning.code == code)
