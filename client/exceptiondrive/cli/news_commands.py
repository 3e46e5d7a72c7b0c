"""News of a phase, and questions: asked by teams, answered by organizers."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

from exceptiondrive.cli import options
from exceptiondrive.cli.options import argument, flag, option
from exceptiondrive.cli.output import Answer
from exceptiondrive.cli.session import with_client, with_organizer
from exceptiondrive.cli.tables import listed, records_table
from exceptiondrive.settings import default_phase

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive.organizer import Organizer


@with_client
def ask(
    client: "Client",
    text: Annotated[str, argument("TEXT", "The question.")],
    phase: options.DefaultPhase = None,
) -> Answer:
    """Ask the organizers about a phase; the answer appears in the team's notices."""
    phase = default_phase(phase)
    asked = client.ask(text, phase)
    return asked, f"asked; `exceptiondrive questions --phase {phase}` shows the answer"


@with_client
def questions(client: "Client", phase: options.DefaultPhase = None) -> Answer:
    """Show what the team asked about a phase, and the answers."""
    found = client.questions(default_phase(phase))
    shown = [{**one, "answer": one["answer"] or "not answered yet"} for one in found]
    table = records_table(shown, ("text", "answer", "answered_at"))
    return found, table if found else "no questions"


@with_client
def news(client: "Client", phase: options.DefaultPhase = None) -> Answer:
    """Show the news of a phase, newest first."""
    found = client.news(default_phase(phase))
    table = records_table(found, ("published_at", "title", "text"))
    return found, table if found else "no news"


@with_organizer
def list_news(organizer: "Organizer", phase: options.Phase = None) -> Answer:
    """List the news of all phases or of one, newest first."""
    return listed(organizer.news(phase), ("id", "phase", "title", "published_at", "withdrawn_at"))


@with_organizer
def publish_news(
    organizer: "Organizer",
    phase: options.PhaseId,
    title: Annotated[str, option("--title", "TEXT", "One line.")],
    text: Annotated[str, options.text("--text", "Markdown.")],
) -> Answer:
    """Publish news of a phase: on its page, in its feed, and to the inbox of every team."""
    published = organizer.publish_news(phase, title, text)
    return published, f"news {published['id']} published"


@with_organizer
def withdraw_news(
    organizer: "Organizer",
    news_id: Annotated[str, argument("ID", "Id of the news.")],
    reason: options.Reason,
) -> Answer:
    """Remove news from page and feed; the messages that teams got stay."""
    gone = organizer.withdraw_news(news_id, reason)
    return gone, f"news {gone['id']} withdrawn"


@with_organizer
def list_questions(organizer: "Organizer", phase: options.Phase = None) -> Answer:
    """List the questions of all teams, waiting ones first."""
    columns = ("id", "team", "phase", "text", "asked_at", "answered_at")
    return listed(organizer.questions(phase), columns)


@with_organizer
def answer_question(
    organizer: "Organizer",
    question_id: Annotated[str, argument("ID", "Id of the question.")],
    text: Annotated[str, options.text("--text", "The answer.")],
    to_all: Annotated[
        bool, flag("--to-all", "Question and answer become news, without the team's name.")
    ] = False,
) -> Answer:
    """Answer a question, once: to the team only, or to all."""
    answered = organizer.answer_question(question_id, text, to_all=to_all)
    return answered, "answered to " + ("all" if to_all else "the team")


NEWS: dict[str, Callable[..., None]] = {
    "list": list_news,
    "publish": publish_news,
    "withdraw": withdraw_news,
}
QUESTIONS: dict[str, Callable[..., None]] = {"list": list_questions, "answer": answer_question}
