"""News of a phase, and questions: asked by teams, answered by organizers."""

from collections.abc import Callable
from typing import Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.options import argument, flag, option
from exceptiondrive.cli.output import show_result
from exceptiondrive.cli.session import open_client, open_organizer
from exceptiondrive.cli.tables import records_table
from exceptiondrive.settings import default_phase

Text = Annotated[str, option("--text", "TEXT", "Markdown.")]


def ask(
    text: Annotated[str, argument("TEXT", "The question.")],
    phase: options.DefaultPhase = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Ask the organizers about a phase; the answer comes into the team's notices."""
    with open_client(server) as client:
        asked = client.ask(text, default_phase(phase))
    show_result(asked, json, "asked; `exceptiondrive questions` shows the answer")


def questions(
    phase: options.DefaultPhase = None, server: options.Server = None, json: options.Json = False
) -> None:
    """Show what the team asked about a phase, and the answers."""
    with open_client(server) as client:
        found = client.questions(default_phase(phase))
    table = records_table(found, ("text", "answer", "answered_at"))
    show_result(found, json, table if found else "no questions")


def news(
    phase: options.DefaultPhase = None, server: options.Server = None, json: options.Json = False
) -> None:
    """Show the news of a phase, newest first."""
    with open_client(server) as client:
        found = client.news(default_phase(phase))
    table = records_table(found, ("published_at", "title", "text"))
    show_result(found, json, table if found else "no news")


def list_news(
    phase: options.Phase = None, server: options.Server = None, json: options.Json = False
) -> None:
    """List the news of all phases or of one, newest first."""
    with open_organizer(server) as organizer:
        found = organizer.news(phase)
    columns = ("id", "phase", "title", "published_at", "withdrawn_at")
    show_result(found, json, records_table(found, columns))


def publish_news(
    phase: options.PhaseId,
    title: Annotated[str, option("--title", "TEXT", "One line.")],
    text: Text,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Announce something of a phase: on its page, in its feed, in the inbox of every team."""
    with open_organizer(server) as organizer:
        published = organizer.publish_news(phase, title, text)
    show_result(published, json, f"news {published['id']} published")


def withdraw_news(
    news_id: Annotated[str, argument("ID", "Id of the news.")],
    reason: options.Reason,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Take news from page and feed; what teams were told stays told."""
    with open_organizer(server) as organizer:
        gone = organizer.withdraw_news(news_id, reason)
    show_result(gone, json, f"news {gone['id']} withdrawn")


def list_questions(
    phase: options.Phase = None, server: options.Server = None, json: options.Json = False
) -> None:
    """List the questions of all teams, those that wait first."""
    with open_organizer(server) as organizer:
        found = organizer.questions(phase)
    columns = ("id", "team", "phase", "text", "asked_at", "answered_at")
    show_result(found, json, records_table(found, columns))


def answer_question(
    question_id: Annotated[str, argument("ID", "Id of the question.")],
    text: Annotated[str, option("--text", "TEXT", "The answer.")],
    to_all: Annotated[
        bool, flag("--to-all", "Question and answer become news, without the team's name.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Answer a question, once: to the team alone, or to all."""
    with open_organizer(server) as organizer:
        answered = organizer.answer_question(question_id, text, to_all=to_all)
    show_result(answered, json, "answered to " + ("all" if to_all else "the team"))


NEWS: dict[str, Callable[..., None]] = {
    "list": list_news,
    "publish": publish_news,
    "withdraw": withdraw_news,
}
QUESTIONS: dict[str, Callable[..., None]] = {"list": list_questions, "answer": answer_question}


def register(app: typer.Typer) -> None:
    """Add the commands of teams."""
    for command in (news, ask, questions):
        app.command()(command)
