"""Commands that work without a server: check, evaluate, plot, version."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.checking import check_file, csv_text, parquet_bytes, write_file
from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show, show_result
from exceptiondrive.cli.progress import StepLine
from exceptiondrive.cli.session import open_client
from exceptiondrive.cli.tables import outlook_view, report_view, sheet_view
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError
from exceptiondrive.evaluation import (
    SampleResult,
    sample_results,
    score,
    sound_file,
)
from exceptiondrive.inputs import GivenFile, given_split
from exceptiondrive.plot import plot_file
from exceptiondrive.settings import find_setting
from exceptiondrive.version import __version__
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import packaged_protocol


def check(
    file: options.File,
    split: Annotated[
        Path | None,
        typer.Option("--split", metavar="SPLIT_FILE", help="Check its samples: a split file."),
    ] = None,
    manifest: Annotated[
        Path | None,
        typer.Option("--manifest", metavar="M", help="Check its samples: a manifest file."),
    ] = None,
    phase: options.DefaultPhase = None,
    protocol: options.ProtocolOption = None,
    name_all: Annotated[
        bool, typer.Option("--all", help="Name every sample that has a fault.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Check a file, list every fault, and say what it looks like.

    The checker is the server's own. Sample ids are checked against --split, --manifest or the
    phase; without any of them only the form is.
    """
    given = options.given(file)
    if split is None and manifest is None:
        phase = find_setting("phase", phase).value
    report = _report(given, split, manifest, phase, protocol, server)
    show_result(report, json, *report_view(report, given.name, with_all=name_all))
    if report.is_valid and not json and split is None and manifest is None and phase is None:
        say("Only the form was checked; add --phase, --manifest or --split for the sample ids.")
    if not report.is_valid:
        raise typer.Exit(InvalidFileError.exit_code)


def _report(
    file: GivenFile,
    split: Path | None,
    manifest: Path | None,
    phase: str | None,
    protocol: str | None,
    server: str | None,
) -> CheckReport:
    """Check a file against at most one of split, manifest and phase."""
    if sum(choice is not None for choice in (split, manifest, phase)) > 1:
        raise InvalidArgumentError(
            "too_many_choices", "Give only one of --split, --manifest and --phase."
        )
    if phase is not None:
        with open_client(server) as client:
            if protocol is None:
                return client.check(file, phase=phase)
            return check_file(file, manifest=client.manifest(phase), protocol=protocol)
    known = given_split(split) if split is not None else manifest
    return check_file(file, manifest=known, protocol=protocol)


def evaluate(
    file: options.File,
    split: Annotated[
        Path, typer.Option("--split", metavar="SPLIT", help="Split file with its regions.")
    ],
    per_sample: Annotated[
        Path | None,
        typer.Option(
            "--per-sample",
            metavar="FILE",
            help="Write the result of every sample, the worst first: .csv or .parquet.",
        ),
    ] = None,
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Score a file on this machine.

    It is done exactly as the worker does it. The table is rounded as the board is; --json prints
    the exact score sheet. Below it stands what the file looks like. Needs the extra `evaluate` (numpy) and a split with regions: see `split
    download`.
    """
    given = options.given(file)
    with StepLine(is_shown=not json) as tell:
        tell(f"reading {given.name}")
        sound = sound_file(given, split, protocol)
        sheet = score(sound.document, sound.split, sound.protocol, tell)
    if per_sample is not None:
        rows = sample_results(sound.document, sound.split, sound.protocol)
        form = parquet_bytes if per_sample.suffix == ".parquet" else csv_text
        write_file(per_sample, form(SampleResult._fields, rows))
        say(f"{counted(len(rows), 'sample')} in {per_sample}")
    show_result(sheet, json, *sheet_view(sheet, sound.protocol), *outlook_view(sound.report))


def plot(
    file: options.File,
    split: Annotated[
        Path, typer.Option("--split", metavar="SPLIT", help="Split file with its regions.")
    ],
    samples: Annotated[
        list[str] | None,
        typer.Option("--sample", metavar="ID", help="A sample to draw; may be repeated."),
    ] = None,
    worst: Annotated[
        int, typer.Option("--worst", metavar="N", min=1, max=60, help="Draw the N worst samples.")
    ] = 6,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT", help="Picture to write: .svg or .png.")
    ] = Path("samples.svg"),
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Draw samples: trajectories, footprints, tube, region, clearance.

    One sample fills the picture; several make a contact sheet. Shapes and numbers come from the
    scoring code itself. An .svg follows light and dark. Needs the extra `plot` and a split with
    regions: see `split download`.
    """
    drawn = plot_file(
        options.given(file),
        output,
        split=split,
        sample_ids=samples,
        worst=worst,
        protocol=protocol,
    )
    facts = {"output": str(output), "sample_ids": list(drawn)}
    show_result(facts, json, f"{counted(len(drawn), 'sample')} in {output}")


def version() -> None:
    """Print the versions of client and protocol."""
    protocol = packaged_protocol()
    show(f"exceptiondrive {__version__}")
    show(f"protocol {protocol.version} {protocol.digest}")


def register(app: typer.Typer) -> None:
    """Add these commands."""
    for command in (check, evaluate, plot, version):
        app.command()(command)
