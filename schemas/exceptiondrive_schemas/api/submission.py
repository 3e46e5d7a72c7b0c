"""Submissions and their statuses as the API shows them."""

from datetime import datetime

from exceptiondrive_schemas.api.phase_settings import PhaseNow, PhaseSettings, RunRule
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.method_facts import Links, MethodFacts
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.python310 import StrEnum
from exceptiondrive_schemas.score_sheet import HEADLINE, Interval, ReminderEffect, ScoreSheet


class SubmissionStatus(StrEnum):
    """Where a submission stands. `rejected` = the file is wrong; `failed` = we are wrong.

    A sound file is `rejected`, too, where its team is asked first (`asks_first`): with questions in
    `report.to_confirm`, and with `confirm_until` while it may say yes.
    """

    RECEIVED = "received"
    """The row is committed: the submission cannot be lost any more."""
    QUEUED = "queued"
    """A worker has been called."""
    SCORING = "scoring"
    """A worker holds the lease."""
    SCORED = "scored"
    REJECTED = "rejected"
    FAILED = "failed"
    WITHDRAWN = "withdrawn"

    @property
    def is_terminal(self) -> bool:
        """Whether scoring has ended."""
        return self not in WAITING


WAITING = (SubmissionStatus.RECEIVED, SubmissionStatus.QUEUED, SubmissionStatus.SCORING)
"""States before scoring has ended."""


class QueuePlace(Document):
    """How long until a worker is free, as an estimate."""

    position: int
    """How many are scored before it."""
    expected_wait_s: float | None
    attempts: int
    """How often a worker has begun to score it."""
    workers_alive: int
    """Living workers that find the split at its revision: with none it waits."""
    lease_until: datetime | None = None
    """A worker is scoring it: if that worker is lost, another may begin again then."""


class Failure(Document):
    """Why we could not score: a stable code and a sentence, never a traceback."""

    code: str
    message: str


class SubmissionView(Document):
    """A submission as its team sees it."""

    id: str
    phase: str
    challenge: ChallengeId
    team: str
    """Name of the team."""
    method: str
    description: str
    links: Links
    facts: MethodFacts = MethodFacts()
    edited_at: datetime | None = None
    """When the team last changed name, words, links or facts."""
    linked_to: str | None = None
    """The team's submission of the same agent without the reminder."""
    reminder_effect: ReminderEffect | None = None
    """What the reminder changed against that one, as the current board shows it."""
    no_effect_because: str | None = None
    """Why the current board, on which it stands, tells nothing against that one."""
    file_digest: str
    """`sha256:` and the hex digest of the bytes that were sent."""
    size_bytes: int
    """Of the bytes that were sent."""
    status: SubmissionStatus
    received_at: datetime
    status_at: datetime
    """Since when it has this status."""
    queue: QueuePlace | None = None
    """While it waits or is scored."""
    report: CheckReport | None = None
    """Once a worker has read the file: what is wrong with a rejected one, what was noticed of
    others."""
    failure: Failure | None = None
    """Of a failed one."""
    sheet: ScoreSheet | None = None
    """Its published score."""
    headline: Average = HEADLINE
    """Which average of its sheet ranks."""
    rank: int | None = None
    """On the current board."""
    rank_interval: tuple[int, int] | None = None
    """Best and worst rank that sampling of scenes leaves open."""
    intervals: dict[str, Interval | None] = {}
    """Of the metrics, as the board shows them."""
    unranked_because: str | None = None
    """Why it has no rank: as the board says, because the board is frozen, since it stays private, or as
    what stood in its place at the deadline was withdrawn later."""
    awaits_board: bool = False
    """It is scored, and the board that will show it is being built."""
    awaits_profile: bool = False
    """It is scored, and what its file looks like (`report.profile`), for which somebody asked, is being
    worked out."""
    is_duplicate: bool = False
    """The same bytes were there before: this is the first submission, and no quota was spent."""
    is_late: bool = False
    """It came after the deadline: it stands on the late view alone."""
    replaced_by: str | None = None
    """The submission that stands on the board in its place: a later run of the same method, or the
    one of the team in a phase that shows one of each."""
    is_chosen: bool = False
    """The team chose it for the board."""
    run_rule: RunRule = "newest"
    """Which run of its method stands, as the team said last; of the team, in a phase that shows one
    entry of each."""
    is_published: bool = True
    """False: the phase keeps entries private, and the team has not published this one."""
    score_kept_back_since: datetime | None = None
    """The board froze then, and this phase keeps back the scores of what came later."""
    disqualified_at: datetime | None = None
    """It stands on no board since then; the team's notices say why."""
    known_as: str | None = None
    """The pseudonym of the team on the board of an anonymous phase."""
    confirm_until: datetime | None = None
    """Until when its team may say yes to what `report.to_confirm` asks; then the file is deleted."""
    confirmed_as: str | None = None
    """The submission in its place, since the team said yes to what was asked or sent it again."""

    @property
    def is_asked(self) -> bool:
        """Whether its file is sound, but its team must confirm before it counts."""
        return self.status is SubmissionStatus.REJECTED and self.confirm_until is not None

    @property
    def no_rank_to_come(self) -> str | None:
        """Why the next board will not rank it, if its file shows that."""
        return self.report.unranked_because if self.awaits_board and self.report else None


