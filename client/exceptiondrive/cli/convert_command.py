"""The command that converts a planner's own files to a submission file."""

from os.path import isfile
from pathlib import Path
from typing import Annotated, cast, get_args

from exceptiondrive.checking import write_file
from exceptiondrive.cli import options
from exceptiondrive.cli.file_tables import report_view
from exceptiondrive.cli.options import argument, flag, one_of, option, require_one_of
from exceptiondrive.cli.output import replacing, say, show_result
from exceptiondrive.conversion import (
    Conversion,
    ConversionPlan,
    FollowedPoint,
    RawPair,
    submission_text,
)
from exceptiondrive.conversion import convert as convert_pairs
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError
from exceptiondrive.inputs import given_manifest, given_protocol, require_unread
from exceptiondrive.pair_files import OnForm, read_pairs
from exceptiondrive.planner_runs import FORMS, planner_form, read_runs
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.check.transformations import UNITS_M
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument

MAX_OFFSET_M = 20.0
ROTATIONS_DEG = (90, -90, 180)
FOLLOWED = get_args(FollowedPoint)


def convert(
    files: Annotated[
        list[Path] | None,
        argument("FILE", "JSON, JSON lines, CSV, Parquet or NPZ; - is stdin; shards become one."),
    ] = None,
    output: Annotated[Path, options.output("Submission file to write (.json[.gz]).", "OUT")] = Path(
        "planning.json.gz"
    ),
    split: Annotated[
        str | None, option("--split", "NAME", "Name of the split, if no file says it.")
    ] = None,
    manifest: Annotated[
        Path | None, option("--manifest", "M", "Check the result with it: a manifest file.")
    ] = None,
    planner: Annotated[
        str | None,
        one_of("--from", FORMS, f"With two runs: their format; {', '.join(FORMS)}.", "PLANNER"),
    ] = None,
    source_run: Annotated[
        list[Path] | None, option("--source-run", "FILE", "A run on the source inputs.")
    ] = None,
    edited_run: Annotated[
        list[Path] | None, option("--edited-run", "FILE", "A run on the edited inputs.")
    ] = None,
    mode: Annotated[
        int | None, option("--mode", "N", "Which of several modes, from 0.", min=0)
    ] = None,
    camera: Annotated[bool, flag("--camera", "Columns are x right, y down, z ahead.")] = False,
    swap: Annotated[bool, flag("--swap", "Exchange x and y.")] = False,
    unit: Annotated[
        str | None,
        one_of("--unit", UNITS_M, f"What the numbers are: {', '.join(UNITS_M)}.", "UNIT"),
    ] = None,
    rotate: Annotated[
        int | None,
        one_of("--rotate", ROTATIONS_DEG, "Turn counter-clockwise; -90 for x right / y forward."),
    ] = None,
    mirror: Annotated[bool, flag("--mirror", "y points to the right.")] = False,
    reverse: Annotated[
        bool, flag("--reverse", "The last waypoint comes first in the file.")
    ] = False,
    cumulative: Annotated[bool, flag("--cumulative", "Add up increments to positions.")] = False,
    exchange: Annotated[
        bool, flag("--exchange", "Source and edited are the wrong way round.")
    ] = False,
    origin_offset_m: Annotated[
        float,
        option(
            "--origin-offset-m",
            "M",
            "How far the given origin is ahead of the rear axle (nuScenes lidar: 0.943713 "
            "Singapore, 0.985793 Boston).",
        ),
    ] = 0.0,
    follows: Annotated[
        str,
        one_of(
            "--follows",
            FOLLOWED,
            "The waypoints are the path of that origin, or of the rear axle.",
        ),
    ] = "sensor",
    time_step_s: Annotated[
        float | None, option("--time-step-s", "S", "Time between two given waypoints.")
    ] = None,
    truncate: Annotated[
        bool,
        flag(
            "--truncate",
            "Cut longer horizons; only if --time-step-s or --from gives the time step.",
        ),
    ] = False,
    null_invalid: Annotated[
        bool, flag("--null-invalid", "Replace invalid trajectories with null, and list them.")
    ] = False,
    protocol: options.ProtocolOption = None,
    json: options.Json = False,
) -> None:
    """Make a submission from a planner's own files.

    The steps run in the order of the options. A point at t = 0 and a heading column are dropped
    automatically; nothing is ever padded. Every step taken is printed. The result is checked, and
    nothing invalid is written.
    """
    rules = given_protocol(protocol)
    require_one_of("--rotate", rotate, ROTATIONS_DEG)
    require_one_of("--follows", follows, FOLLOWED)
    require_one_of("--unit", unit, UNITS_M)
    if not abs(origin_offset_m) <= MAX_OFFSET_M:
        raise InvalidArgumentError(
            "wrong_option", f"--origin-offset-m must be within {MAX_OFFSET_M:g} m."
        )
    if time_step_s is not None and not 0 < time_step_s <= rules.geometry.horizon_s:
        raise InvalidArgumentError(
            "wrong_option", f"--time-step-s must be within {rules.geometry.horizon_s:g} s."
        )
    form = planner_form(planner or "trajectories") if source_run or edited_run else None
    forms: dict[str, None] = {}
    if planner is not None and form is None:
        raise InvalidArgumentError(
            "wrong_option",
            "--from says whose form two runs have, and none were named.",
            "Name them by --source-run and --edited-run; files with pairs go without --from.",
        )
    if bool(files) == (form is not None):
        raise InvalidArgumentError(
            "wrong_option",
            "Name files with pairs, or two runs by --source-run and --edited-run; not both.",
        )
    runs = (*(source_run or ()), *(edited_run or ()))
    require_unread(output, *(files or ()), *runs, manifest, protocol)
    split_of_files = None
    if form is not None:
        pairs = read_runs(form, source_run or [], edited_run or [], mode, forms.setdefault)
    else:
        pairs, split_of_files = _read_files(files or [], mode, forms.setdefault, rules)
    if not pairs:
        raise InvalidArgumentError(
            "unreadable_file",
            "No prediction was found in what was given.",
            f"Runs in the form of {planner or 'trajectories'} look as docs/client.md says."
            if form
            else "Name a file that has trajectories by sample id.",
        )
    known = None if manifest is None else given_manifest(manifest)
    split = split or split_of_files or (known.name if known else None)
    if split is None:
        raise InvalidArgumentError(
            "wrong_split", "No file says which split it is for.", "Add --split NAME."
        )
    outcome = convert_pairs(
        pairs,
        ConversionPlan(
            geometry=rules.geometry,
            camera=camera,
            swap=swap,
            unit=unit,
            rotate_deg=(form.rotate_deg if form else 0) if rotate is None else rotate,
            mirror=mirror,
            reverse=reverse,
            cumulative=cumulative,
            exchange=exchange,
            origin_offset_m=origin_offset_m,
            follows=cast(FollowedPoint, follows),
            time_step_s=time_step_s or (form.time_step_s if form else None),
            truncate=truncate,
            null_invalid=null_invalid,
        ),
    )
    done = (*(f"read {form_read}" for form_read in forms), *outcome.done)
    if split_of_files not in (None, split):
        done = (f"split {split_of_files} -> {split}", *done)
    text = submission_text(split, outcome.pairs)
    report = check(text.encode(), protocol=rules, manifest=known, challenge=PLANNING.id).report
    if not report.is_valid:
        for sentence in done:
            say(f"- {sentence}")
        raise InvalidFileError(
            report,
            f"The result is not valid; {output} was not written.",
            "Correct what is listed where the planner writes, or by an option of this command.",
        )
    with replacing(output):
        size_bytes = write_file(output, text)
    facts = {"output": str(output), "split": split, "n_predictions": len(outcome.pairs)}
    if mode is not None and not any(each.startswith(f"mode {mode} of ") for each in forms):
        done = (f"no trajectory has several modes: --mode {mode} chose nothing", *done)
    facts |= {"size_bytes": size_bytes, "done": list(done), "nulled": list(outcome.nulled)}
    show_result(facts, json, *_report_lines(done, outcome), report_view(report, str(output)))


def _read_files(
    files: list[Path], mode: int | None, on_form: OnForm, rules: ProtocolDocument
) -> tuple[tuple[RawPair, ...], str | None]:
    """Read files with pairs; of one that is nearly a submission, say all that is wrong at once."""
    try:
        return read_pairs(files, mode, on_form)
    except InvalidArgumentError as error:
        if error.code != "unreadable_file" or len(files) > 1 or not isfile(files[0]):
            raise
        report = check(files[0].read_bytes(), protocol=rules, challenge=PLANNING.id).report
        if not report.n_predictions or report.is_valid:
            raise
        raise InvalidFileError(
            report,
            f"{error.sentence} All that a check finds in the file is listed.",
            error.advice or "Correct what is listed where the planner writes.",
        ) from None


def _report_lines(done: tuple[str, ...], outcome: Conversion) -> list[str]:
    lines = [f"- {sentence}" for sentence in done or ("no waypoint was moved",)]
    return [
        *lines,
        *(f"  null: {where}" for where in outcome.nulled),
        counted(len(outcome.pairs), "prediction"),
    ]
