"""The command that serves the page."""

import socket
from pathlib import Path
from typing import Annotated

import typer
import uvicorn

from exceptiondrive_build.cli import WorkshopFolder
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.review_page.app import review_app
from exceptiondrive_build.workshop import Workshop


def register(app: typer.Typer) -> None:
    """Add the command to a command line."""
    app.command()(review)


def review(
    workshop: WorkshopFolder = Path(),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any free one.")] = 8400,
    lease_s: Annotated[
        float, typer.Option(min=1, help="How long a card waits for a browser that died.")
    ] = 60.0,
) -> None:
    """Serve the review page on this machine; each browser opens it by an address that works once."""
    Workshop(workshop).records.close()
    try:
        listening = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        advice = "Give another --port, or 0 for any free one."
        raise BuildError(f"Port {port}: {error.strerror}.", advice) from None
    at = listening.getsockname()[1]

    def announce(key: str) -> None:
        typer.echo(f"for the next browser: http://127.0.0.1:{at}/open/{key}")

    with listening:
        app = review_app(workshop, announce, lease_s=lease_s)
        uvicorn.Server(uvicorn.Config(app, log_level="warning")).run(sockets=[listening])
