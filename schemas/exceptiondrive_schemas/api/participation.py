"""Who takes part and under what: what readers and teams are told of it."""

from datetime import datetime

from exceptiondrive_schemas.base import Document

AFTER_A_MERGE = (
    "Only one run of a method counts, and only one entry where a phase shows one for each team."
)
"""What becomes of the entries of two teams that are merged."""


class DisqualificationNote(Document):
    """What readers are told of a team, or one entry of it, that stands on no board any more."""

    team: str
    method: str | None = None
    """Of the entry; None: everything of the team."""
    note: str
    disqualified_at: datetime
    """The day: its first moment in UTC."""
