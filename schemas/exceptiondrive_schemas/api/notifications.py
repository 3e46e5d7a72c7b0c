"""Messages to teams: notices, and the subscriptions of an address."""

from datetime import datetime
from typing import Literal

from exceptiondrive_schemas.api.rescoring import Standing
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.score_sheet import ProtocolRef

EventKind = Literal["scored", "failed", "overtaken", "phase_ends"]
"""Events between protocol updates: the kind of a notification, and a subscription to it."""
NotificationKind = Literal[
    "protocol_applied",
    "protocol_rolled_back",
    EventKind,
    "confirm_address",
    "message",
    "disqualified",
    "reinstated",
    "allowance",
    "team_changed",
    "phase_changed",
]
Subscription = Literal["updates", EventKind]
"""What an address may subscribe to, as its `wishes`: protocol updates, and events between them."""
SUBSCRIPTIONS: dict[Subscription, str] = {
    "updates": "a protocol or split update changed your published numbers",
    "scored": "a submission of yours was scored",
    "failed": "a submission of yours was rejected or failed",
    "overtaken": "another entry passed one of yours (at most once an hour and phase)",
    "phase_ends": "a phase that you take part in ends within a day",
}


class ChangedEntry(Document):
    """One entry of a team, before and after."""

    submission_id: str
    method: str
    old: Standing | None
    new: Standing | None


class NotificationView(Document):
    """A message to a team."""

    id: str
    """A message that comes twice has the same one."""
    kind: NotificationKind
    team: str
    """Name of the team."""
    phase: str
    challenge: ChallengeId | None = None
    """Of protocol updates alone."""
    created_at: datetime
    read_at: datetime | None = None
    """None: not read yet."""
    title: str
    from_protocol: ProtocolRef | None = None
    """Of protocol updates alone."""
    to_protocol: ProtocolRef | None = None
    """Of protocol updates alone."""
    what_changed: tuple[str, ...]
    """Sentences."""
    entries: tuple[ChangedEntry, ...] = ()
    """The team's own, each with old and new numbers: of protocol updates alone."""
    comparison: str
    """Where there is more, below the server's own address: of an update the public comparison."""
