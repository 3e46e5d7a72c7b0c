"""`exceptiondrive-worker`: run workers, and handle the splits that only workers may see."""

import gzip
import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import structlog
import typer
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.errors import RecordsError, StoreError
from exceptiondrive_records.db.settings import SettingsError, load_settings
from exceptiondrive_records.operations.logs import set_up_logs
from exceptiondrive_records.operations.setup import DATA_HELP, opened
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.check.drives import drives_fault
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import printable
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    read_protocol,
)
from exceptiondrive_worker.heartbeat import youngest_heartbeat_age_s
from exceptiondrive_worker.sample.files import write_planners, write_sample_split
from exceptiondrive_worker.sample.scenes import SPLIT_NAME
from exceptiondrive_worker.scorer_version import OlderScorerError, refuse_if_older
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.admin import (
    RegisteredSplit,
    SplitsRefusedError,
    add_split_file,
    current_split,
    publish_split_file,
    read_drives,
    register_all_splits,
    with_drives,
)
from exceptiondrive_worker.splits.faults import SplitRefusedError, split_faults
from exceptiondrive_worker.splits.floors import FloorsUnreadableError
from exceptiondrive_worker.splits.pictures import (
    PicturesRefusedError,
    publish_pictures,
    remove_pictures,
)
from exceptiondrive_worker.splits.store import (
    SplitStore,
    SplitUnavailableError,
    SplitUnreadableError,
    close_to_others,
    load_split,
    read_split,
)
from exceptiondrive_worker.splits.warnings import check_report, split_warnings, warning_lines

