"""Questions from teams, answered privately, or publicly without the team's name."""

import re

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_text, random_id
from exceptiondrive_records.news.news import publish_news
from exceptiondrive_records.news.tables import Question
from exceptiondrive_records.participation.messages import (
    MAX_TEXT,
    MAX_TITLE,
    recipients,
    send_message,
)
from exceptiondrive_records.phases.phases import find_phase, shown_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.teams.tables import Team

MAX_QUESTION = 1000
MAX_OPEN = 5
"""Maximum number of a team's unanswered questions; for a team that waits for approval it is one."""
_TITLE = "A question, answered"
_MARKS = re.compile(r"[\\`*_\[\]<>&~|]|^[-+#=:]")
_NUMBER = re.compile(r"^(\d+)([.)])")
"""With `_MARKS`: the characters of a question that Markdown would interpret."""


def ask_question(
    session: Session, team_id: int, phase_id: str, text: str, *, actor: str
) -> Question:
    """Ask the organizers.

    Raises:
        NotFound: No such phase, or it is hidden.
        InvalidRecord: The text cannot be used.
        Conflict: Too many of the team's questions wait, or it asked this already; or it was
            forgotten, or merged into another one.
    """
    phase = shown_phase(session, phase_id)
    text = checked_text("question", text, max_length=MAX_QUESTION, may_have_lines=True)
    team = hold_team(session, team_id)
    team.require_there()
    own = select(Question).where(Question.team_id == team_id, Question.answered_at.is_(None))
    waiting = session.scalars(own).all()
    if any(one.text == text and one.phase_id == phase.id for one in waiting):
        raise Conflict("Your team has asked this already; the answer comes into its notices.")
    most = MAX_OPEN if team.pending_since is None else 1
    if len(waiting) >= most:
        wait = (
            "A question of your team waits" if most == 1 else f"{most} questions of your team wait"
        )
        raise Conflict(f"{wait} for an answer: ask later.")
    row = Question(
        id=random_id(),
        phase_id=phase.id,
        team_id=team_id,
        text=text,
        asked_at=database_now(session),
    )
    session.add(row)
    session.flush()
    audit(session, actor, "question asked", row.id, {"phase": phase.id})
    return row


def answer_question(
    session: Session,
    question_id: str,
    text: str,
    *,
    plain: str,
    to_all: bool,
    actor: str,
    to_its_teams: bool = False,
) -> Question:
    """Answer a question once: to the team alone, or to everybody without naming the team.

    The text is Markdown. Inboxes show plain text: `plain`, or the text as written. With `to_all`
    question and answer become news; with `to_its_teams` only teams that submitted to the phase, and
    the team that asked, are notified of these.

    Raises:
        NotFound: There is none with this id.
        InvalidRecord: The text cannot be used.
        Conflict: It is answered already.
    """
    row = find_question(session, question_id, lock=True)
    if row.answered_at is not None:
        raise Conflict("The question is answered already.")
    lines = row.text.splitlines()
    quoted = "\n".join(f"> {_as_words(line)}" for line in lines)
    marked = "\n\n".join(f"> {line.strip()}" for line in lines if line.strip())
    limit = MAX_TEXT - max(len(quoted), len(marked)) - MAX_TITLE
    row.answer = checked_text("answer", text, max_length=limit, may_have_lines=True)
    row.answered_at = database_now(session)
    inbox = f"{marked}\n\nThe organizers answer:\n\n{plain or row.answer}"
    slug = session.get_one(Team, row.team_id).slug
    is_told = False
    if to_all:
        told = f"{quoted}\n\n{row.answer}"
        news = publish_news(
            session, row.phase_id, _TITLE, told, actor=actor, plain=inbox, to_its_teams=to_its_teams
        )
        row.news_id = news.id
        only_of = row.phase_id if to_its_teams else None
        is_told = slug in {one.team for one in recipients(session, phase=only_of)}
    if not is_told:
        phase = session.get_one(Phase, row.phase_id)
        title, here = f"{phase.title}: {_TITLE}", f"/my/questions/{phase.id}"
        send_message(session, title, inbox, actor=actor, teams=[slug], address=here)
    detail = {"phase": row.phase_id, "to_all": to_all}
    audit(session, actor, "question answered", row.id, detail)
    return row


def _as_words(line: str) -> str:
    """Escape Markdown, so that no link, heading or definition in a question alters the answer."""
    return _NUMBER.sub(r"\1\\\2", _MARKS.sub(r"\\\g<0>", line.strip()))


def find_question(session: Session, question_id: str, *, lock: bool = False) -> Question:
    """Return a question, answered or not.

    Raises:
        NotFound: There is none with this id.
    """
    return find_row(session, Question, "question", question_id, lock=lock)


def questions_of(session: Session, team_id: int, phase_id: str) -> list[Question]:
    """Return a team's questions about a phase, newest first."""
    mine = Question.team_id == team_id, Question.phase_id == phase_id
    return list(session.scalars(select(Question).where(*mine).order_by(Question.asked_at.desc())))


def list_questions(session: Session, phase_id: str | None = None) -> list[tuple[Question, str]]:
    """Return the questions of one phase or of all, each with the id of its team.

    Unanswered ones come first, the oldest first; then answered ones, the latest answer first.

    Raises:
        NotFound: There is no such phase.
    """
    query = select(Question, Team.slug).join(Team, Team.id == Question.team_id)
    if phase_id is not None:
        query = query.where(Question.phase_id == find_phase(session, phase_id).id)
    is_answered = Question.answered_at.is_not(None)
    order = (is_answered, Question.answered_at.desc(), Question.asked_at, Question.id)
    return [(row, slug) for row, slug in session.execute(query.order_by(*order))]


def count_waiting(session: Session, phase_id: str | None = None) -> int:
    """Return how many questions wait for an answer, about one phase or all."""
    query = select(func.count()).select_from(Question).where(Question.answered_at.is_(None))
    if phase_id is not None:
        query = query.where(Question.phase_id == phase_id)
    return session.scalar(query) or 0
