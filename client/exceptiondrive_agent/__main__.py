"""`python -m exceptiondrive_agent remind | decide`: the two commands alone."""

import typer

from exceptiondrive.cli import Commands
from exceptiondrive_agent.cli import decide, remind

app = typer.Typer(
    cls=Commands, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
)
app.command()(remind)
app.command()(decide)

if __name__ == "__main__":
    app()
