"""Protocol updates as the API shows them: runs, previews, history."""

from collections.abc import Mapping
from datetime import datetime
from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.board import BoardNews
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.printable import counted, duration_words
from exceptiondrive_schemas.protocols.difference import Difference
from exceptiondrive_schemas.python310 import StrEnum
from exceptiondrive_schemas.score_sheet import Interval, MetricRow, ProtocolRef, ReminderEffect
from exceptiondrive_schemas.split import SplitRef


class RunState(StrEnum):
    """Where a rescoring run stands."""

    DRAFT = "draft"
    SCORING = "scoring"
    PAUSED = "paused"
    READY = "ready"
    """Every sheet is there and the new board is built: it may be applied."""
    APPLIED = "applied"
    """The new board is public; fresh submissions are scored both ways, so that it can go back."""
    CLOSED = "closed"
    """Applied for good: only the new protocol is scored."""
    ROLLED_BACK = "rolled_back"
    CANCELLED = "cancelled"

    @property
    def is_final(self) -> bool:
        """Whether the run has ended."""
        return self in (RunState.CLOSED, RunState.ROLLED_BACK, RunState.CANCELLED)


class RunKind(StrEnum):
    """What a run is for."""

    UPDATE = "update"
    """Another protocol or split revision is to be shown."""
    VERIFICATION = "verification"
    """Sheets are recomputed under what is shown, kept nowhere, and compared bit for bit."""


class RunAction(StrEnum):
    """What an organizer does with a run; each needs a reason."""

    START = "start"
    PAUSE = "pause"
    RESUME = "resume"
    """Goes on with a paused run, and tries failed sheets again in any state that has some."""
    APPLY = "apply"
    ROLLBACK = "rollback"
    CLOSE = "close"
    CANCEL = "cancel"


RETRIES: Mapping[RunState, RunState] = {
    RunState.READY: RunState.SCORING,
    RunState.APPLIED: RunState.APPLIED,
}
"""States in which `resume` only retries failed sheets, and the state after it."""
TRANSITIONS: Mapping[RunAction, Mapping[RunState, RunState]] = {
    RunAction.START: {RunState.DRAFT: RunState.SCORING},
    RunAction.PAUSE: {RunState.SCORING: RunState.PAUSED},
    RunAction.RESUME: {
        RunState.PAUSED: RunState.SCORING,
        RunState.SCORING: RunState.SCORING,
    },
    RunAction.APPLY: {
        RunState.SCORING: RunState.APPLIED,
        RunState.READY: RunState.APPLIED,
    },
    RunAction.ROLLBACK: {RunState.APPLIED: RunState.ROLLED_BACK},
    RunAction.CLOSE: {RunState.APPLIED: RunState.CLOSED},
    RunAction.CANCEL: {
        RunState.DRAFT: RunState.CANCELLED,
        RunState.SCORING: RunState.CANCELLED,
        RunState.PAUSED: RunState.CANCELLED,
        RunState.READY: RunState.CANCELLED,
    },
}
"""State transitions of each action: records, API and pages use this table.

In addition, scoring becomes `ready` by itself when every sheet exists and the new board is built.
"""


def next_states(
    action: RunAction, *, has_failed: bool, kind: RunKind = RunKind.UPDATE
) -> Mapping[RunState, RunState]:
    """Return the states in which an action is possible, and the state that each leads to."""
    if kind is RunKind.VERIFICATION and action is not RunAction.CANCEL:
        return {}
    retries = RETRIES if action is RunAction.RESUME and has_failed else {}
    return {**TRANSITIONS[action], **retries}


def actions_of(
    state: RunState, *, has_failed: bool, kind: RunKind = RunKind.UPDATE
) -> tuple[RunAction, ...]:
    """Return the possible actions on a run; its blockers say what else prevents them."""
    return tuple(
        action
        for action in RunAction
        if state in next_states(action, has_failed=has_failed, kind=kind)
    )


