"""Commands that work without a server: check, evaluate, plot.

What only one of them uses is imported when it is called.
"""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.checking import check_file, csv_text, parquet_bytes, write_file
from exceptiondrive.cli import options
from exceptiondrive.cli.file_tables import file_view, report_view, sheet_view
from exceptiondrive.cli.options import flag, option
from exceptiondrive.cli.output import replacing, say, show_result
from exceptiondrive.cli.progress import step_line
from exceptiondrive.cli.session import open_client
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError
from exceptiondrive.evaluation import SampleResult, sample_results, score, sound_file
from exceptiondrive.inputs import GivenFile, ProtocolLike, given_split
from exceptiondrive.outlook import Outlook
from exceptiondrive.settings import find_setting
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.coverage import unranked_reasons
from exceptiondrive_schemas.printable import counted

TABLES = (".csv", ".csv.gz", ".parquet")
"""Endings of the files that results of samples are written to."""


def check(
    context: typer.Context,
    file: options.File,
    split: Annotated[
        Path | None, option("--split", "SPLIT_FILE", "Check its samples: a split file.")
    ] = None,
    manifest: Annotated[
        Path | None, option("--manifest", "M", "Check its samples: a manifest file.")
    ] = None,
    phase: options.DefaultPhase = None,
    method: Annotated[
        str | None, option("--method", "NAME", "With a phase: say which entry it replaces.")
    ] = None,
    protocol: options.ProtocolOption = None,
    name_all: Annotated[bool, flag("--all", "List every sample that has a fault.")] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Check a file, list every fault, and say what it looks like.

    The checker is the server's own. Sample ids are checked against --split, --manifest or the
    phase; the last two also say which challenge the file must be for. Without any of them only the
    form is checked. With a phase, the command also says what an upload would do: whether it would
    rank, and with --method which of the team's entries it would replace.
    """
    given = options.given_file(file, context)
    if split is None and manifest is None:
        phase = find_setting("phase", phase).value
    outlook = _check_outlook(given, split, manifest, phase, method, protocol, server)
    report = outlook.report
    words = tuple(report_view(report, given.name, with_all=name_all))
    if report.is_valid and phase is not None and protocol is None:
        from exceptiondrive.cli.tables import outlook_view

        words = (*words, *outlook_view(outlook, phase))
        report = report.model_copy(update={"to_confirm": tuple(outlook.to_confirm.values())})
    show_result(report, json, *words)
    has_samples = split is not None or manifest is not None or phase is not None
    is_fit_unknown = report.profile is not None and report.profile.source_l2_m is None
    if has_samples and report.is_valid and is_fit_unknown:
        say(
            "The sources could not be compared with recorded drives: whether they fit the scenes, and "
            "so the frame, the time step and the order of the rows, could only be checked in part."
        )
    if report.is_valid and not json and not has_samples:
        say("Only the form was checked; add --phase, --manifest or --split for the sample ids.")
    if not report.is_valid:
        raise typer.Exit(InvalidFileError.exit_code)


def _check_outlook(
    file: GivenFile,
    split: Path | None,
    manifest: Path | None,
    phase: str | None,
    method: str | None,
    protocol: str | None,
    server: str | None,
) -> Outlook:
    """Check a file against at most one of split, manifest and phase."""
    if sum(choice is not None for choice in (split, manifest, phase)) > 1:
        raise InvalidArgumentError(
            "too_many_choices", "Give only one of --split, --manifest and --phase."
        )
    if phase is not None:
        with open_client(server) as client:
            if protocol is None:
                return client.outlook(file, phase=phase, method=method)
            report = check_file(file, manifest=client.manifest(phase), protocol=protocol)
    else:
        known = given_split(split) if split is not None else manifest
        report = check_file(file, manifest=known, protocol=protocol)
    return Outlook(report, None)


def evaluate(
    context: typer.Context,
    file: options.File,
    split: Annotated[Path, option("--split", "SPLIT", "Split file with its regions.")],
    per_sample: Annotated[
        Path | None,
        option(
            "--per-sample",
            "FILE",
            "Write the result of every sample, unsafe ones first, in turn of each family the "
            "worst; its name ends in .csv, .csv.gz or .parquet.",
        ),
    ] = None,
    phase: options.DefaultPhase = None,
    protocol: options.ProtocolOption = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Score a file on this machine.

    The score is computed exactly as by the worker, under the protocol of the phase, else --protocol,
    else the usual one. Below the table it says whether the file would be ranked. The table is rounded
    as the board is; --json prints the exact score sheet. Needs the extra `evaluate` (numpy) and a
    split with regions: see `split download`.
    """
    if per_sample is not None and not per_sample.name.endswith(TABLES):
        raise InvalidArgumentError(
            "wrong_option",
            f"{per_sample} has no known ending: results of samples are written as "
            f"{', '.join(TABLES[:-1])} or {TABLES[-1]}.",
        )
    given = options.given_file(file, context)
    rules: ProtocolLike | None = protocol
    challenge: ChallengeId | None = None
    if protocol is None and (named := find_setting("phase", phase).value) is not None:
        with open_client(server) as client:
            view = client.phase(named)
            rules, challenge = client.protocol_of(view), view.challenge
    with step_line(is_shown=not json) as tell:
        tell(f"reading {given.name}")
        sound = sound_file(given, split, rules, challenge)
        revision = None if json else ""  # words do not say it
        sheet = score(sound.document, sound.split, sound.protocol, tell, revision)
    if per_sample is not None:
        rows = sample_results(sound.document, sound.split, sound.protocol)
        form = parquet_bytes if per_sample.suffix == ".parquet" else csv_text
        with replacing(per_sample):
            write_file(per_sample, form(SampleResult._fields, rows))
        say(f"{counted(len(rows), 'sample')} in {per_sample}")
    because = "; ".join(unranked_reasons(sheet, sound.protocol))
    report = sound.report.model_copy(update={"unranked_because": because or None})
    words = sheet_view(sheet, sound.protocol, n_predictions=report.n_predictions)
    ranked = () if because else (f"it would be ranked under protocol {sound.protocol.version}",)
    show_result(sheet, json, words, file_view(report), *ranked)


def plot(
    context: typer.Context,
    file: options.File,
    split: Annotated[Path, option("--split", "SPLIT", "Split file with its regions.")],
    samples: Annotated[
        list[str] | None, option("--sample", "ID", "A sample to draw; may be repeated.")
    ] = None,
    worst: Annotated[
        int,
        option("--worst", "N", "Draw N samples: the worst of each family, in turn.", min=1, max=60),
    ] = 6,
    output: Annotated[Path, options.output("Picture to write: .svg or .png.", "OUT")] = Path(
        "samples.svg"
    ),
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Draw samples: trajectories, footprints, tube, region, clearance.

    One sample fills the picture; several make a contact sheet. Shapes and numbers come from the
    scoring code itself. An .svg adapts to light and dark mode. Needs the extra `evaluate`, for a
    .png also `plot`, and a split with regions: see `split download`.
    """
    from exceptiondrive.plot import plot_file

    with replacing(output):
        drawn = plot_file(
            options.given_file(file, context),
            output,
            split=split,
            sample_ids=samples,
            worst=worst,
            protocol=protocol,
        )
    facts = {"output": str(output), "sample_ids": list(drawn)}
    show_result(facts, json, f"{counted(len(drawn), 'sample')} in {output}")
