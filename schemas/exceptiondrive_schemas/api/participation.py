"""Who takes part and under what: what readers and teams are told of it."""

from datetime import datetime

from exceptiondrive_schemas.base import Document


class DisqualificationNote(Document):
    """What readers are told of a team, or one entry of it, that stands on no board any more."""

    team: str
    method: str | None = None
    """Of the entry; None: everything of the team."""
    note: str
    disqualified_at: datetime
    """The day: its first moment in UTC."""
