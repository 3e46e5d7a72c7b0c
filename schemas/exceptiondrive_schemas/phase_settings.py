"""The life of a phase: what is shown when, and to whom.

One document, so that a form can be built from it: `PhasePolicy.model_json_schema()` gives each field
with its title, a sentence, its choices and its default.
"""

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field

from exceptiondrive_schemas.base import Document

SplitPart = Literal["public", "private"]
LivePart = Literal["public", "whole"]
RevealedPart = Literal["private", "whole"]
LateEntries = Literal["refused", "own_view"]
FrozenScores = Literal["shown", "hidden"]
EntriesShown = Literal["all", "chosen"]
BoardView = Literal["main", "late"]


def _time_or_text(value: Any) -> Any:
    """A number would be read as seconds since 1970: refuse it."""
    if value is None or isinstance(value, str | datetime):
        return value
    raise ValueError("must be text such as 2026-11-21T12:00:00Z")


def _in_utc(value: datetime) -> datetime:
    try:
        return value.astimezone(UTC)
    except OverflowError:
        raise ValueError("must lie within the years 1 to 9999") from None


Moment = Annotated[
    AwareDatetime,
    Field(strict=False),
    BeforeValidator(_time_or_text),
    AfterValidator(_in_utc),
]
"""A time with its zone, kept in UTC; text in every form of JSON."""


class PhasePolicy(Document):
    """What is shown of a phase, when, and to whom. The defaults show everything at once."""

    live_part: LivePart = Field(
        default="public",
        title="Live board on",
        description="Of a split with parts: which samples the board counts until the reveal. A "
        "split without parts is always whole. Fixed once there are submissions.",
    )
    revealed_part: RevealedPart = Field(
        default="private",
        title="Revealed board on",
        description="Of a split with parts: which samples count after the reveal.",
    )
    late_entries: LateEntries = Field(
        default="refused",
        title="Late entries",
        description="After the deadline: refused, or scored and ranked on a view of their own "
        "that moves no rank of the board.",
    )
    freezes_at: Moment | None = Field(
        default=None,
        title="Board freezes at",
        description="From then the public board stays as it is until it is revealed.",
    )
    frozen_scores: FrozenScores = Field(
        default="shown",
        title="Own scores while frozen",
        description="Whether a team sees the scores of what it submits after the freeze.",
    )
    families_from: Moment | None = Field(
        default=None,
        title="Families shown from",
        description="Until then no family or task is shown anywhere; empty: always shown.",
    )
    entries_shown: EntriesShown = Field(
        default="all",
        title="Entries on the board",
        description="All methods, or one entry of each team: its choice, else its latest.",
    )
    anonymous: bool = Field(
        default=False,
        title="Anonymous until revealed",
        description="Teams and methods stand under pseudonyms until the organizers reveal them. "
        "Fixed once there are submissions.",
    )
    entries_private: bool = Field(
        default=False,
        title="Private until published",
        description="An entry stands on the board when its team publishes it. Fixed once there "
        "are submissions.",
    )


class PhaseNow(Document):
    """Where a phase stands in its life."""

    part: SplitPart | None = None
    """Which part of the split the board counts; None: all samples."""
    n_counted: int
    """How many samples that are."""
    frozen_since: datetime | None = None
    families_shown_from: datetime | None = None
    is_anonymous: bool = False
    takes_late_entries: bool = False
    """Closed, and what comes now stands on the late view."""
