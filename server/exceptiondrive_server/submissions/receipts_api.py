"""Receipts of scored submissions, and the public keys to verify them."""

from fastapi import APIRouter
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.policy import is_anonymous, score_kept_back_since
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.submissions.views import published_sheets
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.receipt import Receipt, ReceiptKeys, ReceiptStatement
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.boards.query import NamedBoard
from exceptiondrive_server.entries.queries import published_entry
from exceptiondrive_server.web.auth import Reader, ServicesOf, own_team
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["receipts"])


@router.get("/receipt-keys", operation_id="listReceiptKeys", responses=problem_responses())
def get_receipt_keys(services: ServicesOf) -> ReceiptKeys:
    """List the public keys of receipts; those no longer used stay, for older receipts."""
    return ReceiptKeys(keys=services.signer.keys())


@router.get(
    "/submissions/{submission_id}/receipt",
    operation_id="showReceipt",
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED, ProblemCode.NOT_FOUND
    ),
)
def get_receipt(services: ServicesOf, principal: Reader, submission_id: SubmissionId) -> Receipt:
    """Get the signed receipt of a scored submission of your own team."""
    with services.database.read() as session:
        found = find_submission(session, submission_id, team_id=own_team(principal))
        statement = statement_of(session, found)
    return services.signer.sign(statement)


@router.get(
    "/entries/{submission_id}/receipt",
    operation_id="showEntryReceipt",
    responses=problem_responses(ProblemCode.NOT_FOUND),
)
def get_entry_receipt(
    services: ServicesOf, submission_id: SubmissionId, query: NamedBoard
) -> Receipt:
    """Get the signed receipt of an entry on a current board, or on the named `board`; public."""
    with services.database.read() as session:
        view = published_entry(session, submission_id, query)
        submission = find_submission(session, submission_id)
        if is_anonymous(find_phase(session, submission.phase_id)):  # it names team and file
            raise NotFound("public receipt, before names are revealed, of entry", submission_id)
        statement = _statement(session, submission, view.sheet)
    shown = {"team": view.entry.team, "method": view.entry.method}
    return services.signer.sign(statement.model_copy(update=shown))


def statement_of(session: Session, submission: Submission) -> ReceiptStatement:
    """Return the published score under the protocol and split revision that the phase shows.

    Raises:
        NotFound: There is none, or it is kept back.
    """
    phase = find_phase(session, submission.phase_id)
    now = database_now(session)
    sheet = published_sheets(session, phase, {submission.id}, now).get(submission.id)
    is_hidden = score_kept_back_since(phase, submission, now) is not None
    if sheet is None or is_hidden:
        until = " yet: its score is kept back until the organizers reveal the board"
        raise NotFound(
            "receipt of a score for submission", submission.id, until if is_hidden else ""
        )
    return _statement(session, submission, sheet)


def _statement(session: Session, submission: Submission, sheet: ScoreSheet) -> ReceiptStatement:
    key = (submission.id, sheet.protocol.digest, sheet.split.revision)
    return ReceiptStatement(
        submission_id=submission.id,
        file_digest=submission.file_digest,
        size_bytes=submission.size_bytes,
        phase=submission.phase_id,
        challenge=sheet.challenge,
        team=session.get_one(Team, submission.team_id).name,
        method=submission.method,
        protocol=sheet.protocol,
        split=sheet.split,
        scorer_version=sheet.scorer_version,
        n=sheet.n,
        micro=sheet.micro,
        macro_family=sheet.macro_family,
        families=sheet.families,
        sheet_digest=content_digest(sheet),
        received_at=submission.received_at,
        scored_at=session.get_one(ScoreSheetRow, key).created_at,
    )
