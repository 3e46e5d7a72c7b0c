"""The final commands: lint, freeze, reopen, withdraw."""

import json as json_module
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.cli import Json, WorkshopFolder
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.freezing.freeze import (
    auxiliary,
    changed_alone,
    freeze,
    gzipped,
    not_inspected,
    parted_otherwise,
    pictures,
    undecided,
)
from exceptiondrive_build.records import Author, Kind, Record, person_named
from exceptiondrive_build.values import MAX_REASON_LENGTH, Withdrawn
from exceptiondrive_build.workshop import GIT_IGNORE, IGNORE_ALL, SETTINGS, Workshop
from exceptiondrive_schemas.datasheet import Datasheet
from exceptiondrive_schemas.printable import printable
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    read_protocol,
)
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.jury import Verdict, files_of_jury, jury
from exceptiondrive_worker.splits.faults import SplitRefusedError, split_faults
from exceptiondrive_worker.splits.store import (
    SplitUnreadableError,
    load_split,
    parts_of,
    read_datasheet,
    read_split,
)
from exceptiondrive_worker.splits.warnings import check_report, split_warnings, warning_lines


def lint_split(
    workshop: WorkshopFolder = Path(),
    file: Annotated[
        Path | None,
        typer.Option(
            help="A split file, in place of what the workshop would freeze; it needs no workshop."
        ),
    ] = None,
    protocol: Annotated[
        Path | None,
        typer.Option(
            help="Of --file: a protocol document; by default the workshop's, without one the newest."
        ),
    ] = None,
    jury_folder: Annotated[
        Path | None, typer.Option("--jury", help="Folder with files of known planners.")
    ] = None,
    json: Json = False,
) -> None:
    """Warn of what makes the split a bad benchmark.

    Exit code 2: it cannot be scored, or the jury objects.
    """
    if protocol and not file:
        raise typer.BadParameter(
            "--protocol goes with --file: workshop.toml names the workshop's own"
        )
    if file and (protocol or (workshop == Path() and not (workshop / SETTINGS).exists())):
        rules, split = _rules(protocol), _read(file)
    else:
        with Workshop(workshop) as shop:
            rules = shop.protocol
            split = _read(file) if file else freeze(shop, walk(shop)).split
    faults = split_faults(split, rules)
    if faults and not json:
        raise BuildError(str(SplitRefusedError(split.name, faults)))
    warnings = () if faults else split_warnings(split, rules)
    verdicts: list[Verdict] = []
    if jury_folder is not None and not faults:
        with tempfile.TemporaryDirectory() as folder:
            files = files_of_jury(jury_folder)
            verdicts = [
                replace(verdict, part=part)
                for part in parts_of(split)
                for verdict in jury(load_split(split, rules, part), rules, files, Path(folder))
            ]
    if json:
        report = check_report(split, faults, warnings)
        typer.echo(json_module.dumps(report | {"jury": [asdict(each) for each in verdicts]}))
    else:
        typer.echo(f"{split.name}: {len(split.samples)} samples, {split.revision}")
        for line in [*warning_lines(warnings, with_samples=True), *map(verdict_line, verdicts)]:
            typer.echo(printable(line))
    if faults or any(verdict.objection for verdict in verdicts):
        raise typer.Exit(2)


def verdict_line(verdict: Verdict) -> str:
    """One line of the jury, for a terminal."""
    scores = ""
    if verdict.hcc is not None and verdict.ur is not None:
        scores = f" HCC {100 * verdict.hcc:.2f}, UR {100 * verdict.ur:.2f}"
    flags = f" no moving planner: {', '.join(verdict.flags)}" if verdict.flags else ""
    objection = f" OBJECTION: {verdict.objection}" if verdict.objection else ""
    part = f" in the {verdict.part} part" if verdict.part else ""
    return f"jury {verdict.method}{part}:{scores}{flags}{objection}"


def freeze_split(
    out: Annotated[Path, typer.Argument(help="Folder for the files; it must not exist yet.")],
    workshop: WorkshopFolder = Path(),
    previous: Annotated[
        Path | None, typer.Option(help="Split file of the revision before.")
    ] = None,
    words: Annotated[str, typer.Option(help="What readers are told of a later revision.")] = "",
    auxiliary_set: Annotated[
        bool, typer.Option("--auxiliary", help="Freeze the auxiliary set, too.")
    ] = False,
) -> None:
    """Write the split of all that is accepted and verified, and what is published beside it."""
    with Workshop(workshop) as shop:
        candidates, before = walk(shop), _read(previous) if previous else None
        sheet_before = _sheet_of(before, previous) if before and previous else None
        frozen = freeze(shop, candidates, before, words, sheet_before)
        n_unseen = not_inspected(shop, candidates, frozen.split)
        n_otherwise = parted_otherwise(shop, frozen.split)
        n_undecided = undecided(shop, candidates) if before is None else 0
        alone = (
            [] if before is None else changed_alone(before, frozen.split, shop.protocol.taxonomy)
        )
        files = frozen.files()
        if auxiliary_set:
            rest = auxiliary(shop, candidates, frozen.split)
            files[f"{rest.name}.json.gz"] = gzipped(rest)
        _write(out, chain(files.items(), pictures(shop, candidates, frozen.split)))
    sheet = frozen.datasheet
    typer.echo(
        f"{out}: {sheet.name}, {sheet.n_samples:,} samples, {sheet.n_controls:,} controls, "
        f"{sheet.n_withdrawn:,} withdrawn, {sheet.revision}"
    )
    for found in sheet.warnings:
        typer.echo(printable(f"warning {found.code} ({found.count:,}): {found.what}"))
    if before is not None and before.revision == sheet.revision:
        typer.echo(
            "warning nothing_changed: the split is the previous revision itself; what was accepted since "
            "waits for the next split"
        )
    if before is not None and sheet_before is None:
        typer.echo(
            "warning no_datasheet_before: no datasheet of the previous revision lies beside its file, so "
            "funnel, audit and agreement count what was edited since, too"
        )
    if before is not None and frozen.manifest.recorded and not before.recorded_is_public:
        typer.echo(
            f"warning drives_become_public ({len(frozen.manifest.recorded):,}): the previous revision "
            "withholds the recorded paths, and this one's manifest tells them to everybody"
        )
    if n_otherwise:
        typer.echo(
            f"warning parts_stay ({n_otherwise:,}): samples of another part than `public_part` says; a "
            "revision keeps the part of each sample, another draw is a split of another name"
        )
    if alone:
        typer.echo(
            f"warning changed_alone ({len(alone):,}): one sample alone changes in {', '.join(alone)}; on a "
            "withheld split the boards before and after tell its value of every entry: mend, withdraw or "
            "restore several of a family in one revision"
        )
    if n_unseen:
        typer.echo(
            f"warning not_inspected ({n_unseen:,}): samples with a low mark or of the random draw that no "
            "person has looked at; the audit counts only what was: `exceptiondrive-build review`"
        )
    if n_undecided:
        typer.echo(
            f"warning region_not_decided ({n_undecided:,}): accepted edits whose region waits for a "
            "reader; they are not in the split: `exceptiondrive-build review`"
        )


