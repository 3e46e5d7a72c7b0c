"""`python -m exceptiondrive.agent remind | decide`: the two commands alone."""

import typer

from exceptiondrive.agent.cli import register
from exceptiondrive.cli import app as main_app

app = typer.Typer(cls=main_app.info.cls, no_args_is_help=True, pretty_exceptions_enable=False)
register(app)

if __name__ == "__main__":
    app()
