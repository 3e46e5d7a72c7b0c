"""The command line: a table of commands, each in a module that is imported when it is called."""

import os
import sys
from collections.abc import Mapping
from importlib import import_module
from inspect import signature
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup
from typer.main import get_group

from exceptiondrive.errors import ExceptionDriveError, InvalidArgumentError
from exceptiondrive.version import __version__

HELP = """Check, score and submit trajectory files of the ExceptionDrive benchmark.

Exit codes: 0 done, 2 invalid file or arguments, 3 quota used up, 4 not allowed, 5 network,
6 scoring failed, 7 timed out.
"""
COMMANDS = {
    "check": (".local_commands", "Check a file, list every fault, and say what it looks like."),
    "evaluate": (".local_commands", "Score a file on this machine."),
    "plot": (".local_commands", "Draw samples: trajectories, footprints, tube, region, clearance."),
    "convert": (".convert_command", "Make a submission from a planner's own files."),
    "config": (".config_command", "Show or set the usual server and phase."),
    "login": (".account_commands", "Store a team token for a server."),
    "logout": (".account_commands", "Forget the token of a server."),
    "whoami": (".account_commands", "Show whose token is in use."),
    "manifest": (".split_commands", "Fetch the sample ids of a phase."),
    "submit": (".submission_commands", "Check a file, say what an upload will do, then upload it."),
    "status": (".submission_commands", "Show one submission."),
    "submissions": (
        ".submission_commands",
        "List the team's submissions, newest first; those of all teams with an organizer's token.",
    ),
    "quota": (
        ".submission_commands",
        "Show what the team may still submit, and when the count resets.",
    ),
    "terms": (".board_commands", "Show the terms of a phase, and accept them for the team."),
    "edit": (
        ".submission_commands",
        "Change name, links, description or facts of a submission; without options, list its changes.",
    ),
    "download": (".submission_commands", "Download the team's own upload, exactly as it was sent."),
    "withdraw": (
        ".submission_commands",
        "Take a submission off the board; on a terminal it asks first.",
    ),
    "choose": (
        ".submission_commands",
        "Choose which run counts, in a phase that lets teams choose.",
    ),
    "publish": (
        ".submission_commands",
        "Put an entry on the board of a phase that keeps entries private.",
    ),
    "notices": (".notice_commands", "Show the team's notices, newest first."),
    "contacts": (
        ".notice_commands",
        "Addresses that get the team's notices: e-mail, once confirmed, and webhooks.",
    ),
    "news": (".news_commands", "Show the news of a phase, newest first."),
    "ask": (
        ".news_commands",
        "Ask the organizers about a phase; the answer appears in the team's notices.",
    ),
    "questions": (".news_commands", "Show what the team asked about a phase, and the answers."),
    "leaderboard": (".board_commands", "Show a ranked board."),
    "phases": (".board_commands", "List the phases."),
    "report": (
        ".board_commands",
        "Show how a phase ended: the first places, and what a reveal changed.",
    ),
    "remind": (
        "exceptiondrive_agent.cli",
        "Write a risk reminder per sample: images and the public taxonomy in, a record out.",
    ),
    "decide": (
        "exceptiondrive_agent.cli",
        "Choose a strategy per sample, with or without reminders, and write a strategy submission.",
    ),
    "tokens": (".account_commands", "Your team's tokens; needs a token with the scope `tokens`."),
    "data": (".data_command", "Show and download what the phase's data link offers."),
    "split": (".split_commands", "Development splits, whose regions are public."),
    "receipt": (".receipt_commands", "Signed receipts of scored submissions."),
    "organizer": (".organizer.commands", "For organizers, with an organizer's token."),
}
"""Where each command lives, under its name, and what `--help` says of it, which a test holds to it."""

_UsageError: Any = typer.BadParameter.__base__
"""What is wrong with options and arguments; typer exports its children alone, of click or its own."""

BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""numpy would start a thread for each core, and no command multiplies matrices."""
NO_PLUGINS = "PYDANTIC_DISABLE_PLUGINS"
"""Else pydantic looks through the metadata of every installed package for plugins of its own."""


class Group(TyperGroup):
    """A group that cuts no summary short, however narrow the terminal."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write what each command does, in as many lines as that takes."""
        rows = [(name, self.summary_of(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def summary_of(self, ctx: Any, name: str) -> str:
        """Return the first paragraph of a command's help."""
        command: Any = self.get_command(ctx, name)
        return " ".join((command.help or "").partition("\n\n")[0].split())


def _group(words: str, commands: Mapping[str, Any]) -> typer.Typer:
    """Return a group of commands, and of further groups: each a tuple of words and commands."""
    made = typer.Typer(cls=Group, help=words, no_args_is_help=True, rich_markup_mode=None)
    for name, each in commands.items():
        if isinstance(each, tuple):
            made.add_typer(_group(*each), name=name)
        else:
            made.command(name)(each)
    return made


class _Commands(Group):
    """The commands of the table; `--help` imports none of them. Their errors become words and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; the one place where errors end."""
        try:
            return super().invoke(ctx)
        except ExceptionDriveError as error:
            from exceptiondrive.cli.output import report_error

            report_error(error, ctx)
            ctx.exit(error.exit_code)
        except _UsageError as error:
            _say_how_a_phase_is_named(error)
            raise
        except typer.Abort:  # Ctrl-C at a question ends as it does anywhere else
            raise KeyboardInterrupt from None

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in the order of the docs."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command or a group of them, and make it alone of those in its module.

        A command that takes the context says itself what is wrong with further arguments.
        """
        if cmd_name not in self.commands and cmd_name in COMMANDS:
            module, words = COMMANDS[cmd_name]
            found = getattr(import_module(module, __name__), cmd_name)
            part = typer.Typer(rich_markup_mode=None)
            if isinstance(found, Mapping):
                part.add_typer(_group(words, found), name=cmd_name)
            else:
                settings = {"allow_extra_args": "context" in signature(found).parameters}
                part.command(context_settings=settings)(found)
            self.commands.update(get_group(part).commands)
        return self.commands.get(cmd_name)

    def summary_of(self, ctx: Any, name: str) -> str:
        """Return what the table says of a command."""
        return COMMANDS[name][1]


def _say_how_a_phase_is_named(error: Any) -> None:
    """Add to a refusal how its command takes a phase: as an option, or as its argument."""
    asked = error.ctx.command.params if error.ctx else ()
    if "extra argument" in error.message and any("--phase" in each.opts for each in asked):
        error.message += "; a phase is named by --phase PHASE"
    elif getattr(error, "option_name", "") == "--phase" and any(
        each.name.startswith("phase") for each in asked
    ):
        error.message += "; this command takes the phase without it"
        error.possibilities = None


app = typer.Typer(
    name="exceptiondrive",
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(value: bool) -> None:
    if value:
        typer.echo(f"exceptiondrive {__version__}")
        raise typer.Exit


@app.callback(help=HELP)
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_say_version, help="Say the version and exit."
        ),
    ] = False,
) -> None:
    """Carry the help of the whole."""


def main() -> None:
    """Run the command line."""
    if sys.stdout is None:  # a shell's `>&-`
        typer.echo("error: The output cannot be written: stdout is closed.", err=True)
        sys.exit(InvalidArgumentError.exit_code)
    os.environ.setdefault(NO_PLUGINS, "__all__")
    os.environ.setdefault(BLAS_THREADS, "1")
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
    try:
        app()
    except OSError as error:
        if error.filename is not None:
            raise
        _say_unwritable(error)


def _say_unwritable(error: OSError) -> NoReturn:
    """Say that a stream or a file takes no more, as on a full disk, and end."""
    try:
        sys.stdout.flush()
    except OSError:  # else it would be tried again at the exit, and told by a traceback
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
    typer.echo(f"error: The output cannot be written: {error.strerror}.", err=True)
    sys.exit(InvalidArgumentError.exit_code)