class VerifyState(StrEnum):
    """What a recomputation of one sheet came to."""

    WAITING = "waiting"
    EQUAL = "equal"
    DIFFERS = "differs"
    FAILED = "failed"


class Progress(Document):
    """How far scoring is; `failed` pairs need an organizer."""

    done: int
    total: int
    failed: int
    sheets_per_s: float | None = None
    remaining_s: float | None = None

    @property
    def words(self) -> str:
        """Progress in words: `120 of 200 sheets, 3 failed, 4.1 a second, about 20 s left`."""
        parts = [f"{self.done:,} of {counted(self.total, 'sheet')}"]
        if self.failed:
            parts.append(f"{self.failed:,} failed")
        if self.sheets_per_s:
            parts.append(f"{self.sheets_per_s:g} a second")
        if self.remaining_s and self.done < self.total:
            parts.append(f"about {duration_words(self.remaining_s)} left")
        return ", ".join(parts)


class TrialFinding(Document):
    """Why a split cannot be scored under the new protocol or revision; of a public split, for how many samples."""

    what: str
    n: int | None = None


class SplitTrial(Document):
    """What a worker says of the split under what a run leads to."""

    state: Literal["waiting", "fits", "refused", "held", "failed"] = "waiting"
    """`held`: by the floors of a withheld split, as they stood then."""
    found: tuple[TrialFinding, ...] = ()

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        if self.state == "waiting":
            return "A worker will try the split under the new protocol or revision."
        if self.state == "fits":
            return (
                "A worker has tried the split under the new protocol or revision: it can be scored."
            )
        reasons = "; ".join(it.what if it.n is None else f"{it.n:,} {it.what}" for it in self.found)
        if self.state == "failed":
            return f"The split could not be tried: {reasons}"
        if self.state == "held":
            return f"The floors of the withheld split forbid it: {reasons}."
        return f"The split cannot be scored under the new protocol or revision: {reasons}."


class RunView(Document):
    """A rescoring run as organizers see it."""

    id: str
    kind: RunKind = RunKind.UPDATE
    phase: str
    state: RunState
    reason: str
    actor: str
    from_protocol: ProtocolRef
    to_protocol: ProtocolRef
    from_split: SplitRef
    to_split: SplitRef
    created_at: datetime
    started_at: datetime | None
    applied_at: datetime | None
    ended_at: datetime | None
    progress: Progress
    actions: tuple[RunAction, ...] = ()
    """What may be done with it in this state."""
    blockers: tuple[str, ...]
    """Why it cannot be applied now (or, once applied, rolled back); empty: it can."""
    difference: Difference
    trial: SplitTrial | None = None
    """Whether the split can be scored under the new protocol or revision; None: it is not asked."""
    old_board: int | None = None
    new_board: int | None = None
    preview: str | None = None
    """Digest of the comparison that `apply` would make true."""


ChangeKind = Literal["none", "numbers", "rank_only", "appears", "disappears"]


class Standing(Document):
    """One entry on one board."""

    rank: int | None
    rank_interval: tuple[int, int] | None
    unranked_because: str | None
    metrics: MetricRow
    intervals: dict[str, Interval | None] = Field(default={}, exclude_if=lambda it: not it)
    families: dict[str, MetricRow]
    reminder_effect: ReminderEffect | None = Field(default=None, exclude_if=lambda it: it is None)
    """What the reminder changed, where the entry is linked; left out elsewhere."""

    @property
    def place(self) -> str:
        """`rank 3`, or that it has no rank and why."""
        if self.rank is not None:
            return f"rank {self.rank}"
        return f"not ranked: {self.unranked_because}" if self.unranked_because else "not ranked"


