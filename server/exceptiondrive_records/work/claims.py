"""What a worker holds while it scores, and how finishing may end."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from exceptiondrive_schemas.jobs import Lane


@dataclass(frozen=True)
class Claim:
    """A leased job: everything that a scoring run needs to know, and its fence."""

    job_id: str
    fence: int
    attempts: int
    max_attempts: int
    lease_until: datetime
    lane: Lane
    is_first: bool
    submission_id: str
    phase_id: str
    challenge: str
    file_digest: str
    size_bytes: int
    protocol_digest: str
    split_name: str
    split_revision: str


class Finish(StrEnum):
    """How finishing ended."""

    RECORDED = "recorded"
    RETRY_LATER = "retry_later"
    LEASE_LOST = "lease_lost"
    """Another claim came between, or the submission was withdrawn: nothing was recorded."""
