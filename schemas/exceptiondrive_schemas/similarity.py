"""Which submissions are alike: for organizers alone, sums over samples, nothing of any sample."""

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


ALIKE_SUBMISSIONS = TypeAdapter(tuple[AlikeSubmission, ...])


class AlikeKind(StrEnum):
    """How alike the submissions of two teams are."""

    EQUAL_FILES = "equal_files"
    EQUAL_ANSWERS = "equal_answers"
    NEAR = "near"


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


class Probing(Document):
    """A team that changes a few samples at a time: it may be asking about them."""

    team: str
    n_submissions: Annotated[int, Field(ge=1)]
    """Submissions that differ from another one of the team in at most 1 % of samples."""
    first_at: datetime
    last_at: datetime
    submissions: tuple[str, ...]


class SimilarityReport(Document):
    """Teams with equal or near-equal submissions, and teams that probe. Reasons to ask, not proof."""

    phase: str
    n_compared: int
    """Scored submissions that were compared with all others of the phase."""
    n_waiting: int
    """Scored ones that the workers have not compared yet."""
    pairs: tuple[AlikePair, ...] = ()
    probing: tuple[Probing, ...] = ()
