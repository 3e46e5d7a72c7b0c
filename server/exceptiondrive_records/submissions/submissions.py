"""Accept submissions, each in one transaction, never to be lost; confirm and withdraw them."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, and_, bindparam, func, select, tuple_
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.standings import whole_sheets
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.columns import is_one_of
from exceptiondrive_records.db.errors import (
    Conflict,
    InvalidRecord,
    NotFound,
    NotListed,
    PhaseClosed,
)
from exceptiondrive_records.db.identifiers import (
    checked_link,
    checked_name,
    checked_text,
    random_id,
)
from exceptiondrive_records.phases.allowances import is_open_to, is_revealed
from exceptiondrive_records.phases.disqualified import require_not_disqualified
from exceptiondrive_records.phases.policy import (
    has_closed,
    has_revealed,
    own_deadline,
    takes_late_entries,
)
from exceptiondrive_records.phases.quotas import quota_of, require_quota
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    Shadow,
    key_of_phase,
    phase_and_shadow,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.phases.terms import require_terms
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import require_approved
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.jobs import new_job
from exceptiondrive_records.work.lease import cancel
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import Links, MethodFacts

# Links between two submissions of a team: an entry and its counterpart without reminder.


_WITHOUT_A_SCORE = (SubmissionStatus.WITHDRAWN, SubmissionStatus.REJECTED, SubmissionStatus.FAILED)


def require_counterpart(
    session: Session, team_id: int, phase: Phase, linked_to: str | None
) -> None:
    """Refuse a link for which no board can ever show an effect, as far as that is known.

    A replaced one is accepted: it may return, and a submit-only sender must not learn which counts.

    Raises:
        InvalidRecord: The challenge links nothing, or the counterpart is of another phase.
        NotFound: The team has no such submission.
        Conflict: The counterpart will never have a score, or has reminder records of its own.
    """
    if linked_to is None:
        return
    counterpart = CHALLENGES[phase.challenge].counterpart
    if counterpart is None:
        raise InvalidRecord(
            f"Submissions of the {phase.challenge} challenge are not linked: leave out the one "
            "without reminder."
        )
    found = session.scalars(
        select(Submission).where(Submission.id == linked_to, Submission.team_id == team_id)
    ).first()
    if found is None:
        raise NotFound("submission", linked_to, " of your team")
    if found.phase_id != phase.id:
        raise InvalidRecord(
            f"The submission {linked_to!r} is of the phase {found.phase_id!r}; link one of "
            f"{phase.id!r}: {counterpart}."
        )
    if found.status in _WITHOUT_A_SCORE:
        raise Conflict(f"The submission {linked_to!r} was {found.status}; link one with a score.")
    sheets = whole_sheets(session, [found.id], key_of_phase(phase))
    if any(sheet.has_reminders for _, sheet in sheets):
        raise Conflict(
            f"The submission {linked_to!r} has reminder records of its own; link one without."
        )


def _linked_otherwise(first: Submission) -> Conflict:
    """Return the refusal of the same bytes with another link: an upload never changes a record."""
    link = "without a link" if first.linked_to is None else f"linked to {first.linked_to!r}"
    return Conflict(
        f"The same bytes were submitted before, as {first.id!r}, {link}: that submission stands, no "
        "quota was spent. To link them anew, withdraw it and submit again."
    )


def checked_description(text: str) -> str:
    """Return a valid description.

    Raises:
        InvalidRecord: It is too long, or cannot be shown.
    """
    return checked_text(
        "description", text, max_length=2000, may_be_empty=True, may_have_lines=True
    )


def checked_facts(facts: MethodFacts) -> MethodFacts | None:
    """Return facts with valid texts; None if there are none.

    Raises:
        InvalidRecord: A text cannot be shown.
    """
    texts = {
        name: checked_text(
            str(field.title), getattr(facts, name), max_length=200, may_be_empty=True
        )
        for name, field in MethodFacts.model_fields.items()
        if field.annotation is str
    }
    checked = facts.model_copy(update=texts)
    return checked if checked != MethodFacts() else None


def require_same_words(first: Submission, words: Mapping[str, object]) -> None:
    """Refuse the same bytes with another name, link, description or facts than the first time.

    `words` are the new values by column; empty ones are ignored.

    Raises:
        Conflict: They differ; only an edit, which keeps the history, can change them.
    """
    differs = [name for name, value in words.items() if value and value != getattr(first, name)]
    if differs:
        names = ", ".join(name.removesuffix("_url") for name in differs)
        stands = "waits for your word" if first.is_asked else "stands"
        raise Conflict(
            f"The same bytes were submitted before, as {first.id!r}, a run of {first.method!r}: that "
            f"submission {stands}, no quota was spent and nothing changed. What differs now: {names}. "
            f"To change that, without a new submission, edit it: exceptiondrive edit {first.id}, or "
            "on its page."
        )


_SAME_BYTES_AGAIN = (SubmissionStatus.WITHDRAWN, SubmissionStatus.FAILED)
"""Statuses after which the same bytes are a new submission."""
_OF_TEAM = and_(Submission.team_id == bindparam("team"), Submission.phase_id == bindparam("phase"))
_SAME_BYTES = select(Submission).where(
    _OF_TEAM,
    Submission.file_digest == bindparam("file"),
    ~is_one_of(Submission.status, _SAME_BYTES_AGAIN),
)
_LAST_FACTS = (
    select(Submission.facts)
    .where(_OF_TEAM, Submission.method == bindparam("method"))
    .order_by(Submission.received_at.desc(), Submission.id.desc())
    .limit(1)
)
KEYS_ARE_KEPT = timedelta(hours=24)
"""How long a repeated upload is recognized by its `Idempotency-Key`."""
LONGEST_CONFIRMATION = timedelta(hours=1)
"""Any confirmation that began in time has ended after so long."""
LONGEST_UPLOAD = timedelta(minutes=15)
"""A longer upload is judged by its end, so that nobody gains time by holding a connection open."""


@dataclass(frozen=True)
class Accepted:
    """The outcome of `accept`; `job_id` is None if it was accepted before.

    The same upload, repeated with its key, is no duplicate: it gets the answer of the first time.
    """

    submission: Submission
    is_duplicate: bool
    job_id: str | None


def accept(
    session: Session,
    *,
    team_id: int,
    phase_id: str,
    method: str,
    description: str = "",
    links: Links = Links(),  # noqa: B008 - immutable
    facts: MethodFacts | None = None,
    linked_to: str | None = None,
    file_digest: str,
    size_bytes: int,
    arrived_at: datetime | None = None,
    idempotency_key: str | None = None,
    asks_first: bool = False,
) -> Accepted:
    """Accept an upload: record submission, first job and audit line, or none of them.

    The same bytes of a team in a phase return the first submission and cost nothing. If that one
    waits for confirmation by its team, they confirm it: the new submission counts in its place.

    Args:
        session: Session of a write transaction.
        team_id: Owner.
        phase_id: Where it competes.
        method: Name of the method, part of the identity of its board entry.
        description: Free text.
        links: Where the method is described.
        facts: Facts about the method; by default those of the team's last run of it in the phase.
        linked_to: The team's submission of the same agent without reminder, in this phase.
        file_digest: Digest of the stored file, `sha256:` and 64 hex digits.
        size_bytes: Size of the stored file.
        arrived_at: When its first byte came, by the database's clock; this time must be within the
            deadline, unless the rest took longer than `LONGEST_UPLOAD`.
        idempotency_key: The sender's key of this upload: with it, a repetition returns the same
            submission, whatever its outcome meanwhile.
        asks_first: Let it count only if it replaces no entry and would be ranked; otherwise it is
            rejected with questions that its team can confirm.

    Raises:
        NotFound: No such phase, or the team has no submission to link to.
        InvalidRecord: A text or link cannot be used.
        Conflict: The counterpart has no score, the same bytes were sent with other words, the key
            belongs to another upload, or the team was refused.
        NotAllowed: The team waits for approval, is disqualified, or has not accepted the terms.
        PhaseClosed: The phase takes no submissions now.
        QuotaExceeded: The quota of the day, or the total one, is used up.
        RejectedCapExceeded: Too many files were rejected, or failed, today.
        ConcurrentQuotaExceeded: Too many submissions of the team still wait.
    """
    team = hold_team(session, team_id)
    phase, shadow = phase_and_shadow(session, phase_id)
    words = {
        "method": checked_name("method name", method),
        "description": checked_description(description),
        "paper_url": checked_link("paper", links.paper),
        "code_url": checked_link("code", links.code),
        "facts": None if facts is None else checked_facts(facts),
    }
    first, granted_until = require_acceptable(
        session,
        team,
        phase,
        file_digest,
        linked_to=linked_to,
        arrived_at=arrived_at,
        idempotency_key=idempotency_key,
        asks_first=asks_first,
    )
    new_id, now = random_id(), database_now(session)
    if first is not None and _gives_way(first, now, asks_first=asks_first):
        first.status, first.confirmed_as = SubmissionStatus.WITHDRAWN, new_id
        first.status_at = first.withdrawn_at = now
        session.flush()  # a unique index allows one active submission of the same bytes
    elif first is not None:
        if first.is_asked or first.status is not SubmissionStatus.REJECTED:
            require_same_words(first, words)
        is_same_upload = idempotency_key is not None and first.idempotency_key == idempotency_key
        return Accepted(first, is_duplicate=not is_same_upload, job_id=None)
    if not words["facts"]:  # default to those of the method's last file
        of_method = {"team": team_id, "phase": phase.id, "method": words["method"]}
        words["facts"] = session.scalars(_LAST_FACTS, of_method).first()
    submission = Submission(
        id=new_id,
        phase_id=phase.id,
        team_id=team_id,
        **words,
        linked_to=linked_to,
        file_digest=file_digest,
        size_bytes=size_bytes,
        status=SubmissionStatus.RECEIVED,
        received_at=now,
        status_at=now,
        arrived_at=arrival(session, phase, arrived_at, now),
        granted_until=granted_until,
        idempotency_key=idempotency_key,
        asks_first=asks_first,
    )
    job = new_job(submission, phase.protocol_digest, phase.split_revision, Lane.LIVE, True, now)
    session.add(submission)
    session.flush()
    session.add(job)
    if shadow is not None:
        _score_under_both(session, submission, shadow, now)
    detail = {
        "phase": phase.id,
        "method": submission.method,
        "file_digest": file_digest,
        "size_bytes": size_bytes,
    }
    audit(session, f"team:{team_id}", "submission received", submission.id, detail)
    return Accepted(submission, is_duplicate=False, job_id=job.id)


def confirm(session: Session, submission_id: str, *, actor: str) -> Submission:
    """Confirm an upload as a new submission with the same file and texts. Idempotent.

    Until `LONGEST_UPLOAD` after its first byte, the time of that byte must be within the deadline,
    later the current time. The file is kept for an hour longer than it can be confirmed, so that a
    concurrent confirmation does not lose it.

    Raises:
        NotFound: No such submission.
        Conflict: It does not wait for confirmation, or the time to confirm has passed.
        RecordsError: It is refused as by `accept`.
    """
    asked = find_submission(session, submission_id)
    hold_team(session, asked.team_id)
    session.refresh(asked)
    if asked.confirmed_as is not None:
        return find_submission(session, asked.confirmed_as)
    if not asked.is_asked:
        raise Conflict("Nothing is asked of this submission; there is nothing to confirm.")
    if not asked.can_be_confirmed(database_now(session)):
        raise Conflict("The time to confirm has passed. Send the file again to submit it.")
    counted = accept(
        session,
        team_id=asked.team_id,
        phase_id=asked.phase_id,
        method=asked.method,
        description=asked.description,
        links=Links(paper=asked.paper_url, code=asked.code_url),
        facts=asked.facts,
        linked_to=asked.linked_to,
        file_digest=asked.file_digest,
        size_bytes=asked.size_bytes,
        arrived_at=asked.arrived_at,
    ).submission
    audit(session, actor, "submission confirmed", counted.id, {"asked": submission_id})
    return counted


def takes_confirmation(session: Session, phase: Phase, asked: Submission, now: datetime) -> bool:
    """Whether the phase would accept a confirmation, even if only for the late view."""
    moment = arrival(session, phase, asked.arrived_at, now)
    return _takes_upload(session, phase, own_deadline(phase, asked.granted_until), moment)


def require_acceptable(
    session: Session,
    team: Team,
    phase: Phase,
    file_digest: str,
    *,
    linked_to: str | None,
    arrived_at: datetime | None,
    idempotency_key: str | None,
    asks_first: bool,
) -> tuple[Submission | None, datetime | None]:
    """Refuse an upload that cannot be accepted.

    It is called before any byte is stored, and again by `accept` under the lock of the team,
    without which quotas would not be exact.

    Returns: The team's first submission of the same bytes, if any, and the later deadline granted
        to the team, for a new one, unless a reveal has ended it.

    Raises:
        RecordsError: As `accept`, except for texts and links.
    """
    require_approved(team)
    require_not_disqualified(session, team.id, phase, file_digest)
    now = database_now(session)
    first = _same_upload(session, team.id, phase, file_digest, idempotency_key, now)
    first = first or same_bytes(session, team.id, phase.id, file_digest)
    if first is not None and not _gives_way(first, now, asks_first=asks_first):
        if linked_to not in (None, first.linked_to):
            require_counterpart(session, team.id, phase, linked_to)
            raise _linked_otherwise(first)
        return first, None
    require_terms(session, team.id, phase)
    quota = quota_of(session, team.id, phase)
    _require_open(session, phase, quota.closes_at, arrival(session, phase, arrived_at, now))
    require_quota(quota, is_sound=first is not None)  # it was read, and its team asked
    require_counterpart(session, team.id, phase, linked_to)
    has_ended = quota.closes_at is not None and is_revealed(session, phase)
    return first, None if has_ended else quota.closes_at


def _gives_way(first: Submission, now: datetime, *, asks_first: bool) -> bool:
    """Whether the same bytes replace it: they confirm it, or it can no longer be confirmed."""
    return first.is_asked and not (asks_first and first.can_be_confirmed(now))


def arrival(session: Session, phase: Phase, arrived_at: datetime | None, now: datetime) -> datetime:
    """Return the time to compare with the deadline: the first byte's, or now if that is long ago.

    It is also now if scores were revealed since the first byte: otherwise a slow upload could be
    completed in knowledge of them.
    """
    if arrived_at is None or not now - LONGEST_UPLOAD <= arrived_at <= now:
        return now
    is_revealed = has_closed(phase, now) and has_revealed(session, phase, arrived_at)
    return now if is_revealed else arrived_at


def _score_under_both(
    session: Session, submission: Submission, shadow: Shadow, now: datetime
) -> None:
    """While a protocol update is open, also score under the key that is not shown."""
    job = new_job(submission, *shadow.key, Lane.RESCORE, False, now, is_held=shadow.is_held)
    session.add(job)


def withdraw(session: Session, submission_id: str, *, actor: str) -> Submission:
    """Withdraw a submission: it leaves the board, open jobs end, quota stays used. Idempotent.

    Raises:
        NotFound: No such submission.
        Conflict: It was rejected or has failed, so there is nothing to withdraw.
    """
    lock_jobs(session, Job.submission_id == submission_id)
    submission = find_submission(session, submission_id, lock=True)
    if submission.status is SubmissionStatus.WITHDRAWN:
        return submission
    if submission.status in (SubmissionStatus.REJECTED, SubmissionStatus.FAILED):
        raise Conflict(f"The submission was {submission.status}; there is nothing to withdraw.")
    before = submission.status
    now = database_now(session)
    submission.status = SubmissionStatus.WITHDRAWN
    submission.status_at = submission.withdrawn_at = now
    cancel(session, Job, now, Job.submission_id == submission_id)
    for key in scored_under(session, submission_id):
        want_board(session, submission.phase_id, *key)
    audit(session, actor, "submission withdrawn", submission_id, {"was": before})
    return submission


def find_submission(
    session: Session, submission_id: str, *, team_id: int | None = None, lock: bool = False
) -> Submission:
    """Return a submission; with `team_id`, only if it is that team's.

    Raises:
        NotFound: There is none, or it is not the team's; the answer is the same.
    """
    how = {"key_share": True} if lock else None  # lets others write rows that refer to it
    submission = session.get(Submission, submission_id, with_for_update=how, populate_existing=lock)
    if submission is None or (team_id is not None and submission.team_id != team_id):
        raise NotFound("submission", submission_id)
    return submission


def ids_of_team(session: Session, team_id: int, phase_id: str) -> frozenset[str]:
    """Return the ids of all submissions of a team to a phase."""
    query = select(Submission.id).where(
        Submission.team_id == team_id, Submission.phase_id == phase_id
    )
    return frozenset(session.scalars(query))


def submission_page(
    session: Session,
    *,
    team_id: int | None = None,
    phase_id: str | None = None,
    status: SubmissionStatus | None = None,
    after: str | None = None,
    limit: int,
) -> tuple[list[Submission], str | None]:
    """Return a page of submissions, newest first, and the cursor of the next page, if any.

    The page begins after the submission `after`.

    Raises:
        NotListed: `after` is not in the list.
    """
    query = select(Submission).order_by(Submission.received_at.desc(), Submission.id.desc())
    if team_id is not None:
        query = query.where(Submission.team_id == team_id)
    if phase_id is not None:
        query = query.where(Submission.phase_id == phase_id)
    if status is not None:
        query = query.where(Submission.status == status)
    if after is not None:
        try:
            last = find_submission(session, after, team_id=team_id)
        except NotFound:
            raise NotListed from None
        place = tuple_(Submission.received_at, Submission.id)
        query = query.where(place < tuple_(last.received_at, last.id))
    found = list(session.scalars(query.limit(limit + 1)))
    return found[:limit], found[limit - 1].id if len(found) > limit else None


def counts_by_team(session: Session) -> dict[int, int]:
    """Return how many submissions each team has, of any status."""
    query = select(Submission.team_id, func.count()).group_by(Submission.team_id)
    return {team_id: count for team_id, count in session.execute(query)}


def counts_by_phase(session: Session) -> dict[str, int]:
    """Return how many submissions each phase has, of any status."""
    query = select(Submission.phase_id, func.count()).group_by(Submission.phase_id)
    return {phase_id: count for phase_id, count in session.execute(query)}


def keeps_its_file(session: Session) -> ColumnElement[bool]:
    """Condition: a submission mentions its file; false over an hour after its time to confirm.

    If it was confirmed or sent again, another one in its place mentions the same file.
    """
    until = Submission.confirm_until
    return until.is_(None) | (until > database_now(session) - LONGEST_CONFIRMATION)


def _same_upload(
    session: Session,
    team_id: int,
    phase: Phase,
    file_digest: str,
    idempotency_key: str | None,
    now: datetime,
) -> Submission | None:
    """Return the team's submission that was sent under this key, if any.

    Raises:
        Conflict: The key belongs to another upload.
    """
    if idempotency_key is None:
        return None
    first = session.scalars(
        select(Submission)
        .where(
            Submission.team_id == team_id,
            Submission.idempotency_key == idempotency_key,
            Submission.received_at > now - KEYS_ARE_KEPT,
        )
        .order_by(Submission.received_at.desc())
        .limit(1)
    ).first()
    if first is not None and (first.phase_id, first.file_digest) != (phase.id, file_digest):
        raise Conflict(
            f"The Idempotency-Key names another upload of the last 24 hours, {first.id!r} in phase "
            f"{first.phase_id!r}. Give each upload a key of its own; nothing was taken."
        )
    return first


def same_bytes(
    session: Session, team_id: int, phase_id: str, file_digest: str
) -> Submission | None:
    """Return the team's submission of these bytes that has neither failed nor been withdrawn."""
    given = {"team": team_id, "phase": phase_id, "file": file_digest}
    return session.scalars(_SAME_BYTES, given).first()


