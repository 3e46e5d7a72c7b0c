"""Public news of a phase; a team's questions to the organizers."""

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from exceptiondrive_records.accounts.sessions import require_unrevoked
from exceptiondrive_records.news.news import news_of
from exceptiondrive_records.news.questions import MAX_QUESTION, ask_question, questions_of
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.news.views import NewsView, QuestionView, news_view, question_view
from exceptiondrive_server.web.auth import Reader, ServicesOf, Submitter, team_of
from exceptiondrive_server.web.forms import Form
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(prefix="/phases", tags=["phases"])
_OF_TEAMS = (ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED, ProblemCode.NOT_FOUND)


class NewQuestion(Form):
    """What a team asks."""

    text: Annotated[str, Field(min_length=1, max_length=MAX_QUESTION)]


@router.get(
    "/{phase_id}/news", operation_id="listNews", responses=problem_responses(ProblemCode.NOT_FOUND)
)
def get_news(services: ServicesOf, phase_id: PhaseId) -> list[NewsView]:
    """List the news of a phase, newest first."""
    with services.database.read() as session:
        return [news_view(row) for row in news_of(session, shown_phase(session, phase_id).id)]


@router.get(
    "/{phase_id}/questions", operation_id="listQuestions", responses=problem_responses(*_OF_TEAMS)
)
def get_questions(services: ServicesOf, reader: Reader, phase_id: PhaseId) -> list[QuestionView]:
    """List what the team asked about a phase, newest first."""
    with services.database.read() as session:
        phase = shown_phase(session, phase_id)
        return [question_view(row) for row in questions_of(session, team_of(reader), phase.id)]


@router.post(
    "/{phase_id}/questions",
    operation_id="askQuestion",
    status_code=201,
    responses=problem_responses(*_OF_TEAMS, ProblemCode.CONFLICT),
)
def post_question(
    services: ServicesOf, submitter: Submitter, phase_id: PhaseId, question: NewQuestion
) -> QuestionView:
    """Ask the organizers about a phase; the answer arrives in the team's inbox."""
    with services.database.write() as session:
        require_unrevoked(session, submitter)
        asked = ask_question(
            session, team_of(submitter), phase_id, question.text, actor=submitter.actor
        )
        return question_view(asked)
