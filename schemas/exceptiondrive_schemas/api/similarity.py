"""Similar submissions: for organizers alone, sums over samples, nothing about any one of them."""

from datetime import datetime
from typing import Annotated

from pydantic import Field, TypeAdapter

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import StrEnum


class AlikeSubmission(Document):
    """A submission that another one is like."""

    submission_id: str
    equal_share: float
    """Share of samples answered alike."""
    mean_distance: float
    """Mean over samples, each at most 2; metres where trajectories are compared."""
    n_different: int
    """Samples that differ at all."""
    n_changed: int = 0
    """Samples that are answered otherwise, beyond the tolerance and what scaling explains."""
    scale: float | None = None
    """By what it is scaled, where it is alike only once it is scaled and shifted as a whole."""
    is_probe: bool = False
    """Whether it differs in a few samples only: it may ask about them."""


ALIKE_SUBMISSIONS = TypeAdapter(tuple[AlikeSubmission, ...])


class AlikeKind(StrEnum):
    """How alike the submissions of two teams are."""

    EQUAL_FILES = "equal_files"
    EQUAL_ANSWERS = "equal_answers"
    NEAR = "near"
    SCALED = "scaled"


ALIKE_WORDS: dict[AlikeKind, str] = {
    AlikeKind.EQUAL_FILES: "the very same bytes",
    AlikeKind.EQUAL_ANSWERS: "other bytes, but exactly the same answer to every sample",
    AlikeKind.NEAR: "many samples are answered alike, or nearly so: one may be made from the other",
    AlikeKind.SCALED: "alike once one is made longer, shorter or shifted as a whole",
}


class SubmissionOfTeam(Document):
    """One of the submissions of a report."""

    id: str
    team: str
    method: str
    received_at: datetime


class AlikePair(Document):
    """Submissions of two teams that are alike, the earlier one first."""

    kind: AlikeKind
    first: SubmissionOfTeam
    second: SubmissionOfTeam
    equal_share: float
    mean_distance: float | None = None
    n_different: int
    scale: float | None = None
    """Of a scaled pair: by what the one is the other, as a whole."""


class Probing(Document):
    """Submissions that change a few samples at a time: somebody may be asking about them."""

    teams: tuple[str, ...]
    n_submissions: Annotated[int, Field(ge=1)]
    """Submissions that share most of their samples with an earlier one."""
    fewest_changed: int
    most_changed: int
    """Samples that each of them answers otherwise than the one that it is most like."""
    first_at: datetime
    last_at: datetime
    submissions: tuple[str, ...]


class SimilarityReport(Document):
    """Teams with equal or near-equal submissions, and teams that probe. Reasons to ask, not proof."""

    phase: str
    n_compared: int
    """Scored submissions that were compared with all others of the phase."""
    n_teams: int = 0
    """Teams with a scored submission."""
    n_waiting: int
    """Scored ones that are compared after the next board: until then another file went first."""
    pairs: tuple[AlikePair, ...] = ()
    probing: tuple[Probing, ...] = ()
