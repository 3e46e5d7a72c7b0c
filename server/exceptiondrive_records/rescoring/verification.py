"""Recomputation of sheets from the uploads, and what came of it."""

from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import func, or_, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import checked_reason, random_id
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.tables import Verification, VerificationItem
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.rescoring import VerificationView, VerifyItemView, VerifyState
from exceptiondrive_schemas.score_sheet import ProtocolRef, ScoreSheet
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_schemas.submission import SubmissionStatus

AT_ONCE = 32
"""At most so many sheets are asked for at a time."""
MAX_ATTEMPTS = 4
_UNANSWERED = "recomputing did not finish in any of its attempts"


@dataclass(frozen=True)
class VerifyClaim:
    """The lease of one recomputation."""

    item_id: str
    fence: int
    submission_id: str
    phase_id: str
    challenge: str
    file_digest: str
    protocol_digest: str
    split_name: str
    split_revision: str
    expected_digest: str
    expected_sheet: ScoreSheet


def start_verification(
    session: Session, phase_id: str, *, sample: int | None, reason: str, actor: str
) -> Verification:
    """Ask for sheets of a phase to be recomputed from their uploads.

    Args:
        session: Of a write transaction.
        phase_id: Whose sheets, under the protocol and split revision that it shows.
        sample: How many, drawn by the database; None: all.
        reason: Why.
        actor: Who.

    Raises:
        NotFound: No such phase.
        InvalidRecord: There is no sheet to verify, or the reason is empty.
    """
    phase = find_phase(session, phase_id)
    reason = checked_reason(reason)
    query = (
        select(ScoreSheetRow.submission_id, ScoreSheetRow.exact_digest)
        .join(Submission, Submission.id == ScoreSheetRow.submission_id)
        .where(
            Submission.phase_id == phase.id,
            Submission.status == SubmissionStatus.SCORED,
            ScoreSheetRow.protocol_digest == phase.protocol_digest,
            ScoreSheetRow.split_revision == phase.split_revision,
        )
        .order_by(func.random())
        .limit(sample)
    )
    sheets = session.execute(query).all()
    if not sheets:
        raise InvalidRecord("The phase has no score sheets under its protocol yet.")
    verification = Verification(
        id=random_id(),
        phase_id=phase.id,
        protocol_digest=phase.protocol_digest,
        split_revision=phase.split_revision,
        reason=reason,
        actor=actor,
        created_at=database_now(session),
    )
    session.add(verification)
    session.flush()
    session.add_all(_item(verification.id, *sheet) for sheet in sheets)
    detail = {"phase": phase.id, "reason": reason, "sheets": len(sheets)}
    audit(session, actor, "verification started", verification.id, detail)
    return verification


def _item(verification_id: str, submission_id: str, digest: str) -> VerificationItem:
    return VerificationItem(
        id=random_id(24),
        verification_id=verification_id,
        submission_id=submission_id,
        state=VerifyState.WAITING,
        expected_digest=digest,
        attempts=0,
        fence=0,
    )


def due_items(session: Session, ring_again_after_s: float) -> list[str]:
    """Return the recomputations to ring for; those without attempts left are not among them."""
    now = database_now(session)
    waiting = VerificationItem.state == VerifyState.WAITING
    rung_lately = VerificationItem.rung_at >= now - timedelta(seconds=ring_again_after_s)
    outstanding = session.scalar(select(func.count()).where(waiting, rung_lately)) or 0
    query = (
        select(VerificationItem.id)
        .where(
            waiting,
            or_(VerificationItem.rung_at.is_(None), ~rung_lately),
            or_(VerificationItem.lease_until.is_(None), VerificationItem.lease_until < now),
        )
        .limit(max(0, AT_ONCE - outstanding))
    )
    return list(session.scalars(query))


def mark_items_rung(session: Session, item_ids: list[str]) -> None:
    """Note that messages are under way."""
    session.execute(
        update(VerificationItem)
        .where(VerificationItem.id.in_(item_ids))
        .values(rung_at=database_now(session))
        .execution_options(synchronize_session=False)
    )


def claim_item(session: Session, item_id: str, lease_s: float) -> VerifyClaim | None:
    """Lease a recomputation if it is free; after too many attempts it is recorded as failed."""
    now = database_now(session)
    item = session.get(VerificationItem, item_id, with_for_update=True)
    if item is None or item.state is not VerifyState.WAITING:
        return None
    if item.lease_until is not None and item.lease_until >= now:
        return None
    if item.attempts >= MAX_ATTEMPTS:
        _end(session, item, VerifyState.FAILED, None, _UNANSWERED)
        return None
    item.attempts += 1
    item.fence += 1
    item.lease_until = now + timedelta(seconds=lease_s)
    return _describe(session, item)


