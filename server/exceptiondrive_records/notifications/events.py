"""Notify subscribed teams of events: scored, failed, overtaken, phase ends soon.

The reconciler polls for them. Nothing is sent twice: each message has a unique subject.
"""

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import NamedTuple

from sqlalchemy import and_, case, exists, func, select
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.boards.boards import board_at
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.notifications.tables import ContactPoint, Notification
from exceptiondrive_records.participation.tables import Allowance, TermsAcceptance
from exceptiondrive_records.phases.allowances import is_revealed
from exceptiondrive_records.phases.disqualified import team_disqualified_since
from exceptiondrive_records.phases.policy import own_deadline
from exceptiondrive_records.phases.scoring_keys import is_of_key, key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.submissions import ids_of_team
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.notifications import EventKind, Subscription
from exceptiondrive_schemas.api.own_entries import question_of
from exceptiondrive_schemas.api.standing_words import ranked_words
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import counted

POLL_EVERY_S = 15.0
_TOLD_WITHIN = timedelta(days=1)
_ENDS_SOON = timedelta(days=1)
_PASSED_WITHIN = timedelta(hours=1)
OUTCOMES: dict[SubmissionStatus, EventKind] = {
    SubmissionStatus.SCORED: "scored",
    SubmissionStatus.REJECTED: "failed",
    SubmissionStatus.FAILED: "failed",
}
_OUTCOME_WORDS: dict[SubmissionStatus, str] = {
    SubmissionStatus.SCORED: "was scored",
    SubmissionStatus.REJECTED: "was rejected",
    SubmissionStatus.FAILED: "could not be scored",
}


class _Event(NamedTuple):
    """An event to notify a team of; `subject` identifies it, so that it is sent once."""

    kind: EventKind
    subject: str
    title: str
    sentences: tuple[str, ...]
    address: str
    """Path of a page with more, on the server."""
    phase: str


def tell_teams(database: Database) -> int:
    """Notify subscribed teams of recent events; return the number of messages."""
    with database.read() as session:
        now = database_now(session)
        events = [
            (team_id, event)
            for team_id, wishes in _wishes(session).items()
            for event in _events(session, team_id, wishes, now)
            if not _is_told(session, team_id, event)
        ]
    if not events:
        return 0
    with database.write() as session:
        told = 0
        for team_id, event in events:
            team = session.get_one(Team, team_id)
            if team.is_gone or _is_told(session, team_id, event):
                continue
            tell_team(
                session,
                team,
                event.kind,
                event.title,
                event.sentences,
                address=event.address,
                phase=event.phase,
                subject=event.subject,
                subscription=event.kind,
                at=now,
            )
            told += 1
        return told


def _wishes(session: Session) -> dict[int, dict[Subscription, datetime]]:
    """Return by team what its confirmed addresses subscribe to besides updates, and since when."""
    query = select(ContactPoint).where(
        ContactPoint.removed_at.is_(None),
        ContactPoint.confirmed_at.is_not(None),
        ContactPoint.wishes.not_in(("", "updates")),
    )
    found: dict[int, dict[Subscription, datetime]] = {}
    for contact in session.scalars(query.order_by(ContactPoint.team_id, ContactPoint.id)):
        since = found.setdefault(contact.team_id, {})
        for subscription in contact.wishes.split():
            at = contact.confirmed_at or contact.created_at
            since[subscription] = min(at, since.get(subscription, at))  # type: ignore[index,call-overload]
    return found


def _events(
    session: Session, team_id: int, wishes: dict[Subscription, datetime], now: datetime
) -> Iterator[_Event]:
    yield from _outcomes(session, team_id, wishes, now)
    if "overtaken" in wishes:
        yield from _overtaken_events(session, team_id, now)
    if "phase_ends" in wishes:
        yield from _deadline_events(session, team_id, now)


