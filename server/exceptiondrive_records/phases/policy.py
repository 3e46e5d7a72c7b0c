"""The state of a phase at a moment: what is frozen, late, hidden or anonymous, and what is shown."""

import hashlib
import hmac
import re
import secrets
from datetime import UTC, datetime

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.api.phase_settings import PhaseNow, PhasePolicy
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.score_sheet import REMINDER, ScoreSheet

_LETTERS = "23456789ABCDEFGHJKMNPQRSTUVWXYZ"
"""Letters and digits of which no two look alike."""
_PSEUDONYM = re.compile(f"Team [{_LETTERS}]{{3}}-[{_LETTERS}]{{3}}")


def frozen_since(phase: Phase, now: datetime) -> datetime | None:
    """Return when the public board was frozen; None while it is not."""
    freezes_at = phase.policy.freezes_at
    if freezes_at is None or now < freezes_at:
        return None
    if phase.unfrozen_at is not None and phase.unfrozen_at >= freezes_at:
        return None
    return freezes_at


def families_shown_from(policy: PhasePolicy, now: datetime) -> datetime | None:
    """Return from when families and tasks are shown; None if they are shown already."""
    shown_from = policy.families_from
    return shown_from if shown_from is not None and now < shown_from else None


def is_anonymous(phase: Phase) -> bool:
    """Whether teams and methods are shown under pseudonyms."""
    return phase.policy.anonymous and phase.names_revealed_at is None


def shows_pseudonyms(session: Session, phase: Phase) -> bool:
    """Whether the board that readers see has pseudonyms: it may be older than the reveal of names."""
    if not phase.policy.anonymous or phase.names_revealed_at is None:
        return phase.policy.anonymous
    board = session.get(BoardRow, phase.current_board_id or 0)
    return board is not None and board.published_at < phase.names_revealed_at


def is_open(phase: Phase, now: datetime, own_closes_at: datetime | None = None) -> bool:
    """Whether a shown phase takes submissions: from `opens_at` until just before `closes_at`.

    For a team with a later deadline, until just before `own_closes_at`.
    """
    closes_at = own_closes_at or phase.closes_at
    has_opened = phase.opens_at is None or phase.opens_at <= now
    return phase.visibility == "shown" and has_opened and (closes_at is None or now < closes_at)


def scored_while_open(session: Session, split_name: str) -> list[str]:
    """Return the ids of open phases on a split that have scored submissions."""
    is_scored = (
        select(Submission.id)
        .where(Submission.phase_id == Phase.id, Submission.status == SubmissionStatus.SCORED)
        .exists()
    )
    found = session.scalars(select(Phase).where(Phase.split_name == split_name, is_scored))
    now = database_now(session)
    return sorted(phase.id for phase in found if is_open(phase, now))


def has_closed(phase: Phase, moment: datetime) -> bool:
    """Whether a moment lies at or after the deadline."""
    return phase.closes_at is not None and moment >= phase.closes_at


def takes_late_entries(session: Session, phase: Phase, moment: datetime) -> bool:
    """Whether a submission at this moment is accepted for the late view.

    None is accepted after the split is revealed: late files could probe the private part endlessly.
    """
    is_wanted = has_closed(phase, moment) and phase.policy.late_entries == "own_view"
    is_wanted = is_wanted and phase.visibility == "shown"
    return is_wanted and not was_split_revealed(session, phase)


def is_split_revealed(session: Session, phase: Phase) -> bool:
    """Whether the phase started with the public part of its split, and shows another one now."""
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    return phase.policy.live_part == "public" and split.counts_private


def was_split_revealed(session: Session, phase: Phase) -> bool:
    """Whether a board beyond the public part was ever shown; a rollback does not undo that."""
    if phase.policy.live_part != "public":
        return False
    shown = (
        select(SplitRow.revision)
        .join(BoardRow, BoardRow.split_revision == SplitRow.revision)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .where(
            BoardFlip.phase_id == phase.id,
            SplitRow.name == phase.split_name,
            or_(SplitRow.part == "private", SplitRow.private_revision.is_not(None)),
        )
    )
    return is_split_revealed(session, phase) or session.scalars(shown).first() is not None


def is_published(phase: Phase, submission: Submission) -> bool:
    """Whether an entry is public: if the phase keeps entries private, its team has published it."""
    return not phase.policy.entries_private or submission.published_at is not None


def can_publish(session: Session, phase: Phase) -> bool:
    """Whether entries are private until their teams publish them, and no reveal has ended that."""
    if not phase.policy.entries_private:
        return False
    is_closed = has_closed(phase, database_now(session))
    return not (is_closed and has_revealed(session, phase, datetime.min.replace(tzinfo=UTC)))