def _describe(session: Session, item: VerificationItem) -> VerifyClaim:
    verification = session.get_one(Verification, item.verification_id)
    submission = session.get_one(Submission, item.submission_id)
    phase = session.get_one(Phase, verification.phase_id)
    key = (submission.id, verification.protocol_digest, verification.split_revision)
    return VerifyClaim(
        item_id=item.id,
        fence=item.fence,
        submission_id=submission.id,
        phase_id=phase.id,
        challenge=phase.challenge,
        file_digest=submission.file_digest,
        protocol_digest=verification.protocol_digest,
        split_name=phase.split_name,
        split_revision=verification.split_revision,
        expected_digest=item.expected_digest,
        expected_sheet=session.get_one(ScoreSheetRow, key).sheet,
    )


def finish_item(
    session: Session,
    claim: VerifyClaim,
    state: VerifyState,
    found_digest: str | None,
    note: str | None = None,
) -> bool:
    """Record what a recomputation came to; False when the lease was lost."""
    item = session.get(VerificationItem, claim.item_id, with_for_update=True)
    if item is None or item.fence != claim.fence or item.state is not VerifyState.WAITING:
        return False
    _end(session, item, state, found_digest, note)
    return True


def _end(
    session: Session,
    item: VerificationItem,
    state: VerifyState,
    found_digest: str | None,
    note: str | None,
) -> None:
    item.state, item.found_digest, item.note = state, found_digest, note
    item.lease_until = None
    verification = session.get_one(Verification, item.verification_id, with_for_update=True)
    session.flush()
    if state is not VerifyState.EQUAL:
        detail = {"verification": verification.id, "expected": item.expected_digest}
        what = {"found": found_digest, "note": note, **detail}
        audit(session, "worker", f"sheet {state.value}", item.submission_id, what)
    counts = _counts(session, verification.id)
    if not counts.get(VerifyState.WAITING):
        verification.finished_at = database_now(session)
        outcome = {state.value: count for state, count in counts.items()}
        audit(session, "worker", "verification finished", verification.id, outcome)


def _counts(session: Session, verification_id: str) -> dict[VerifyState, int]:
    query = (
        select(VerificationItem.state, func.count())
        .where(VerificationItem.verification_id == verification_id)
        .group_by(VerificationItem.state)
    )
    return {state: count for state, count in session.execute(query)}


def verification_view(session: Session, verification_id: str) -> VerificationView:
    """Return a verification as organizers see it.

    Raises:
        NotFound: There is none.
    """
    found = session.get(Verification, verification_id)
    if found is None:
        raise NotFound("verification", verification_id)
    counts = _counts(session, found.id)
    bad = select(VerificationItem).where(
        VerificationItem.verification_id == found.id,
        VerificationItem.state.in_((VerifyState.DIFFERS, VerifyState.FAILED)),
    )
    protocol = find_protocol(session, found.protocol_digest)
    phase = session.get_one(Phase, found.phase_id)
    return VerificationView(
        id=found.id,
        phase=found.phase_id,
        protocol=ProtocolRef(version=protocol.version, digest=protocol.digest),
        split=SplitRef(name=phase.split_name, revision=found.split_revision),
        reason=found.reason,
        actor=found.actor,
        created_at=found.created_at,
        finished_at=found.finished_at,
        n_sheets=sum(counts.values()),
        n_equal=counts.get(VerifyState.EQUAL, 0),
        n_different=counts.get(VerifyState.DIFFERS, 0),
        n_failed=counts.get(VerifyState.FAILED, 0),
        problems=tuple(
            VerifyItemView(
                submission_id=item.submission_id,
                state=item.state,
                expected_digest=item.expected_digest,
                found_digest=item.found_digest,
                note=item.note,
            )
            for item in session.scalars(bad.order_by(VerificationItem.submission_id))
        ),
    )


def list_verifications(session: Session, phase_id: str | None = None) -> list[VerificationView]:
    """Return verifications, newest first."""
    query = select(Verification.id).order_by(Verification.created_at.desc())
    if phase_id is not None:
        query = query.where(Verification.phase_id == phase_id)
    return [verification_view(session, found) for found in session.scalars(query)]