def reopen(
    sample_ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Sample ids.")],
    by: Annotated[str, typer.Option(help="Who asks for it.")],
    workshop: WorkshopFolder = Path(),
) -> None:
    """Take back what readers said of regions: two people verify each again, from the proposal on."""
    author = Author(person=person_named(by))
    with Workshop(workshop) as shop:
        known = walk(shop)
        wrong = [key for key in sample_ids if key not in known or not known[key].verifications]
        if wrong:
            raise BuildError(
                f"Not a region that was read in the workshop ({len(wrong):,}): {', '.join(wrong[:10])}."
            )
        shop.records.append(
            *(
                Record(
                    kind=Kind.VERIFY,
                    candidate=key,
                    by=author,
                    inputs=word.inputs,
                    value=None,
                    supersedes=word.id,
                )
                for key in dict.fromkeys(sample_ids)
                for word in known[key].verifications
            )
        )
    typer.echo(f"reopened: {len(set(sample_ids)):,}; next: `exceptiondrive-build review`")


def withdraw(
    sample_ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Sample ids.")],
    by: Annotated[str, typer.Option(help="Who decides it.")],
    reason: Annotated[
        str, typer.Option(help="Why, in words for readers; --restore needs none and keeps none.")
    ] = "",
    workshop: WorkshopFolder = Path(),
    restore: Annotated[bool, typer.Option(help="Undo an earlier withdrawal.")] = False,
) -> None:
    """Withdraw samples: in the next revision files still answer them, and no sheet counts them."""
    author, reason = Author(person=person_named(by)), " ".join(reason.split())
    if not restore and not 0 < len(reason) <= MAX_REASON_LENGTH:
        raise BuildError(f"Give a reason of at most {MAX_REASON_LENGTH} characters.")
    with Workshop(workshop) as shop:
        standing, known = shop.current(Kind.WITHDRAW), walk(shop)
        wrong = [key for key in sample_ids if key not in known or (key in standing) != restore]
        if wrong:
            what = "Not withdrawn" if restore else "Not in the workshop, or withdrawn already"
            raise BuildError(f"{what} ({len(wrong):,}): {', '.join(wrong[:10])}.")
        shop.records.append(
            *(
                Record(
                    kind=Kind.WITHDRAW,
                    candidate=key,
                    by=author,
                    inputs=known[key].pictures,
                    value=None if restore else Withdrawn(reason=reason).model_dump(mode="json"),
                    supersedes=standing[key].id if restore else None,
                )
                for key in dict.fromkeys(sample_ids)
            )
        )
    typer.echo(f"{'restored' if restore else 'withdrawn'}: {len(set(sample_ids)):,}")


def _rules(path: Path | None) -> ProtocolDocument:
    try:
        return read_protocol(path) if path else packaged_protocol(NEWEST)
    except ProtocolError as error:
        raise BuildError(f"{path}: {error}") from None


def _read(path: Path) -> Split:
    try:
        return read_split(path)
    except SplitUnreadableError as error:
        raise BuildError(f"{path}: {error}") from None


def _sheet_of(split: Split, path: Path) -> Datasheet | None:
    """Return the datasheet that was frozen with a split, if it is beside its file."""
    try:
        sheet = read_datasheet(path) if path.name.startswith("split") else None
    except SplitUnreadableError as error:
        raise BuildError(str(error)) from None
    return sheet if sheet is not None and sheet.revision == split.revision else None


def _write(folder: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """Write all files or none into a new folder that holds these files alone; git ignores it."""
    if folder.exists():
        raise BuildError(f"{folder} is there already.", "A frozen split is never written over.")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            ".part", f"{folder.name}.", folder.parent, ignore_cleanup_errors=True
        ) as made:
            part = Path(made)
            (part / GIT_IGNORE).write_text(IGNORE_ALL)
            for name, data in files:
                (part / name).parent.mkdir(mode=0o700, exist_ok=True)
                (part / name).write_bytes(data)
                if name.endswith(".gz") or name == "provenance.jsonl":
                    (part / name).chmod(0o600)
            part.rename(folder)
    except OSError as error:
        raise BuildError(f"{folder}: {error.strerror or error}.", "No record is lost.") from None
