"""News to publish and withdraw, questions to answer; each on a page of its own."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.news.news import all_news, publish_news, withdraw_news
from exceptiondrive_records.news.questions import all_questions, answer_question
from exceptiondrive_records.participation.messages import MAX_TEXT, MAX_TITLE
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_server.news.queries import asked_question, news_view
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_page,
    take_step,
)

router = APIRouter(prefix="/organize/news", include_in_schema=False)
HERE = "/organize/news"
Id = Annotated[str, Path(max_length=64)]
_COMMAND = "exceptiondrive organizer news"


@router.get("")
def show_news(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """List questions, those that wait first, and news."""
    with services.database.read() as session:
        questions = [asked_question(row, team) for row, team in all_questions(session)]
        news = [news_view(row) for row in all_news(session)]
    template = "news/organizer_news.html"
    return organizer_page(request, browser, template, "news", questions=questions, news=news)


@router.get("/new")
def show_new(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """Ask what is announced."""
    with services.database.read() as session:
        step = _new(session)
    return step_page(request, browser, step)


@router.post("/new")
def post_new(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, form: PostedForm
) -> Response:
    """Announce it."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        publish_news(
            session,
            values["phase"],
            values["title"],
            values["text"],
            actor=browser.principal.actor,
        )

    with services.database.read() as session:
        step = _new(session)
    return take_step(request, services, browser, step, form, take, "news_published")


@router.get("/{news_id}/withdraw")
def show_withdrawal(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, news_id: Id
) -> Response:
    """Ask whether news are to be withdrawn."""
    with services.database.read() as session:
        step = _withdrawal(session, news_id)
    return step_page(request, browser, step)


@router.post("/{news_id}/withdraw")
def post_withdrawal(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    news_id: Id,
) -> Response:
    """Withdraw news."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        actor = browser.principal.actor
        withdraw_news(session, news_id, reason=values["reason"], actor=actor)

    with services.database.read() as session:
        step = _withdrawal(session, news_id)
    return take_step(request, services, browser, step, form, take, "news_withdrawn")


@router.get("/questions/{question_id}")
def show_answer(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, question_id: Id
) -> Response:
    """Ask for the answer to a question."""
    with services.database.read() as session:
        step = _answer(session, question_id)
    return step_page(request, browser, step)


@router.post("/questions/{question_id}")
def post_answer(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    question_id: Id,
) -> Response:
    """Answer a question."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        answer_question(
            session,
            question_id,
            values["text"],
            to_all=bool(values["to_all"]),
            actor=browser.principal.actor,
        )

    with services.database.read() as session:
        step = _answer(session, question_id)
    return take_step(request, services, browser, step, form, take, "question_answered")


def _new(session: Session) -> Step:
    shown = tuple((phase.id, phase.title) for phase in list_phases(session))
    return Step(
        section="news",
        title="Publish news",
        meaning="They stand on the page of the phase and in its feed, and every team is told.",
        button="Publish the news",
        back=HERE,
        back_words="News and questions",
        fields=(
            FormField("phase", "Phase", "choice", is_required=True, options=shown),
            FormField("title", "Title", is_required=True, max_length=MAX_TITLE),
            FormField("text", "Text", "lines", "Markdown", is_required=True, max_length=MAX_TEXT),
        ),
        command=f'{_COMMAND} publish --phase ID --title "…" --text "…"',
        is_grave=True,
    )


def _withdrawal(session: Session, news_id: str) -> Step:
    found = next((row for row in all_news(session) if row.id == news_id), None)
    if found is None:
        raise NotFound("news", news_id)
    return Step(
        section="news",
        title="Withdraw news",
        meaning="They leave page and feed. What teams were told stays told.",
        button="Withdraw the news",
        back=HERE,
        back_words="News and questions",
        fields=(REASON,),
        facts=(("Title", found.title), ("Text", found.text)),
        command=f'{_COMMAND} withdraw {news_id} --reason "…"',
        is_grave=True,
    )


def _answer(session: Session, question_id: str) -> Step:
    asked = all_questions(session)
    found = next(((row, team) for row, team in asked if row.id == question_id), None)
    if found is None:
        raise NotFound("question", question_id)
    row, team = found
    return Step(
        section="news",
        title="Answer a question",
        meaning="The team finds the answer in its notices. Told to all, question and answer become "
        "news of the phase, without the team's name.",
        button="Answer",
        back=HERE,
        back_words="News and questions",
        fields=(
            FormField("text", "Answer", "lines", is_required=True, max_length=MAX_TEXT),
            FormField("to_all", "Tell everybody", "yes", "without the team's name"),
        ),
        facts=(("Team", team), ("Phase", row.phase_id), ("Question", row.text)),
        command=f'exceptiondrive organizer questions answer {question_id} --text "…" [--to-all]',
        blockers=() if row.answered_at is None else ("The question is answered already.",),
    )
