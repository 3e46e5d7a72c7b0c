"""The final report of a phase: a summary of its boards once it has closed, and nothing else."""

from datetime import datetime

from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef


class PlaceChange(Document):
    """The rank of a team's method on the last board before a reveal and on the final one.

    None: it had no rank there, or was not on that board.
    """

    submission_id: str
    method: str
    team: str
    before: int | None
    after: int | None
    is_another_run: bool = False
    """Whether another run of the method stood on the board before."""


class ShakeUp(Document):
    """What a reveal changed: of the other part of the split, or of the board behind a freeze."""

    board: int
    """The last board that readers saw before."""
    part: SplitPart | None
    """Which part of the split that board counts; None: all of it."""
    places: tuple[PlaceChange, ...]
    """Every method with a rank on either board, in the order of the final one."""


class PhaseReport(Document):
    """How a phase ended."""

    phase: str
    title: str
    challenge: ChallengeId
    opened_at: datetime | None
    closed_at: datetime
    board: int
    board_digest: str
    """Of the bytes at `/api/v1/boards/PHASE/NUMBER`."""
    published_at: datetime
    split: SplitRef
    part: SplitPart | None
    protocol: ProtocolRef
    n_samples: int
    n_boards: int
    """That readers saw."""
    n_teams: int
    """On the final board."""
    n_submissions: int
    """That stood on one of these boards."""
    n_ranked: int
    n_listed: int
    """Of the scored entries: shown without a rank."""
    winners: tuple[BoardEntry, ...]
    """The first three that may lead, with their intervals, and what shares the rank of the last of them."""
    may_be_first: tuple[str, ...]
    """Submissions that may lead, whose rank interval reaches the first place, and that no comparison puts
    behind the leader. On a withheld split entries of one team are not compared: of the leader's, those that
    rank behind it are left out."""
    flags: dict[str, int]
    """Code of a flag to the entries of the final board that carry it."""
    shake_up: ShakeUp | None
    protocols: tuple[str, ...]
    """Versions under which boards were shown, oldest first."""
