"""Commands that work without a server: check, evaluate, convert, version."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show, show_document, show_json


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
    phase: Annotated[
        str | None,
        typer.Option("--phase", metavar="P", help="Check its samples: ask the server."),
    ] = None,
    protocol: options.ProtocolOption = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Check a file and list every fault.

    The checker is the server's own. Without --split, --manifest or --phase only the form is checked, not the sample ids.
    """
    from exceptiondrive.cli.check_run import checked_report
    from exceptiondrive.cli.report_table import report_view
    from exceptiondrive.errors import InvalidFileError

    report = checked_report(file, split, manifest, phase, protocol, server)
    if json:
        show_document(report)
    else:
        show(*report_view(report, file.name))
        if report.is_valid and split is None and manifest is None and phase is None:
            say("Only the form was checked; add --phase, --manifest or --split for the sample ids.")
    if not report.is_valid:
        raise typer.Exit(InvalidFileError.exit_code)


def evaluate(
    file: options.File,
    split: Annotated[
        Path, typer.Option("--split", metavar="SPLIT", help="Split file with its regions.")
    ],
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Score a file on this machine.

    It is done exactly as the worker does it. The table is rounded as the board is; --json prints the exact score sheet. Needs the extra
    `evaluate` (numpy) and a split with regions: see `split download`.
    """
    from exceptiondrive.cli.protocol_choice import chosen_protocol
    from exceptiondrive.cli.sheet_table import sheet_view
    from exceptiondrive.evaluation import evaluate_file

    rules = chosen_protocol(protocol)
    sheet = evaluate_file(file, split=split, protocol=rules)
    if json:
        show_document(sheet)
    else:
        show(*sheet_view(sheet, rules))


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

    One sample fills the picture; several make a contact sheet. Shapes and numbers come from the scoring code itself. An .svg follows
    light and dark. Needs the extra `plot` and a split with regions: see `split download`.
    """
    from exceptiondrive.cli.protocol_choice import chosen_protocol
    from exceptiondrive.plot.files import plot_file

    rules = chosen_protocol(protocol)
    drawn = plot_file(file, output, split=split, sample_ids=samples, worst=worst, protocol=rules)
    if json:
        show_json({"output": str(output), "sample_ids": list(drawn)})
    else:
        show(f"{len(drawn)} sample{'' if len(drawn) == 1 else 's'} in {output}")


def convert(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="JSON, JSON lines or CSV; shards become one."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Submission file to write (.json[.gz])."
        ),
    ],
    split: Annotated[
        str | None,
        typer.Option("--split", metavar="NAME", help="Name of the split, if no file says it."),
    ] = None,
    swap_axes: Annotated[
        bool,
        typer.Option("--swap-axes", help="From x right / y forward to x forward / y left."),
    ] = False,
    origin_offset_m: Annotated[
        float,
        typer.Option(
            "--origin-offset-m",
            metavar="M",
            help="The given origin lies so far ahead of the rear axle (nuScenes lidar: 0.943713 "
            "Singapore, 0.985793 Boston).",
        ),
    ] = 0.0,
    follows: Annotated[
        str,
        typer.Option(
            "--follows",
            metavar="sensor|rear-axle",
            help="Whose path the waypoints are: of that origin, or of the rear axle.",
        ),
    ] = "sensor",
    truncate: Annotated[
        bool, typer.Option("--truncate", help="Cut longer horizons to what the protocol takes.")
    ] = False,
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Make a submission of a planner's own files.

    Brings trajectories into the form and frame of a submission file, in this order: axes, origin,
    t = 0, horizon.
    A point at t = 0 and a heading column are left out by themselves; nothing is ever padded.
    Every step that was taken is printed.
    """
    from exceptiondrive.cli.convert_run import converted

    outcome = converted(
        files, output, split, swap_axes, origin_offset_m, follows, truncate, protocol
    )
    if json:
        show_json(outcome)
        return
    for sentence in outcome["done"] or ["nothing had to be changed"]:
        show(f"- {sentence}")
    show(f"{outcome['n_predictions']} predictions in {outcome['output']}")


def version() -> None:
    """Print the versions of client and protocol."""
    from importlib.metadata import version

    from exceptiondrive_schemas.protocol import packaged_protocol

    protocol = packaged_protocol()
    show(f"exceptiondrive {version('exceptiondrive')}")
    show(f"protocol {protocol.version} {protocol.digest}")


def register(app: typer.Typer) -> None:
    """Add these commands."""
    app.command()(check)
    app.command()(evaluate)
    app.command()(plot)
    app.command()(convert)
    app.command()(version)
