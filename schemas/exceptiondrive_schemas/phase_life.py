"""The life of a phase: what is shown when, and to whom.

One document, so that a form can be built from it: `PhaseLife.model_json_schema()` gives each field
with its title, a sentence, its choices and its default.
"""

from datetime import datetime
from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.datetimes import Time

SplitPart = Literal["public", "private"]
LivePart = Literal["public", "whole"]
RevealedPart = Literal["private", "whole"]
LateEntries = Literal["refused", "own_view"]
FrozenScores = Literal["shown", "hidden"]
EntriesShown = Literal["all", "chosen"]
BoardView = Literal["main", "late"]


class PhaseLife(Document):
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
    freezes_at: Time | None = Field(
        default=None,
        title="Board freezes at",
        description="From then the public board stays as it is until it is revealed.",
    )
    frozen_scores: FrozenScores = Field(
        default="shown",
        title="Own scores while frozen",
        description="Whether a team sees the scores of what it submits after the freeze.",
    )
    families_from: Time | None = Field(
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