def _takes_upload(
    session: Session, phase: Phase, own_closes_at: datetime | None, arrived_at: datetime
) -> bool:
    is_open = is_open_to(session, phase, own_closes_at, arrived_at)
    return is_open or takes_late_entries(session, phase, arrived_at)


def _require_open(
    session: Session, phase: Phase, own_closes_at: datetime | None, arrived_at: datetime
) -> None:
    if _takes_upload(session, phase, own_closes_at, arrived_at):
        return
    if phase.visibility != "shown":
        raise PhaseClosed(phase.title, f"is {phase.visibility}")
    if phase.opens_at is not None and arrived_at < phase.opens_at:
        raise PhaseClosed(phase.title, f"opens at {phase.opens_at:%Y-%m-%d %H:%M} UTC")
    closed = f"closed at {phase.closes_at:%Y-%m-%d %H:%M} UTC"
    if own_closes_at is not None and own_closes_at > arrived_at:
        closed += ", and your team's own deadline ended when what had been kept back was revealed"
    raise PhaseClosed(phase.title, closed)


def lock_jobs(session: Session, which: ColumnElement[bool]) -> None:
    """Lock jobs by id, and before submissions: a common order of all callers avoids deadlocks."""
    session.execute(select(Job.id).where(which).order_by(Job.id).with_for_update())


def scored_under(session: Session, submission_id: str) -> list[ScoringKey]:
    """Return the keys under which a submission has a sheet."""
    query = select(ScoreSheetRow.protocol_digest, ScoreSheetRow.split_revision).where(
        ScoreSheetRow.submission_id == submission_id
    )
    return sorted(ScoringKey(*row) for row in session.execute(query))
