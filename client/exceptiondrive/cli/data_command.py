"""The command that shows and downloads what a phase's data link offers."""

from pathlib import Path
from typing import Annotated

from exceptiondrive.cli import options
from exceptiondrive.cli.options import flag
from exceptiondrive.cli.output import be_sure, say, show_result
from exceptiondrive.cli.progress import transfer_bar
from exceptiondrive.cli.session import open_client
from exceptiondrive.data import download_file, read_data_manifest
from exceptiondrive.errors import NotFoundError
from exceptiondrive.settings import default_phase
from exceptiondrive_schemas.printable import counted


def data(
    phase: options.PhaseArgument = None,
    output: Annotated[Path, options.output("Where the files are written.", "FOLDER")] = Path(
        "data"
    ),
    list_only: Annotated[bool, flag("--list", "Show licence and files; download nothing.")] = False,
    accept_licence: Annotated[bool, flag("--accept-licence", "Download without asking.")] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show and download what the phase's data link offers.

    The licence is shown first. On a terminal the command asks whether you accept it; elsewhere
    --accept-licence says yes. An interrupted download is resumed, and every file is checked against
    the digest in the organizer's list.
    """
    with open_client(server) as client:
        view = client.phase(default_phase(phase))
    page = view.page
    if not page.data_manifest_url:
        if not page.data_url:
            raise NotFoundError("no_data", f"Phase {view.id} names no data.", "Ask its organizers.")
        words = (
            f"licence: {page.data_licence or 'see there'}",
            f"data of {view.id}: {page.data_url}",
        )
        show_result(page, json, *words)
        return
    manifest = read_data_manifest(page.data_manifest_url)
    said = (
        f"licence: {manifest.licence} {manifest.licence_url}".rstrip(),
        *((f"page: {page.data_url}",) if page.data_url else ()),
        *(f"{file.bytes:>15,} bytes  {file.name}" for file in manifest.files),
        f"{manifest.total_bytes:>15,} bytes in {counted(len(manifest.files), 'file')}",
    )
    if list_only:
        show_result(manifest, json, *said)
        return
    for line in said:
        say(line)
    be_sure(
        f"The data stand under the licence {manifest.licence}.",
        accept_licence,
        "--accept-licence",
        question="Accept it, and download?",
        nothing="Nothing was downloaded.",
    )
    paths = []
    for file in manifest.files:
        with transfer_bar("downloading", file.name) as bar:
            paths.append(str(download_file(file, output, bar)))
    done = {"licence": manifest.licence, "files": paths}
    show_result(done, json, f"{counted(len(paths), 'file')} in {output}, as the list says")