def _outcomes(
    session: Session, team_id: int, wishes: dict[Subscription, datetime], now: datetime
) -> Iterator[_Event]:
    told = exists().where(
        Notification.team_id == team_id,
        Notification.kind == case(OUTCOMES, value=Submission.status),
        Notification.subject == Submission.id,
    )
    query = select(Submission).where(
        Submission.team_id == team_id,
        Submission.status.in_(OUTCOMES),
        Submission.status_at > now - _TOLD_WITHIN,
        ~told,  # otherwise each poll would read a whole day again
    )
    for submission in session.scalars(query.order_by(Submission.status_at)):
        kind = OUTCOMES[submission.status]
        if kind not in wishes or submission.status_at < wishes[kind]:
            continue
        seen = view(session, submission)
        if seen.awaits_board:
            continue
        outcome = "waits for your word" if seen.is_asked else _OUTCOME_WORDS[seen.status]
        phase = session.get_one(Phase, seen.phase)
        title = f"{seen.method} {outcome} in {phase.title}"
        sentences = tuple(_sentences(session, seen))
        page = f"/submissions/{seen.id}"
        yield _Event(kind, seen.id, title, sentences, page, seen.phase)


def _sentences(session: Session, seen: SubmissionView) -> Iterator[str]:
    """Yield the sentences about an outcome that the team's own page shows."""
    if seen.report is not None and seen.report.faults:
        yield f"{counted(seen.report.n_faults, 'fault')} in the file."
    if question := question_of(seen):
        yield question
    if seen.failure is not None:
        yield seen.failure.message
        yield "It cost no quota; while the phase takes files, the same one may be sent again."
    if seen.sheet is not None:
        protocol = find_protocol(session, seen.sheet.protocol.digest)
        values = seen.sheet.average(protocol.grading.headline)
        challenge = CHALLENGES[seen.challenge]
        digits = protocol.publication
        for words in ranked_words(challenge, values, seen.intervals, digits):
            yield f"{words}."
    if seen.score_kept_back_since is not None:
        since = f"{seen.score_kept_back_since:%Y-%m-%d %H:%M} UTC"
        yield f"The board is frozen since {since}: score and rank are kept back until it is revealed."
    elif seen.is_late:
        yield "It came after the deadline, so it holds no rank and moves none."
    elif seen.rank is not None:
        low, high = seen.rank_interval or (seen.rank, seen.rank)
        yield f"Rank {seen.rank}{f' ({low} to {high})' if low != high else ''}."
    elif seen.unranked_because is not None:
        yield f"Not ranked: {seen.unranked_because}."
    elif not seen.is_published:
        yield "It is private, and ranks nowhere until your team publishes it."


def _overtaken_events(session: Session, team_id: int, now: datetime) -> Iterator[_Event]:
    """Yield entries that lost ranks within the last hour, under the same protocol and split.

    Boards before the last such message are ignored, so that it is not repeated. An entry passed
    only by the team's own entries is ignored, too.
    """
    hour = now.strftime("%Y-%m-%dT%H")
    flipped = exists().where(BoardFlip.phase_id == Phase.id, BoardFlip.at >= now - _PASSED_WITHIN)
    query = select(Phase).where(
        Phase.current_board_id.is_not(None), Phase.visibility == "shown", flipped
    )
    for phase in session.scalars(query):
        own = ids_of_team(session, team_id, phase.id)
        stands = select(BoardEntryRow.submission_id, BoardEntryRow.rank).where(
            BoardEntryRow.board_id == phase.current_board_id,
            BoardEntryRow.submission_id.in_(own),
            BoardEntryRow.rank.is_not(None),
        )
        ranks = {key: rank or 0 for key, rank in session.execute(stands)}
        if not ranks:
            continue
        told_at = session.scalar(
            select(func.max(Notification.created_at)).where(
                Notification.team_id == team_id,
                Notification.kind == "overtaken",
                Notification.subject.startswith(f"{phase.id}/", autoescape=True),
            )
        )
        since = max(now - _PASSED_WITHIN, told_at or now - _PASSED_WITHIN)
        lines = [
            f"{session.get_one(Submission, key).method}: rank {best} before, {rank} now."
            for key, best, best_among_others in _best_ranks(session, phase, own, since)
            if (rank := ranks.get(key, 0)) > best
            and rank - sum(each < rank for each in ranks.values()) > best_among_others
        ]
        if lines:
            title = f"Your entries were passed in {phase.title}"
            subject = f"{phase.id}/{hour}"
            yield _Event("overtaken", subject, title, tuple(lines), _board(phase), phase.id)


