"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.cli.output import remember_json

Json = Annotated[
    bool,
    typer.Option("--json", callback=remember_json, help="One JSON document on stdout."),
]
Server = Annotated[
    str | None,
    typer.Option(
        "--server",
        metavar="URL",
        help="Address of the server; else EXCEPTIONDRIVE_SERVER, else what login kept.",
    ),
]
File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Submission file, JSON or gzip of JSON.")
]
ProtocolOption = Annotated[
    str | None,
    typer.Option(
        "--protocol", metavar="P", help="Version that ships with the client, or a TOML file."
    ),
]
Phase = Annotated[str | None, typer.Option("--phase", metavar="PHASE", help="Id of a phase.")]
SubmissionId = Annotated[str, typer.Argument(metavar="ID", help="Id of the submission.")]
FactsFile = Annotated[
    Path | None, typer.Option("--facts", metavar="FILE", help="JSON file of the method's facts.")
]
Fact = Annotated[
    list[str] | None,
    typer.Option(
        "--fact", metavar="KEY=VALUE", help="One fact, as often as needed: sensors=lidar,radar."
    ),
]
