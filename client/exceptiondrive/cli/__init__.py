"""The command line. Modules that take long to import are imported inside the commands."""

import sys
from typing import Any

import typer
from typer.core import TyperGroup

from exceptiondrive.agent import cli as agent_commands
from exceptiondrive.cli import (
    account_commands,
    board_commands,
    local_commands,
    organizer_commands,
    receipt_commands,
    split_commands,
    submission_commands,
    token_commands,
)
from exceptiondrive.errors import ExceptionDriveError

HELP = """Check, score and submit trajectory files of the ExceptionDrive benchmark.

Exit codes: 0 done, 2 invalid file or arguments, 3 quota used up, 4 not allowed, 5 network,
6 scoring failed, 7 timed out.
"""


class _Commands(TyperGroup):
    """All commands in the order of the docs; their errors become words and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; the one place where errors end."""
        from exceptiondrive.cli.output import report_error

        try:
            return super().invoke(ctx)
        except ExceptionDriveError as error:
            report_error(error, ctx)
            ctx.exit(error.exit_code)


app = typer.Typer(
    name="exceptiondrive",
    help=HELP,
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for commands in (
    local_commands,
    account_commands,
    token_commands,
    split_commands,
    submission_commands,
    receipt_commands,
    board_commands,
    agent_commands,
    organizer_commands,
):
    commands.register(app)


def main() -> None:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")
    app()
