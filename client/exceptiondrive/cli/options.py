"""Options that several commands share."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.cli import completion
from exceptiondrive.cli.output import remember_json
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.inputs import STDIN, GivenFile, given_bytes

Json = Annotated[
    bool,
    typer.Option("--json", callback=remember_json, help="One JSON document on stdout."),
]
Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
Server = Annotated[
    str | None,
    typer.Option(
        "--server",
        metavar="URL",
        help="Address of the server; else EXCEPTIONDRIVE_SERVER, `config`, what login kept.",
    ),
]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE", help="Else named by what it is.")
]
ONE_FILE = {"allow_extra_args": True}
"""Settings of a command that says itself that it takes one file: see `given`."""


def given(file: Path, context: typer.Context | None = None) -> GivenFile:
    """Return what a file holds that was named, or stdin where it is `-`.

    Raises:
        InvalidArgumentError: It cannot be read, or is not the only one.
    """
    if context is not None and context.args:
        names = shlex.join([str(file), *context.args])
        raise InvalidArgumentError(
            "too_many_files",
            f"One file is one submission, and {len(context.args) + 1} were named.",
            f"Shards of one run become one: exceptiondrive convert {names} -o planning.json.gz",
        )
    if file == STDIN:
        return GivenFile("stdin", sys.stdin.buffer.read())
    return given_bytes(file)


File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Submission file, JSON or gzip of JSON; - is stdin.")
]
ProtocolOption = Annotated[
    str | None,
    typer.Option(
        "--protocol", metavar="P", help="Version that ships with the client, or a TOML file."
    ),
]
Phase = Annotated[
    str | None,
    typer.Option(
        "--phase", metavar="PHASE", autocompletion=completion.phases, help="Only of this phase."
    ),
]
DefaultPhase = Annotated[
    str | None,
    typer.Option(
        "--phase",
        metavar="PHASE",
        autocompletion=completion.phases,
        help="Id of the phase; else EXCEPTIONDRIVE_PHASE, else that of `config`.",
    ),
]
PhaseArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[PHASE]",
        autocompletion=completion.phases,
        help="Id of the phase; else EXCEPTIONDRIVE_PHASE, else that of `config`.",
    ),
]
SubmissionId = Annotated[
    str,
    typer.Argument(
        metavar="ID",
        autocompletion=completion.submission_ids,
        help="Id of the submission, or the address of its page.",
    ),
]
TeamId = Annotated[
    str, typer.Argument(metavar="TEAM", autocompletion=completion.teams, help="Id of the team.")
]
PhaseId = Annotated[
    str,
    typer.Option(
        "--phase", metavar="PHASE", autocompletion=completion.phases, help="Id of the phase."
    ),
]
Reason = Annotated[
    str, typer.Option("--reason", metavar="TEXT", help="Why; stays in the audit log.")
]
FactsFile = Annotated[
    Path | None, typer.Option("--facts", metavar="FILE", help="JSON file of the method's facts.")
]
Fact = Annotated[
    list[str] | None,
    typer.Option(
        "--fact", metavar="KEY=VALUE", help="One fact, as often as needed: sensors=lidar,radar."
    ),
]
