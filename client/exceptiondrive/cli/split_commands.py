"""Commands that fetch what a planner needs: manifest, split download."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.checking import write_file
from exceptiondrive.cli import completion, group, options
from exceptiondrive.cli.options import argument
from exceptiondrive.cli.output import show_result
from exceptiondrive.cli.progress import TransferBar
from exceptiondrive.cli.session import open_client
from exceptiondrive.settings import default_phase

Output = Annotated[Path | None, options.output("Where to write it.")]


def manifest(
    phase: options.PhaseArgument = None,
    output: Output = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Fetch the sample ids of a phase.

    The recorder and `check --manifest` read the file.
    """
    with open_client(server) as client:
        found = client.manifest(default_phase(phase))
    path = output or Path(f"{found.name}.manifest.json")
    write_file(path, found.model_dump_json(by_alias=True, indent=1))
    facts: dict[str, str | int] = {
        "output": str(path),
        "split": found.name,
        "revision": found.revision,
        "n_samples": len(found.sample_ids),
    }
    _say_written(facts, json)


def download(
    name: Annotated[
        str, argument("NAME", "Name of a development split.", offer=completion.public_splits)
    ],
    revision: Annotated[
        str | None,
        typer.Option(metavar="DIGEST", help="Which revision; by default the one in force."),
    ] = None,
    output: Output = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Fetch a development split for `evaluate`.

    With its hazard regions, which only a development split gives away.
    """
    with open_client(server) as client, TransferBar("downloading", name) as bar:
        found = client.split(name, revision=revision, on_progress=bar)
    path = output or Path(f"{found.name}.split.json")
    write_file(path, found.model_dump_json(by_alias=True, exclude_none=True))
    facts: dict[str, str | int] = {
        "output": str(path),
        "split": found.name,
        "revision": found.revision,
        "n_samples": len(found.samples),
    }
    _say_written(facts, json)


def _say_written(facts: dict[str, str | int], json: bool) -> None:
    words = f"{facts['n_samples']} samples of split {facts['split']} in {facts['output']}"
    show_result(facts, json, words)


def register(app: typer.Typer) -> None:
    """Add these commands."""
    app.command()(manifest)
    splits = group("Development splits, whose regions are public.", {"download": download})
    app.add_typer(splits, name="split")