class EntryChange(Document):
    """One entry before and after."""

    submission_id: str
    method: str
    team: str
    change: ChangeKind
    newly_failing: bool
    """It had a rank and has none."""
    old: Standing | None
    new: Standing | None
    rank_shift: int | None
    """Places won: positive is better."""
    metric_shifts: MetricRow
    family_shifts: dict[str, MetricRow]
    effect_shifts: MetricRow = Field(default={}, exclude_if=lambda it: not it)
    """By how much the effect of the reminder moves, in each metric; left out without a link."""

    @property
    def old_rank(self) -> int | None:
        """The former rank; None if the entry did not exist or was unranked."""
        return self.old.rank if self.old else None

    @property
    def new_rank(self) -> int | None:
        """The new rank; None if the entry does not exist or is unranked."""
        return self.new.rank if self.new else None


class Comparison(Document):
    """What readers would see change: two boards side by side."""

    phase: str
    challenge: ChallengeId
    from_protocol: ProtocolRef
    to_protocol: ProtocolRef
    from_split: SplitRef
    to_split: SplitRef
    old_board: int
    new_board: int
    n_entries: int
    n_numbers_changed: int
    n_ranks_changed: int
    n_newly_failing: int
    worst_movers: tuple[str, ...]
    """Submission ids of all that lose places or score: by places, then by score, the most first."""
    entries: tuple[EntryChange, ...]

    @property
    def n_newly_ranked(self) -> int:
        """Number of entries that are ranked now and were not before."""
        return sum(one.old_rank is None and one.new_rank is not None for one in self.entries)

    @property
    def no_longer_ranked(self) -> dict[str, str]:
        """Submissions that lose their rank, with their new standing."""
        return {
            one.submission_id: one.new.place if one.new else "not on the board"
            for one in self.entries
            if one.newly_failing
        }

    @property
    def digest(self) -> str:
        """Digest of the whole content, to ensure that exactly what was previewed is applied."""
        return content_digest(self)


FlipDirection = Literal["apply", "roll_back", "applied"]


class PreviewView(Document):
    """The comparison, whether it is fresh, and what stands in the way of applying it."""

    run: str
    digest: str
    direction: FlipDirection = "apply"
    """What makes it true: the next step of the run; of one that has ended, its apply."""
    is_stale: bool
    blockers: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    """What else it ends for good: a freeze, later deadlines of single teams."""
    comparison: Comparison


def page_of(comparison: str) -> str:
    """Return the address of the page that shows people the comparison at an API address."""
    return comparison.removeprefix("/api/v1")


class PublicRun(Document):
    """An applied run, as every reader may see it."""

    id: str
    phase: str
    state: RunState
    applied_at: datetime
    ended_at: datetime | None
    from_protocol: ProtocolRef
    to_protocol: ProtocolRef
    from_split: SplitRef
    to_split: SplitRef
    changes: str
    """What the protocol document itself says has changed."""
    difference: Difference
    comparison: Comparison


class BoardHistoryLine(Document):
    """A stretch of time in which one board was public."""

    board: int
    address: str
    protocol: ProtocolRef
    split: SplitRef
    shown_from: datetime
    shown_until: datetime | None
    what_changed: tuple[str, ...]
    """Sentences; empty where only submissions came."""
    news: BoardNews
    """Whose scores are others, where only submissions came or went."""
    comparison: str | None
    """Address of the run that made it current, by applying it or by rolling back."""


class VerifyItemView(Document):
    """One recomputed sheet."""

    submission_id: str
    state: VerifyState
    expected_digest: str
    found_digest: str | None
    note: str | None
    asked_at: datetime | None = None
    ended_at: datetime | None = None


class VerificationView(Document):
    """A recomputation of sheets from the uploads."""

    id: str
    phase: str
    protocol: ProtocolRef
    split: SplitRef
    reason: str
    actor: str
    created_at: datetime
    finished_at: datetime | None
    n_sheets: int
    n_equal: int
    n_different: int
    n_failed: int
    problems: tuple[VerifyItemView, ...]
    """Every sheet that did not come again, bit for bit."""
