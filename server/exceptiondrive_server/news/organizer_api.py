"""News and answers, as organizers write them."""

from typing import Annotated

from fastapi import APIRouter, Path, Query
from pydantic import Field, StrictBool

from exceptiondrive_records.news.news import list_news, publish_news, withdraw_news
from exceptiondrive_records.news.questions import answer_question, list_questions
from exceptiondrive_records.participation.messages import MAX_TEXT, MAX_TITLE
from exceptiondrive_server.news.views import (
    AskedQuestion,
    NewsView,
    QuestionView,
    asked_question,
    news_view,
    question_view,
)
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.markdown import plain_text

router = APIRouter()
Id = Annotated[str, Path(max_length=64)]
OfPhase = Annotated[
    str | None, Query(alias="phase", max_length=64, description="Of this phase alone.")
]


class NewNews(Form):
    """What is announced."""

    title: Annotated[str, Field(min_length=1, max_length=MAX_TITLE)]
    text: Annotated[str, Field(min_length=1, max_length=MAX_TEXT, description="Markdown")]


class Answer(Form):
    """An answer to a question."""

    text: Annotated[str, Field(min_length=1, max_length=MAX_TEXT)]
    to_all: StrictBool = False
    """Question and answer become news, without the team's name; else the team alone is told."""


@router.get("/news", operation_id="listAllNews")
def get_all_news(services: ServicesOf, phase: OfPhase = None) -> list[NewsView]:
    """List the news of one phase or of all, withdrawn ones too, newest first."""
    with services.database.read() as session:
        return [news_view(row) for row in list_news(session, phase)]


@router.post("/phases/{phase_id}/news", operation_id="publishNews", status_code=201)
def post_news(services: ServicesOf, organizer: Organizer, phase_id: Id, news: NewNews) -> NewsView:
    """Publish news of a phase: on its page, in its feed, and in the inbox of every team.

    From an organizer whose role is confined to phases, it reaches only the inboxes of teams that submitted to the phase.
    """
    with services.database.write() as session:
        row = publish_news(
            session,
            phase_id,
            news.title,
            news.text,
            actor=organizer.actor,
            plain=plain_text(news.text),
            to_its_teams=not organizer.is_organizer,
        )
        return news_view(row)


@router.post("/news/{news_id}/withdraw", operation_id="withdrawNews")
def post_withdrawal(
    services: ServicesOf, organizer: Organizer, news_id: Id, action: Action
) -> NewsView:
    """Remove news from page and feed; notices in teams' inboxes stay."""
    with services.database.write() as session:
        actor = organizer.actor
        return news_view(withdraw_news(session, news_id, reason=action.reason, actor=actor))


@router.get("/questions", operation_id="listAllQuestions")
def get_all_questions(services: ServicesOf, phase: OfPhase = None) -> list[AskedQuestion]:
    """List the questions of all teams, about one phase or all; unanswered ones first."""
    with services.database.read() as session:
        return [asked_question(row, team) for row, team in list_questions(session, phase)]


@router.post("/questions/{question_id}/answer", operation_id="answerQuestion")
def post_answer(
    services: ServicesOf, organizer: Organizer, question_id: Id, answer: Answer
) -> QuestionView:
    """Answer a question, once: to the team only, or to all teams.

    From an organizer whose role is confined to phases, `to_all` reaches the teams that submitted to the phase.
    """
    with services.database.write() as session:
        answered = answer_question(
            session,
            question_id,
            answer.text,
            plain=plain_text(answer.text),
            to_all=answer.to_all,
            actor=organizer.actor,
            to_its_teams=not organizer.is_organizer,
        )
        return question_view(answered)
