"""`exceptiondrive-build`: a table of commands, each imported when it is called."""

import os
import sys
from pathlib import Path
from pkgutil import resolve_name
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
    "new": ("commands:new", "Make a workshop folder."),
    "scenes": ("scenes.commands:scenes", "Make a set of scenes, or read one in."),
    "run": ("stage_commands:run", "Ask a model: screen, edit or review."),
    "audit": ("report_commands:audits", "Plan the inspection of accepted edits."),
    "localize": ("stage_commands:localize_command", "Propose a region for what is accepted."),
    "review": ("review_page.app:review", "Serve the review page on this machine."),
    "report": (
        "report_commands:report_command",
        "Count everything: funnel, marks, audit, agreement, time and money.",
    ),
    "lint": ("freezing.commands:lint_split", "Warn of what makes the split a bad benchmark."),
    "freeze": ("freezing.commands:freeze_split", "Write the split and its datasheet."),
    "reopen": ("freezing.commands:reopen", "Have misplaced regions verified again."),
    "withdraw": ("freezing.commands:withdraw", "Stop counting samples from a revision on."),
}
"""In the order of the work: the command or group of each, and its text in `--help`."""

WorkshopFolder = Annotated[
    Path, typer.Option("--workshop", "-w", help="The workshop folder; by default the current one.")
]
Json = Annotated[bool, typer.Option("--json", help="Write one JSON document.")]

_EXIT_CODES: dict[type[Exception], int] = {EndpointRefusesError: 4, EndpointGoneError: 5}
"""As of the other commands: 4 not allowed, 5 network, 2 any other error."""


class _Commands(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands and cmd_name in COMMANDS:
            part = typer.Typer(rich_markup_mode=None)
            try:
                found = resolve_name(f"exceptiondrive_build.{COMMANDS[cmd_name][0]}")
            except ModuleNotFoundError as error:
                if error.name and error.name.startswith("exceptiondrive"):
                    raise
                advice = 'Install it: pip install "exceptiondrive-worker[build]"'
                raise BuildError(f"{error.name} is not installed.", advice) from None
            if isinstance(found, typer.Typer):
                part.add_typer(found, name=cmd_name)
            else:
                part.command(cmd_name)(found)
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
    """Carry the help of the whole command."""


def main() -> None:
    """Run the command line."""
    os.umask(0o077)  # a workshop holds regions, perhaps in a folder that others may enter
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
    app()
