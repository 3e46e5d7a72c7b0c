"""News and questions as the API and pages show them."""

from datetime import datetime

from pydantic import BaseModel

from exceptiondrive_records.news.tables import News, Question


class NewsView(BaseModel):
    """News of a phase."""

    id: str
    phase: str
    title: str
    text: str
    """Markdown."""
    published_at: datetime
    withdrawn_at: datetime | None = None


class QuestionView(BaseModel):
    """A question of a team, and the answer."""

    id: str
    phase: str
    text: str
    asked_at: datetime
    answer: str | None
    answered_at: datetime | None
    is_public: bool
    """Whether question and answer stand among the news, without the team's name."""


class AskedQuestion(QuestionView):
    """A question as organizers see it."""

    team: str


def news_view(row: News) -> NewsView:
    """Return news as they are shown."""
    return NewsView(
        id=row.id,
        phase=row.phase_id,
        title=row.title,
        text=row.text,
        published_at=row.published_at,
        withdrawn_at=row.withdrawn_at,
    )


def question_view(row: Question) -> QuestionView:
    """Return a question as the team that asked sees it."""
    return QuestionView(
        id=row.id,
        phase=row.phase_id,
        text=row.text,
        asked_at=row.asked_at,
        answer=row.answer,
        answered_at=row.answered_at,
        is_public=row.news_id is not None,
    )


def asked_question(row: Question, team: str) -> AskedQuestion:
    """Return a question as organizers see it."""
    return AskedQuestion(team=team, **question_view(row).model_dump())
