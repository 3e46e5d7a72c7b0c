"""Participation: what readers and teams see about who takes part, and under which rules."""

from datetime import datetime

from exceptiondrive_schemas.base import Document

AFTER_A_MERGE = (
    "Only one run of a method counts, and only one entry where a phase shows one for each team."
)
"""The effect of a merge on the entries of the two teams."""


class DisqualificationNote(Document):
    """What readers are told of a team, or one entry of it, that stands on no board any more."""

    team: str
    method: str | None = None
    """Of the entry; None: everything of the team."""
    note: str
    disqualified_at: datetime
    """The day: its first moment in UTC."""
