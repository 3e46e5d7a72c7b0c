"""Protocol documents from the command line: check, compare, add, list."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import show, show_json

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Protocol document, TOML.")]


def check(file: FileArgument, json: options.Json = False) -> None:
    """Check a protocol document on this machine; every problem is listed."""
    from exceptiondrive.cli.protocol_choice import chosen_protocol

    protocol = chosen_protocol(str(file))
    if json:
        show_json({"version": protocol.version, "digest": protocol.digest})
        return
    show(f"protocol {protocol.version} is valid, {protocol.digest}")


def diff(
    file: FileArgument,
    phase: Annotated[
        str | None,
        typer.Option("--phase", metavar="ID", help="Against the protocol this phase shows."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Say in plain words what a document would change, and what would be repeated."""
    from exceptiondrive.checking import read_file
    from exceptiondrive.cli.protocol_choice import chosen_protocol
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.organizer import Organizer

    chosen_protocol(str(file))
    toml = read_file(file).decode("utf-8-sig")
    with Organizer(prepare(server)) as organizer:
        found = organizer.rescoring.check_protocol(toml, phase)
    if json:
        show_json(found)
    else:
        show(*_lines(found))


def _lines(found: dict[str, Any]) -> list[str]:
    changes = [f"- {change['sentence']} ({change['stage']})" for change in found["changes"]]
    remark = [f"note: {found['remark']}"] if found.get("remark") else []
    return [*(changes or ["nothing that scores is changed"]), found["sentence"], *remark]


COMMANDS: dict[str, Callable[..., None]] = {"check": check, "diff": diff}