def _best_ranks(
    session: Session, phase: Phase, submission_ids: frozenset[str], since: datetime
) -> list[tuple[str, int, int]]:
    """Return each submission with its best rank on the boards that the phase showed since then.

    The third value is its best rank among others: not counting `submission_ids` ahead of it.
    """
    stood = board_at(session, phase.id, since)
    ahead = aliased(BoardEntryRow)
    n_own_ahead = (
        select(func.count())
        .where(
            ahead.board_id == BoardEntryRow.board_id,
            ahead.submission_id.in_(submission_ids),
            ahead.rank < BoardEntryRow.rank,
        )
        .scalar_subquery()
    )
    query = (
        select(
            BoardEntryRow.submission_id,
            func.min(BoardEntryRow.rank),
            func.min(BoardEntryRow.rank - n_own_ahead),
        )
        .join(BoardRow, BoardRow.id == BoardEntryRow.board_id)
        .where(
            is_of_key(BoardRow, key_of_phase(phase)),
            BoardRow.id.in_(
                select(BoardFlip.board_id).where(
                    BoardFlip.phase_id == phase.id, BoardFlip.at >= since
                )
            )
            | (BoardRow.id == (stood.id if stood else -1)),
            BoardEntryRow.submission_id.in_(submission_ids),
            BoardEntryRow.rank.is_not(None),
        )
        .group_by(BoardEntryRow.submission_id)
        .order_by(BoardEntryRow.submission_id)
    )
    found = session.execute(query)
    return [(key, rank, place) for key, rank, place in found if rank and place]


def _deadline_events(session: Session, team_id: int, now: datetime) -> Iterator[_Event]:
    """Yield phases of the team that end soon, once for each deadline to the minute.

    Phases in which the team is disqualified are left out.
    """
    submitted = select(Submission.phase_id).where(Submission.team_id == team_id)
    accepted = select(TermsAcceptance.phase_id).where(TermsAcceptance.team_id == team_id)
    granted = and_(Allowance.phase_id == Phase.id, Allowance.team_id == team_id)
    query = (
        select(Phase, Allowance.closes_at)
        .outerjoin(Allowance, granted)
        .where(
            (Phase.closes_at > now) | (Allowance.closes_at > now),
            Phase.visibility == "shown",
            Phase.id.in_(submitted) | Phase.id.in_(accepted),
        )
    )
    for phase, granted_until in session.execute(query):
        ends, whose = phase.closes_at, "Its"
        if ends is None or (phase.opens_at is not None and phase.opens_at > now):
            continue
        own = own_deadline(phase, granted_until)
        if own is not None and not is_revealed(session, phase):
            ends, whose = own, "Your team's own"
        if not now < ends <= now + _ENDS_SOON:
            continue
        if team_disqualified_since(session, team_id, phase) is not None:
            continue
        at = f"{ends:%Y-%m-%d %H:%M} UTC"
        subject = f"{phase.id}/{ends:%Y-%m-%dT%H:%M}"
        sentences = (f"{whose} deadline is {at}; an upload is judged by its first byte.",)
        title = f"{phase.title} ends soon"
        yield _Event("phase_ends", subject, title, sentences, _board(phase), phase.id)


def _board(phase: Phase) -> str:
    return f"/?phase={phase.id}"


def _is_told(session: Session, team_id: int, event: _Event) -> bool:
    query = select(Notification.id).where(
        Notification.team_id == team_id,
        Notification.kind == event.kind,
        Notification.subject == event.subject,
    )
    return session.scalar(query) is not None
