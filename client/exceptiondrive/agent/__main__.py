"""`python -m exceptiondrive.agent remind | decide`."""

import typer

from exceptiondrive.agent.cli import register

app = typer.Typer(no_args_is_help=True, add_completion=False)
register(app)
app()
