"""Entries: what a board shows of a submission, and its published score sheet."""

from fastapi import APIRouter

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.boards.query import NamedBoard
from exceptiondrive_server.entries.queries import EntryView, published_entry
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(prefix="/entries", tags=["boards"])


@router.get(
    "/{submission_id}", operation_id="showEntry", responses=problem_responses(ProblemCode.NOT_FOUND)
)
def get_entry(services: ServicesOf, submission_id: SubmissionId, query: NamedBoard) -> EntryView:
    """Get an entry of a current board or late view; with `board`, as it was on that one.

    An entry that is not on the board answers 404.
    """
    with services.database.read() as session:
        return published_entry(session, submission_id, query)