class SubmissionPage(Document):
    """A page of submissions, newest first; `next` continues it."""

    submissions: tuple[SubmissionView, ...]
    next: str | None = None
    """`after` of the next page; None: this is the last one."""


class Quota(Document):
    """What a team may still submit in a phase."""

    per_day: int
    used_today: int
    """Of the UTC day."""
    remaining_today: int
    total: int | None
    """Of the whole phase; None: no limit."""
    used_total: int
    resets_at: datetime
    """When the counts of today begin anew: 00:00 UTC."""
    rejected_per_day: int
    rejected_today: int
    concurrent: int | None = None
    """How many may wait for their score at once."""
    waiting: int = 0
    """How many of them wait now."""
    closes_at: datetime | None = None
    """The later deadline that organizers granted to the team; None: that of the phase."""

    @property
    def left_in_all(self) -> int | None:
        """How many more submissions the phase accepts in total; None without such a limit."""
        return None if self.total is None else max(0, self.total - self.used_total)

    @property
    def left_of_rejected(self) -> int:
        """How many more files may be rejected today."""
        return max(0, self.rejected_per_day - self.rejected_today)

    @property
    def left_of_waiting(self) -> int | None:
        """How many more may wait for their score now; None without such a limit."""
        return None if self.concurrent is None else max(0, self.concurrent - self.waiting)

    @property
    def is_spent(self) -> bool:
        """Whether today's quota is used up."""
        return self.remaining_today == 0 or self.left_of_rejected == 0

    @property
    def is_bound_in_all(self) -> bool:
        """Whether the total limit leaves fewer than today's: no new day resets it."""
        left = self.left_in_all
        return left is not None and left < self.per_day - self.used_today

    def left_words(self, what: str = "") -> str:
        """Say what is left, by the stricter limit: `3 of 5 today`, or `2 of 20 in all`.

        `what` follows the numbers, such as ` left`.
        """
        if self.is_bound_in_all:
            return f"{self.left_in_all} of {self.total}{what} in all"
        return f"{self.remaining_today} of {self.per_day}{what} today"


class PhaseView(PhaseSettings):
    """A dated stage of a challenge, with its own split, protocol and limits."""

    id: str
    challenge: ChallengeId
    title: str  # unbounded here: limits apply to writers
    description: str = ""
    split: str
    split_revision: str
    split_is_public: bool
    n_samples: int
    """Samples of the split that count, of which the board counts `now.n_counted`; the manifest also names controls
    and what was withdrawn."""
    protocol: str
    protocol_digest: str
    is_open: bool
    max_upload_bytes: int
    not_checked: tuple[str, ...] = ()
    """What nobody checks of a file for this phase, in sentences for who sends one."""
    now: PhaseNow | None = None
    quota: Quota | None = None
    """The asking team's own, when a token was sent."""
    terms_version: str | None = None
    """Which version of the terms a team accepts before it submits; None: none need be accepted."""
    terms_accepted_at: datetime | None = None
    """When the asking team accepted that version."""
    disqualified_at: datetime | None = None
    """Since when the asking team is disqualified here: its uploads are refused."""

    @property
    def takes_late_entries(self) -> bool:
        """Whether it is closed to the asking team, and new entries go to the late view."""
        return not self.is_open and self.now is not None and self.now.takes_late_entries

    @property
    def own_closes_at(self) -> datetime | None:
        """The later deadline of the asking team, while it is open to that team."""
        return self.quota.closes_at if self.is_open and self.quota is not None else None

    @property
    def takes_files(self) -> bool:
        """Whether uploads of the asking team are accepted, for the board or for the late view."""
        return self.disqualified_at is None and (self.is_open or self.takes_late_entries)


class Me(Document):
    """Who the token speaks for."""

    team: str | None
    """Name of the team; None of an organizer."""
    token_name: str
    scopes: tuple[str, ...]
    """What the token may do: `read:own`, `submit`, `tokens`, and those of organizers."""
    expires_at: datetime | None
    """None: it does not expire."""
    role: str | None = None
    """As what it organizes: `owner`, `helper` or `read-only`; None: not at all."""
    phases: tuple[str, ...] = ()
    """The phases that an organizer is confined to; none: the role is for the whole site."""
