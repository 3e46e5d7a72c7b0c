"""Publish and withdraw news, answer questions, each on a page of its own."""

from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response

from exceptiondrive_records.news.news import find_news, list_news, publish_news, withdraw_news
from exceptiondrive_records.news.questions import (
    answer_question,
    count_waiting,
    find_question,
    list_questions,
)
from exceptiondrive_records.participation.messages import MAX_TEXT, MAX_TITLE
from exceptiondrive_records.phases.phases import find_phase, list_phases, titles_of_phases
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.news.views import asked_question, news_view
from exceptiondrive_server.web.browser_session import SignedIn
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.markdown import plain_text
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_at,
)

router = APIRouter(prefix="/organize", include_in_schema=False)
Id = Annotated[str, Path(max_length=64)]
SHOWN_ANSWERED = 50
"""The newest answers; those before them are asked for."""
_COMMAND = "exceptiondrive organizer news"


@router.get("/news")
def show_news(
    browser: OrganizerBrowser,
    phase: Annotated[str | None, Query(max_length=64)] = None,
    all_answered: bool = False,
) -> Response:
    """List questions, those that wait first, and news: of one phase or of all."""
    with browser.services.database.read() as session:
        of_phase = None if phase is None else find_phase(session, phase)
        found = list_questions(session, phase)
        n_waiting = count_waiting(session, phase)
        shown = len(found) if all_answered else n_waiting + SHOWN_ANSWERED
        questions = [asked_question(row, team) for row, team in found[:shown]]
        news = [news_view(row) for row in list_news(session, phase)]
        titles = titles_of_phases(session)
        phases = list_phases(session) if of_phase is None else [of_phase]
    return organizer_page(
        browser,
        "news/organizer_news.html",
        "news",
        questions=questions,
        n_waiting=n_waiting,
        n_more=len(found) - len(questions),
        news=news,
        titles=titles,
        phases=phases,
        of_phase=of_phase,
    )


@step_at(router, "/phases/{phase_id}/news")
def publication(browser: OrganizerBrowser, phase_id: Id) -> Step:
    """Announce something of a phase; whoever is confined to it tells the teams of it alone."""
    with browser.services.database.read() as session:
        phase = find_phase(session, phase_id)
    of_site = browser.principal.is_organizer
    told = "every team is told" if of_site else "the teams that submitted to it are told"
    return Step(
        section="phases",
        title="Publish news",
        meaning=f"It appears on the page of the phase and in its feed, and {told}.",
        button="Publish the news",
        back=f"/organize/phases/{phase_id}",
        back_words="The phase",
        fields=(
            FormField("title", "Title", is_required=True, max_length=MAX_TITLE),
            FormField("text", "Text", "lines", "Markdown", is_required=True, max_length=MAX_TEXT),
        ),
        facts=(("Phase", phase.title),),
        command=f'{_COMMAND} publish --phase {phase_id} --title "…" --text "…"',
        is_grave=True,
        take=lambda session, text, **given: publish_news(
            session, phase_id, text=text, plain=plain_text(text), to_its_teams=not of_site, **given
        ),
        done="news_published",
    )


@step_at(router, "/news/{news_id}/withdraw")
def withdrawal(browser: OrganizerBrowser, news_id: Id) -> Step:
    """Withdraw news."""
    with browser.services.database.read() as session:
        found = find_news(session, news_id)
    return _step(
        browser,
        found.phase_id,
        title="Withdraw news",
        meaning="It is removed from page and feed. Notices that teams already have stay.",
        button="Withdraw the news",
        fields=(REASON,),
        facts=(("Title", found.title), ("Text", found.text)),
        command=f'{_COMMAND} withdraw {news_id} --reason "…"',
        is_grave=True,
        take=partial(withdraw_news, news_id=news_id),
        done="news_withdrawn",
    )


@step_at(router, "/news/questions/{question_id}")
def answer(browser: OrganizerBrowser, question_id: Id) -> Step:
    """Answer a question."""
    with browser.services.database.read() as session:
        row = find_question(session, question_id)
        team = session.get_one(Team, row.team_id).slug
    of_site = browser.principal.is_organizer
    told = "" if of_site else ", told to the teams that submitted to it"
    return _step(
        browser,
        row.phase_id,
        title="Answer a question",
        meaning="The team finds the answer in its notices. If you tell everybody, question and answer "
        f"also become news of the phase, without the team's name{told}.",
        button="Answer",
        fields=(
            FormField("text", "Answer", "lines", "Markdown", is_required=True, max_length=MAX_TEXT),
            FormField("to_all", "Tell everybody", "yes", "without the team's name"),
        ),
        facts=(("Team", team), ("Phase", row.phase_id), ("Question", row.text)),
        command=f'exceptiondrive organizer questions answer {question_id} --text "…" [--to-all]',
        blockers=() if row.answered_at is None else ("The question is already answered.",),
        take=lambda session, text, **given: answer_question(
            session, question_id, text, plain=plain_text(text), to_its_teams=not of_site, **given
        ),
        done="question_answered",
    )


def _step(browser: SignedIn, phase_id: str, **words: Any) -> Step:
    of_phase = "" if browser.principal.is_organizer else f"?{urlencode({'phase': phase_id})}"
    back = f"/organize/news{of_phase}"
    return Step(section="news", back=back, back_words="News and questions", **words)
