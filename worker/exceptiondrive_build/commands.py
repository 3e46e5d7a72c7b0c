"""Commands about the workshop itself."""

import secrets
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_build.workshop import new_workshop


def new(
    folder: Path,
    name: Annotated[str, typer.Option(help="Name of the split that is to be made.")],
    id_key: Annotated[
        str | None, typer.Option(help="Key of the sample ids; by default a random one.")
    ] = None,
) -> None:
    """Make a workshop folder: settings to be filled in, prompts, and the words of all tasks."""
    new_workshop(folder, name, secrets.token_hex(32) if id_key is None else id_key)
    typer.echo(f"{folder}: fill in workshop.toml, then `exceptiondrive-build scenes read SOURCE`")