app = typer.Typer(
    help="Run workers, and handle the splits that only workers may see.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_log = structlog.get_logger("exceptiondrive.worker")
DataOption = Annotated[Path | None, typer.Option("--data", help=DATA_HELP)]
WordsOption = Annotated[
    str,
    typer.Option(
        "--words", help="What readers are told of a later revision, in phases of one part too."
    ),
]
ProtocolOption = Annotated[
    Path | None, typer.Option("--protocol", help=f"Protocol document; by default {NEWEST}.")
]
_KNOWN_ERRORS = (
    SettingsError,
    RecordsError,
    ProtocolError,
    SplitUnreadableError,
    SplitRefusedError,
    SplitUnavailableError,
    SplitsRefusedError,
    FloorsUnreadableError,
    OlderScorerError,
    PicturesRefusedError,
    OSError,
)


@app.command()
def run(
    lanes: Annotated[
        str, typer.Option(help="Lanes to serve, separated by commas.")
    ] = "live,rescore",
    concurrency: Annotated[int, typer.Option(min=1, help="Processes that score.")] = 2,
    data: DataOption = None,
) -> None:
    """Score submissions and build boards until stopped."""
    from exceptiondrive_worker.process import run_worker  # Celery: no other command needs it

    settings = load_settings(WorkerSettings, data)
    with (
        opened(settings) as database,  # its connections must not be inherited by scoring processes
        # an unavailable database refuses nobody: no job begins without it
        suppress(SQLAlchemyError),
        database.read() as session,
    ):
        refuse_if_older(session)
    close_to_others(settings.splits_dir)
    if not SplitStore(settings.splits_dir).files():
        _log.warning(
            "there is no split here, as NAME/split.json.gz, that this user may read: submissions wait "
            "until there is one; EXCEPTIONDRIVE_SPLITS_DIR names the folder",
            folder=str(settings.splits_dir.absolute()),
        )
    run_worker(settings, _lanes(lanes), concurrency)


@app.command("heartbeat-age")
def heartbeat_age(
    max_s: Annotated[float, typer.Option(help="Exit with code 1 if it is older.")] = 60.0,
    data: DataOption = None,
) -> None:
    """Say how old the last sign of life of a worker on this machine is: for health checks."""
    with opened(load_settings(WorkerSettings, data)) as database:
        age_s = youngest_heartbeat_age_s(database)
    typer.echo("no sign of life" if age_s is None else f"{age_s:.1f} s")
    if age_s is None or age_s > max_s:
        raise typer.Exit(1)


@app.command("check-split")
def check_split(
    file: Path,
    protocol: ProtocolOption = None,
    json_: Annotated[bool, typer.Option("--json", help="As JSON, every sample named.")] = False,
) -> None:
    """Say whether a split file can be scored, and what makes it a doubtful benchmark."""
    rules, split = _protocol(protocol), read_split(file)
    faults = split_faults(split, rules)
    if faults and not json_:
        raise SplitRefusedError(split.name, faults)
    warnings = () if faults else split_warnings(split, rules)
    if json_:
        typer.echo(json.dumps(check_report(split, faults, warnings)))
        raise typer.Exit(2 if faults else 0)
    typer.echo(f"{split.name}: {len(split.samples)} samples, {split.revision}")
    for line in warning_lines(warnings, with_samples=True):
        typer.echo(printable(line))


@app.command("register-splits")
def register_splits(
    protocol: ProtocolOption = None,
    words: WordsOption = "",
    data: DataOption = None,
) -> None:
    """Record every split file: names, revisions, sample ids, family sizes, warnings by count, datasheet.

    No region leaves the worker.
    """
    settings = load_settings(WorkerSettings, data)
    splits = SplitStore(settings.splits_dir)
    with opened(settings) as database:
        try:
            found = register_all_splits(database, splits, _protocol(protocol), words)
        except SplitsRefusedError as refused:
            _tell_registered(refused.registered)
            raise
    _tell_registered(found)


@app.command("add-split")
def add_split(
    file: Path,
    protocol: ProtocolOption = None,
    words: WordsOption = "",
    json_: Annotated[bool, typer.Option("--json", help="As JSON, no sample named.")] = False,
    data: DataOption = None,
) -> None:
    """Put a split file, with the datasheet beside it, where workers find it, and register it."""
    settings = load_settings(WorkerSettings, data)
    splits = SplitStore(settings.splits_dir)
    with opened(settings) as database:
        registered = add_split_file(database, splits, file, _protocol(protocol), words)
    if json_:
        typer.echo(json.dumps(_registered_facts(registered)))
        return
    _tell_registered([registered])
    given = read_split(file).revision
    if given == registered.manifest.revision:
        typer.echo(f"  it is at {registered.path}")
    else:
        typer.echo(
            f"  {file} is an earlier revision, {given}: it is already held, and the later one above stays"
        )
        typer.echo(
            "  current. A datasheet beside it replaces the one held, and is shown after "
            "register-splits."
        )
        typer.echo("  A phase, or a run, names the revision: --split-revision")


@app.command("add-drives")
def add_drives(
    split_file: Annotated[Path, typer.Argument(metavar="SPLIT")],
    drives_file: Annotated[
        Path, typer.Argument(metavar="DRIVES", help="Trajectory file whose sources were driven.")
    ],
    new_file: Annotated[Path, typer.Argument(metavar="NEW", help="The split to write.")],
    public: Annotated[
        bool,
        typer.Option("--public", help="Publish the drives: participants' own checks use them."),
    ] = False,
) -> None:
    """Write a split with the recorded drives of its scenes: they reveal a planner that is off course."""
    split = with_drives(read_split(split_file), read_drives(drives_file), are_public=public)
    protocol = _protocol(None)
    load_split(split, protocol)
    fault = drives_fault([it.recorded for it in split.samples if it.recorded], protocol)
    if fault is not None:
        raise SplitUnreadableError(f"{drives_file.name} holds no recorded drives: {fault}")
    if new_file.exists():
        raise FileExistsError(f"{new_file} already exists")
    text = split.model_dump_json(by_alias=True, exclude_none=True)
    new_file.write_bytes(gzip.compress(text.encode(), mtime=0))
    n_known = sum(sample.recorded is not None for sample in split.samples)
    typer.echo(f"{new_file}: {n_known} of {len(split.samples)} samples have a recorded drive")
    typer.echo(f"{split.name} would have the revision {split.revision}")


def _registered_facts(registered: RegisteredSplit) -> dict[str, object]:
    manifest = registered.manifest
    return {
        "name": manifest.name,
        "title": manifest.title,
        "revision": manifest.revision,
        "n_samples": len(manifest.sample_ids),
        "warnings": [found.told.model_dump() for found in registered.warnings],
    }


def _tell_registered(found: list[RegisteredSplit]) -> None:
    for registered in found:
        manifest = registered.manifest
        typer.echo(f"{manifest.name}: {len(manifest.sample_ids)} samples, {manifest.revision}")
        for line in warning_lines(registered.warnings, with_samples=False):
            typer.echo(f"  {line}")


@app.command("publish-split")
def publish_split(
    name: str,
    protocol: ProtocolOption = None,
    while_open: Annotated[
        bool,
        typer.Option(
            "--while-open",
            help="Publish it even while a phase that has scores accepts submissions.",
        ),
    ] = False,
    data: DataOption = None,
) -> None:
    """Make a development split public for ever: regions, tasks, scenes, controls, recorded paths.

    Of a split with parts the private part goes public, too. This cannot be taken back. What a phase on
    it scores is no test any more.
    """
    settings = load_settings(WorkerSettings, data)
    files, splits = FileStore(settings.file_store_url), SplitStore(settings.splits_dir)
    with opened(settings) as database:
        registered = publish_split_file(
            database, files, splits, name, _protocol(protocol), while_open=while_open
        )
    with_parts = ", its private part, too" if registered.has_parts else ""
    typer.echo(f"{name} is public now, at {registered.manifest.revision}{with_parts}")


@app.command("publish-pictures")
def publish_pictures_of(
    name: str,
    licence: Annotated[str, typer.Option(help="Licence under which they may be shown, in words.")],
    data: DataOption = None,
) -> None:
    """Show the pictures beside a public split on its pages, replacing those shown before."""
    settings = load_settings(WorkerSettings, data)
    split, folder = current_split(SplitStore(settings.splits_dir), name)
    files = FileStore(settings.file_store_url)
    with opened(settings) as database:
        n_shown = publish_pictures(database, files, split, folder, licence)
    typer.echo(f"{name}: {n_shown} pictures are shown, under: {printable(licence)}")


@app.command("remove-pictures")
def remove_pictures_of(name: str, data: DataOption = None) -> None:
    """Stop showing pictures of a public split, and remove their files."""
    settings = load_settings(WorkerSettings, data)
    split, _ = current_split(SplitStore(settings.splits_dir), name)
    with opened(settings) as database:
        remove_pictures(database, FileStore(settings.file_store_url), split)
    typer.echo(f"{name}: pictures are no longer shown")


@app.command("make-sample")
def make_sample() -> None:
    """Write the synthetic sample split from its fixed seed."""
    typer.echo(str(write_sample_split(load_settings(WorkerSettings).splits_dir)))


@app.command("make-planners")
def make_planners(folder: Path) -> None:
    """Write the submission files of the synthetic planners, and planners.json."""
    for path in write_planners(folder):
        typer.echo(str(path))


@app.command("seed-sample")
def seed_sample(data: DataOption = None) -> None:
    """Publish the sample split, so that anyone may evaluate at home; it is made if there is none.

    All splits that lie beside it are registered.
    """
    settings = load_settings(WorkerSettings, data)
    with opened(settings):
        if SplitStore(settings.splits_dir).missing([SPLIT_NAME]):
            write_sample_split(settings.splits_dir)
    register_splits(data=data)
    publish_split(SPLIT_NAME, data=data)


def main() -> None:
    """Run the command line; known errors become one clear message on stderr and exit code 2."""
    set_up_logs(sys.stderr)
    try:
        app()
    except _KNOWN_ERRORS as error:
        why = f" ({error.reason})" if isinstance(error, StoreError) and error.__cause__ else ""
        typer.echo(f"exceptiondrive-worker: {error}{why}", err=True)
        sys.exit(2)


def _lanes(text: str) -> list[Lane]:
    known = [lane.value for lane in Lane]
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise typer.BadParameter(f"unknown lane {unknown[0]!r}; lanes are {', '.join(known)}")
    return [Lane(name) for name in dict.fromkeys(names)]


def _protocol(path: Path | None) -> ProtocolDocument:
    return packaged_protocol(NEWEST) if path is None else read_protocol(path)
