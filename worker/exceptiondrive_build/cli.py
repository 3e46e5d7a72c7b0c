"""`exceptiondrive-build`: a table of commands, each in a module that is imported when called."""

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from exceptiondrive_build.errors import BuildError
from exceptiondrive_endpoints.errors import (
    EndpointError,
    EndpointGoneError,
    EndpointRefusesError,
)
from exceptiondrive_schemas.printable import printable

COMMANDS = {
    "new": ("exceptiondrive_build.commands", "Make a workshop folder."),
    "scenes": ("exceptiondrive_build.scenes.commands", "Make a set of scenes, or read one in."),
    "run": ("exceptiondrive_build.stage_commands", "Ask a model: screen, edit or review."),
    "audit": ("exceptiondrive_build.report_commands", "Plan the inspection of accepted edits."),
    "localize": ("exceptiondrive_build.stage_commands", "Propose a region for what is accepted."),
    "review": ("exceptiondrive_build.review_page.app", "Serve the review page on this machine."),
    "report": (
        "exceptiondrive_build.report_commands",
        "Count everything: funnel, marks, audit, agreement, time and money.",
    ),
    "lint": (
        "exceptiondrive_build.freezing.commands",
        "Warn of what makes the split a bad benchmark.",
    ),
    "freeze": ("exceptiondrive_build.freezing.commands", "Write the split and its datasheet."),
    "reopen": (
        "exceptiondrive_build.freezing.commands",
        "Have regions that lie wrong verified again.",
    ),
    "withdraw": (
        "exceptiondrive_build.freezing.commands",
        "Count samples no more from a revision on.",
    ),
}
"""In the order of the work: where each lives and what `--help` says. Its module has `register(app)`."""

WorkshopFolder = Annotated[
    Path, typer.Option("--workshop", "-w", help="The workshop folder; by default this one.")
]
Json = Annotated[bool, typer.Option("--json", help="Write one JSON document.")]

_EXIT_CODES: dict[type[Exception], int] = {EndpointRefusesError: 4, EndpointGoneError: 5}
"""As of the other commands: 4 not allowed, 5 network, 2 everything else that is wrong."""


class _Commands(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands and cmd_name in COMMANDS:
            part = typer.Typer(rich_markup_mode=None)
            try:
                import_module(COMMANDS[cmd_name][0]).register(part)
            except ModuleNotFoundError as error:
                if error.name and error.name.startswith("exceptiondrive"):
                    raise
                advice = 'Install it: pip install "exceptiondrive-worker[build]"'
                raise BuildError(f"{error.name} is not installed.", advice) from None
            self.commands.update(get_group(part).commands)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in COMMANDS.items()])

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except (BuildError, EndpointError) as error:
            _tell(error.sentence, error.advice)
            ctx.exit(_EXIT_CODES.get(type(error), 2))
        except OSError as error:
            if error.filename is None:
                raise
            _tell(f"{error.filename}: {error.strerror}.")
            ctx.exit(2)


def _tell(sentence: str, advice: str = "") -> None:
    typer.echo(printable(f"exceptiondrive-build: {sentence}"), err=True)
    if advice:
        typer.echo(printable(advice), err=True)


app = typer.Typer(
    name="exceptiondrive-build",
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(help="From driving scenes to a frozen split, in a workshop folder.")
def _root() -> None:
    """Carry the help of the whole."""


def main() -> None:
    """Run the command line."""
    os.umask(0o077)  # a workshop holds regions, also one in a folder that others may enter
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
    app()
