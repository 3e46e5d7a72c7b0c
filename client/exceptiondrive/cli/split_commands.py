"""Commands that fetch what a planner needs: manifest, split download."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exceptiondrive.checking import write_file
from exceptiondrive.cli import completion, options
from exceptiondrive.cli.options import argument
from exceptiondrive.cli.output import Answer, replacing
from exceptiondrive.cli.progress import transfer_bar
from exceptiondrive.cli.session import with_client
from exceptiondrive.settings import default_phase
from exceptiondrive_schemas.split import Manifest, Split

if TYPE_CHECKING:
    from exceptiondrive.client import Client

Output = Annotated[Path | None, options.output("Where to write it.")]


@with_client
def manifest(
    client: "Client", phase: options.PhaseArgument = None, output: Output = None
) -> Answer:
    """Fetch the sample ids of a phase.

    The recorder and `check --manifest` read the file.
    """
    phase = default_phase(phase)
    found = client.manifest(phase)
    path = output or Path(f"{phase}.manifest.json")
    with replacing(path):
        write_file(path, found.model_dump_json(by_alias=True, indent=1))
    return _written_answer(path, found, len(found.sample_ids))


@with_client
def download(
    client: "Client",
    name: Annotated[
        str, argument("NAME", "Name of a development split.", offer=completion.public_splits)
    ],
    revision: Annotated[
        str | None,
        typer.Option(metavar="DIGEST", help="Which revision; by default the one in force."),
    ] = None,
    output: Output = None,
) -> Answer:
    """Fetch a development split for `evaluate`.

    The file contains its hazard regions, which are public only for a development split.
    """
    with transfer_bar("downloading", name) as bar:
        found = client.split(name, revision=revision, on_progress=bar)
    path = output or Path(f"{found.name}.split.json")
    with replacing(path):
        write_file(path, found.model_dump_json(by_alias=True, exclude_none=True))
    return _written_answer(path, found, len(found.samples))


def _written_answer(path: Path, found: Manifest | Split, n_samples: int) -> Answer:
    facts = {
        "output": str(path),
        "split": found.name,
        "revision": found.revision,
        "n_samples": n_samples,
    }
    return facts, f"{n_samples} samples of split {found.name} in {path}"


split = {"download": download}