def has_revealed(session: Session, phase: Phase, since: datetime) -> bool:
    """Whether kept-back scores were shown at or after `since`, or the split was ever revealed."""
    unfrozen_at = phase.unfrozen_at if phase.policy.frozen_scores == "hidden" else None
    is_since = unfrozen_at is not None and unfrozen_at >= since
    return is_since or was_split_revealed(session, phase)


def is_late(phase: Phase, submission: Submission) -> bool:
    """Whether a submission came after its deadline, judged by its first byte."""
    deadline = deadline_of(phase, submission)
    return deadline is not None and (submission.arrived_at or submission.received_at) >= deadline


def deadline_of(phase: Phase, submission: Submission) -> datetime | None:
    """Return the deadline of a submission: the phase's, or its team's later one."""
    return own_deadline(phase, submission.granted_until) or phase.closes_at


def own_deadline(phase: Phase, granted_until: datetime | None) -> datetime | None:
    """Return the deadline granted to a team; None unless it is later than that of the phase."""
    if granted_until is None or phase.closes_at is None or granted_until <= phase.closes_at:
        return None
    return granted_until


def can_change(phase: Phase, submission: Submission, now: datetime) -> bool:
    """Whether its deadline has not passed, so that its team may choose which entry counts."""
    deadline = deadline_of(phase, submission)
    return deadline is None or now < deadline


def phase_now(session: Session, phase: Phase) -> PhaseNow:
    """Return the public state of a phase."""
    now = database_now(session)
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    return PhaseNow(
        part=split.part,
        n_counted=split.n_samples,
        frozen_since=frozen_since(phase, now),
        families_shown_from=families_shown_from(phase.policy, now),
        is_anonymous=is_anonymous(phase),
        takes_late_entries=takes_late_entries(session, phase, now),
    )


def new_salt() -> str:
    """Return a salt for the pseudonyms of a phase."""
    return secrets.token_hex(32)


def pseudonym_of_team(phase: Phase, team_id: int) -> str:
    """Return the name of a team while a phase is anonymous, such as `Team 7KQ-2MF`.

    It is keyed by the random salt of the phase: without that, it cannot be derived from name or
    order of registration, and it differs between phases.
    """
    letters = _keyed_letters(phase, f"team:{team_id}", 6)
    return f"Team {letters[:3]}-{letters[3:]}"


def is_pseudonym(name: str) -> bool:
    """Whether a name has the form of a pseudonym, which no team may take."""
    return _PSEUDONYM.fullmatch(name) is not None


def pseudonym_of_method(phase: Phase, team_id: int, method: str) -> str:
    """Return the name of a team's method while a phase is anonymous, such as `Method 4FX`."""
    return f"Method {_keyed_letters(phase, f'method:{team_id}:{method}', 3)}"


def _keyed_letters(phase: Phase, text: str, length: int) -> str:
    assert phase.pseudonym_salt is not None
    digest = hmac.new(bytes.fromhex(phase.pseudonym_salt), text.encode(), hashlib.sha256).digest()
    number = int.from_bytes(digest, "big")
    letters = []
    for _ in range(length):
        number, place = divmod(number, len(_LETTERS))
        letters.append(_LETTERS[place])
    return "".join(letters)


# The parts of a board or sheet that may be shown now: families and tasks wait for their date.


def shown_board(phase: Phase, board: Board, now: datetime) -> Board:
    """Return a board as it may be published now, without families before their date."""
    if families_shown_from(phase.policy, now) is None:
        return board
    return board.model_copy(
        update={
            "families": (),
            "entries": tuple(entry.model_copy(update={"families": {}}) for entry in board.entries),
            "comparisons": tuple(
                pair.model_copy(update={"families": {}, "tasks": {}}) for pair in board.comparisons
            ),
        }
    )


def shown_sheet(phase: Phase, row: ScoreSheetRow, now: datetime) -> ScoreSheet:
    """Return a sheet as anybody may see it now, without families and tasks before their date."""
    if families_shown_from(phase.policy, now) is None:
        return row.sheet
    return without_breakdown(row.sheet)


def without_breakdown(sheet: ScoreSheet) -> ScoreSheet:
    """Return only the totals of a sheet: nothing that is computed over a subset of samples.

    Further rows with an `n` cover a subset, too: a row over samples with one acceptable set would
    reveal the set of each sample, as a task would; reminder records about one sample, its task.
    Only the number of reminder records stays, as does coverage.
    """
    extra = {name: row for name, row in sheet.extra.items() if "n" not in row}
    if sheet.has_reminders:
        extra[REMINDER] = {"n": sheet.extra[REMINDER].get("n")}
    return sheet.model_copy(update={"families": {}, "tasks": {}, "extra": extra})


def score_kept_back_since(phase: Phase, submission: Submission, now: datetime) -> datetime | None:
    """Return since when this score is kept back from the team; None while it is shown."""
    since = frozen_since(phase, now)
    if since is None or phase.policy.frozen_scores == "shown" or submission.received_at < since:
        return None
    return since
