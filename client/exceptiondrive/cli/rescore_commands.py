"""Protocol updates from the command line: draft, score, preview, apply, roll back, verify."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show, show_json
from exceptiondrive.errors import ExceptionDriveError, InvalidArgumentError

if TYPE_CHECKING:
    from exceptiondrive.organizer import Rescoring

RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="Id of the run.")]
ReasonOption = Annotated[
    str, typer.Option("--reason", metavar="TEXT", help="Why; stays in the audit log.")
]
PhaseOption = Annotated[
    str | None, typer.Option("--phase", metavar="ID", help="Only of this phase.")
]
WatchOption = Annotated[
    bool, typer.Option("--watch", help="Follow until scoring has ended; exit code 6 on failures.")
]
_SCORING = ("scoring",)
_LOOK_EVERY_S = 1.0
MAX_SAMPLE = 100_000


def start(
    phase: Annotated[str, typer.Option("--phase", metavar="ID", help="Whose board is to change.")],
    reason: ReasonOption,
    protocol: Annotated[
        str | None, typer.Option("--protocol", metavar="V", help="Version or digest to come.")
    ] = None,
    split_revision: Annotated[
        str | None, typer.Option("--split-revision", metavar="R", help="Revision to come.")
    ] = None,
    draft: Annotated[
        bool, typer.Option("--draft", help="Only draft it; score nothing yet.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Draft a run and begin to score in the background; the board does not change."""
    with _rescoring(server) as rescoring:
        run = rescoring.draft(phase, protocol, split_revision, reason)
        if not draft:
            run = rescoring.step(run["id"], "start", reason)
    _show_run(run, json)


def status(
    run_id: Annotated[str | None, typer.Argument(metavar="[RUN]", help="Else all runs.")] = None,
    phase: PhaseOption = None,
    watch: WatchOption = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show runs, or one run with its progress and what stands in the way."""
    from exceptiondrive.cli.rescore_table import runs_table

    with _rescoring(server) as rescoring:
        if run_id is None:
            runs = rescoring.runs(phase)
            if json:
                show_json(runs)
            else:
                show(runs_table(runs))
            return
        run = _watched(rescoring, run_id) if watch else rescoring.run(run_id)
    _show_run(run, json)
    if watch and run["progress"]["failed"]:
        raise typer.Exit(6)


def preview(
    run_id: RunArgument,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write it as CSV besides.")
    ] = None,
    seen: Annotated[
        str | None, typer.Option("--seen", metavar="DIGEST", help="Of an earlier preview.")
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Compare every entry before and after; exit code 1 if the preview is stale."""
    from exceptiondrive.cli.rescore_table import preview_lines

    with _rescoring(server) as rescoring:
        found = rescoring.preview(run_id, seen)
        if csv is not None:
            csv.write_text(rescoring.preview_csv(run_id), encoding="utf-8")
    if json:
        show_json(found)
    else:
        show(*preview_lines(found))
    if found["is_stale"]:
        raise typer.Exit(ExceptionDriveError.exit_code)


def apply(
    run_id: RunArgument,
    reason: ReasonOption,
    digest: Annotated[
        str | None,
        typer.Option("--preview", metavar="DIGEST", help="Of the preview that you looked at."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show the new board, at once and wholly; refused while anything is missing or stale."""
    with _rescoring(server) as rescoring:
        if digest is None:
            digest = rescoring.preview(run_id)["digest"]
            say(f"applying the present preview, {digest}")
        run = rescoring.step(run_id, "apply", reason, preview=digest)
    _show_run(run, json)


def verify(
    phase: Annotated[str, typer.Option("--phase", metavar="ID", help="Whose sheets.")],
    reason: ReasonOption,
    sample: Annotated[
        str, typer.Option("--sample", metavar="all|K", help="All sheets, or K drawn at random.")
    ] = "all",
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Recompute sheets from the uploads and demand every bit again; exit code 1 if one differs."""
    with _rescoring(server) as rescoring:
        found = rescoring.start_verification(phase, _sample_size(sample), reason)
        say(f"verification {found['id']} of {found['n_sheets']} sheets, protocol {_version(found)}")
        found = _verified(rescoring, found)
    _show_verification(found, json)
    if found["n_equal"] != found["n_sheets"]:
        raise typer.Exit(ExceptionDriveError.exit_code)


@contextmanager
def _rescoring(server: str | None) -> "Iterator[Rescoring]":
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.organizer import Organizer

    with Organizer(prepare(server)) as organizer:
        yield organizer.rescoring


def _step(step: str, words: str) -> Callable[..., None]:
    """Return the command of a step that needs nothing but a run and a reason."""

    def take(
        run_id: RunArgument,
        reason: ReasonOption,
        server: options.Server = None,
        json: options.Json = False,
    ) -> None:
        with _rescoring(server) as rescoring:
            run = rescoring.step(run_id, step, reason)
        _show_run(run, json)

    take.__doc__ = words
    return take


def _show_run(run: dict[str, Any], json: bool) -> None:
    from exceptiondrive.cli.rescore_table import run_lines

    if json:
        show_json(run)
    else:
        show(*run_lines(run))


def _watched(rescoring: "Rescoring", run_id: str) -> dict[str, Any]:
    """Follow a run until scoring has ended: ready, paused, failed or cancelled."""
    from exceptiondrive.cli.rescore_table import Bar, progress_line

    with Bar("scoring") as bar:
        while True:
            run = rescoring.run(run_id)
            progress = run["progress"]
            bar.show(progress["done"], progress["total"], progress_line(run))
            waits = progress["total"] - progress["done"] - progress["failed"]
            is_stuck = progress["failed"] and not waits
            if run["state"] not in _SCORING or is_stuck:
                return run
            time.sleep(_LOOK_EVERY_S)


def _verified(rescoring: "Rescoring", found: dict[str, Any]) -> dict[str, Any]:
    from exceptiondrive.cli.rescore_table import Bar, verification_line

    with Bar("recomputing") as bar:
        while found["finished_at"] is None:
            time.sleep(_LOOK_EVERY_S)
            found = rescoring.verification(found["id"])
            made = found["n_equal"] + found["n_different"] + found["n_failed"]
            bar.show(made, found["n_sheets"], verification_line(found))
    return found


def _show_verification(found: dict[str, Any], json: bool) -> None:
    from exceptiondrive.cli.rescore_table import verification_line

    if json:
        show_json(found)
        return
    show(verification_line(found))
    for problem in found["problems"]:
        show(f"  {problem['submission_id']}  {problem['state']}  {problem['note'] or ''}")


def _version(found: dict[str, Any]) -> str:
    return str(found["protocol"]["version"])


def _sample_size(sample: str) -> int | None:
    if sample == "all":
        return None
    is_whole = sample.isascii() and sample.isdecimal() and len(sample) <= 9
    if is_whole and 1 <= int(sample) <= MAX_SAMPLE:
        return int(sample)
    raise InvalidArgumentError(
        "wrong_sample", f"--sample is `all` or a number from 1 to {MAX_SAMPLE:,}, not {sample!r}."
    )


COMMANDS: dict[str, Callable[..., None]] = {
    "start": start,
    "begin": _step("start", "Begin to score a run that was only drafted."),
    "status": status,
    "pause": _step("pause", "Let no further sheet of a run begin."),
    "resume": _step("resume", "Go on with a run, and try failed sheets again."),
    "preview": preview,
    "apply": apply,
    "cancel": _step("cancel", "End a run that was not applied; the board never changed."),
    "rollback": _step("rollback", "Show the board under the earlier protocol again."),
    "close": _step("close", "End an applied run for good: it can no longer be rolled back."),
    "verify": verify,
}
