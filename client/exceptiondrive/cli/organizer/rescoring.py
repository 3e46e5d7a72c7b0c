"""Protocol updates from the command line: draft, score, preview, apply, roll back, verify.

Runs, previews and verifications are shown as a person reads them in a terminal.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from exceptiondrive.challenges import challenge_of
from exceptiondrive.checking import write_file
from exceptiondrive.cli import completion, options
from exceptiondrive.cli.file_tables import metric_head
from exceptiondrive.cli.fitted_table import Column, FittedTable
from exceptiondrive.cli.options import argument, flag, option
from exceptiondrive.cli.output import Answer, replacing, say, show_result
from exceptiondrive.cli.progress import step_line
from exceptiondrive.cli.session import command_of, open_organizer
from exceptiondrive.errors import (
    ExceptionDriveError,
    InvalidArgumentError,
    NetworkError,
    utc_text,
)
from exceptiondrive.organizer import Rescoring
from exceptiondrive_schemas.api.rescoring import (
    Comparison,
    PreviewView,
    RunKind,
    RunState,
    RunView,
    Standing,
    VerificationView,
)
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.score_sheet import MetricRow, metric_text

RunArgument = Annotated[str, argument("RUN", "Id of the run.", offer=completion.runs)]
WatchOption = Annotated[
    bool, flag("--watch", "Follow until scoring has ended; exit code 6 on failures.")
]
DIRECTIONS = {
    "apply": "what readers would see change if it is applied:",
    "roll_back": "it is applied; what readers would see change if it is rolled back:",
    "applied": "what readers saw change when it was applied:",
}
"""What a preview compares, by its direction."""
_POLL_EVERY_S = 1.0
_MAX_POLLS = 120
MAX_SAMPLE = 100_000


@contextmanager
def _open_rescoring(server: str | None) -> Iterator[Rescoring]:
    with open_organizer(server) as organizer:
        yield organizer.rescoring


with_rescoring = command_of(_open_rescoring)


@with_rescoring
def start(
    rescoring: Rescoring,
    phase: Annotated[str, options.phase("Whose board is to change.", "ID")],
    reason: options.Reason,
    protocol: Annotated[str | None, option("--protocol", "V", "New version or digest.")] = None,
    split_revision: Annotated[str | None, option("--split-revision", "R", "New revision.")] = None,
    draft: Annotated[bool, flag("--draft", "Only draft it; score nothing yet.")] = False,
) -> Answer:
    """Draft a run and begin to score in the background; the board does not change.

    A worker tries the split first; if it cannot be scored, the run stays a draft.
    """
    run = rescoring.draft(phase, protocol, split_revision, reason)
    if not draft:
        try:
            run = _start_when_tried(rescoring, run, reason)
        except NetworkError as error:
            raise NetworkError(
                error.code,
                f"{error.sentence} The run {run.id} is drafted.",
                "Once the server answers, start it, or see that it has started: "
                f'organizer rescore begin {run.id} --reason "…"',
            ) from None
    return run, *run_lines(run)


def _start_when_tried(rescoring: Rescoring, run: RunView, reason: str) -> RunView:
    """Begin a drafted run once a worker has tried its split."""
    run = _wait_for_trial(rescoring, run)
    if run.trial is not None and run.trial.state == "held":
        raise InvalidArgumentError(
            "split_floor",
            f"It stays a draft. {run.blockers[0]}",
            f"organizer rescore cancel {run.id}",
        )
    return rescoring.step(run.id, "start", reason)


def status(
    run_id: Annotated[
        str | None, argument("[RUN]", "Id of a run; else all runs.", offer=completion.runs)
    ] = None,
    phase: options.Phase = None,
    watch: WatchOption = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show runs, or one run with its progress and what blocks it."""
    with _open_rescoring(server) as rescoring:
        if run_id is None:
            runs = rescoring.runs(phase)
            show_result(runs, json, runs_table(runs))
            return
        run = _watch_run(rescoring, run_id) if watch else rescoring.run(run_id)
        shown: Any = run
        lines = run_lines(run)
        if run.kind is RunKind.VERIFICATION:
            found = rescoring.verification(run_id)
            shown = {**run.model_dump(mode="json"), "verification": found}
            lines = [*verification_lines(found)]
    show_result(shown, json, *lines)
    if watch and run.progress.failed:
        raise typer.Exit(6)


def preview(
    run_id: RunArgument,
    csv: Annotated[Path | None, option("--csv", "FILE", "Write it as CSV too.")] = None,
    seen: Annotated[str | None, option("--seen", "DIGEST", "Digest of an earlier preview.")] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Compare every entry before and after; exit code 1 if the preview is stale."""
    with _open_rescoring(server) as rescoring:
        found = rescoring.preview(run_id, seen)
        if csv is not None:
            with replacing(csv):
                write_file(csv, rescoring.preview_csv(run_id))
    show_result(found, json, preview_lines(found))
    if found.is_stale:
        raise typer.Exit(ExceptionDriveError.exit_code)


@with_rescoring
def apply(
    rescoring: Rescoring,
    run_id: RunArgument,
    reason: options.Reason,
    digest: Annotated[
        str, option("--preview", "DIGEST", "Last line of the `preview` that you checked.")
    ],
) -> Answer:
    """Show the new board, in one step; refused while anything is missing or stale."""
    for warning in rescoring.preview(run_id).warnings:
        say(warning)
    run = rescoring.step(run_id, "apply", reason, preview=digest)
    return run, *run_lines(run)


def verify(
    phase: Annotated[str, options.phase("Whose sheets.", "ID")],
    reason: options.Reason,
    sample: Annotated[
        str, option("--sample", "all|K", "All sheets, or K drawn at random.")
    ] = "all",
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Recompute sheets from the uploads and compare every bit; exit code 1 if one differs."""
    with _open_rescoring(server) as rescoring:
        found = rescoring.start_verification(phase, _sample_size(sample), reason)
        follow_verification(rescoring, found, json)


def follow_verification(rescoring: Rescoring, found: VerificationView, json: bool) -> None:
    """Wait until every sheet has come to an end, and show what came of it.

    Raises:
        typer.Exit: A sheet differs, or could not be made again.
    """
    sheets = counted(found.n_sheets, "sheet")
    say(f"verification {found.id} of {sheets}, protocol {found.protocol.version}")
    say(f"it continues by itself; exceptiondrive organizer rescore status {found.id} shows it, too")
    found = _watch_verification(rescoring, found)
    show_result(found, json, *verification_lines(found))
    if found.n_equal != found.n_sheets:
        raise typer.Exit(ExceptionDriveError.exit_code)


def _step_command(step: str, words: str) -> Callable[..., None]:
    """Return the command of a step that needs nothing but a run and a reason."""

    @with_rescoring
    def take(rescoring: Rescoring, run_id: RunArgument, reason: options.Reason) -> Answer:
        run = rescoring.step(run_id, step, reason)
        return run, *run_lines(run)

    take.__doc__ = words
    return take


def _watch_run(rescoring: Rescoring, run_id: str) -> RunView:
    """Follow a run until scoring has ended: ready, paused, failed or cancelled."""
    with step_line() as tell:
        while True:
            run = rescoring.run(run_id)
            progress = run.progress
            tell(f"scoring: {progress.words}")
            waits = progress.total - progress.done - progress.failed
            is_stuck = progress.failed and not waits
            if run.state != RunState.SCORING or is_stuck:
                return run
            time.sleep(_POLL_EVERY_S)


def _wait_for_trial(rescoring: Rescoring, run: RunView) -> RunView:
    """Wait until a worker has tried the split of a draft, which then may be refused."""
    with step_line() as tell:
        for n_polls in range(_MAX_POLLS):
            if run.trial is None or run.trial.state != "waiting":
                return run
            tell(f"run {run.id}: a worker will try the split")
            if n_polls:
                time.sleep(_POLL_EVERY_S)
            run = rescoring.run(run.id)
    raise InvalidArgumentError(
        "not_tried",
        f"No worker has tried the split of run {run.id} within {_MAX_POLLS} s: it stays a draft.",
        "Check whether a worker serves the lane rescore; then: "
        f'organizer rescore begin {run.id} --reason "…"',
    )


def _watch_verification(rescoring: Rescoring, found: VerificationView) -> VerificationView:
    with step_line() as tell:
        while found.finished_at is None:
            time.sleep(_POLL_EVERY_S)
            found = rescoring.verification(found.id)
            tell(verification_line(found))
    return found


def _sample_size(sample: str) -> int | None:
    if sample == "all":
        return None
    is_whole = sample.isascii() and sample.isdecimal() and len(sample) <= 9
    if is_whole and 1 <= int(sample) <= MAX_SAMPLE:
        return int(sample)
    raise InvalidArgumentError(
        "wrong_sample", f"--sample is `all` or a number from 1 to {MAX_SAMPLE:,}, not {sample!r}."
    )


def run_lines(run: RunView) -> list[RenderableType]:
    """Return state, progress, changes and blockers of a run."""
    head = f"run {run.id}  {run.state}  phase {run.phase}  {' -> '.join(_from_and_to(run))}"
    difference = run.difference
    lines: list[RenderableType] = [head, f"  {run.progress.words}", f"  {difference.sentence}"]
    lines += [f"  - {sentence}" for sentence in difference.sentences]
    if difference.remark:
        lines.append(f"  note: {difference.remark}")
    if not run.state.is_final:
        lines += [f"  ! {blocker}" for blocker in run.blockers]
    return lines


def _from_and_to(changed: RunView | Comparison) -> tuple[str, str]:
    """Return versions of the protocol from and to, or where one stays and another split counts, revisions."""
    if changed.from_protocol != changed.to_protocol or changed.from_split == changed.to_split:
        return changed.from_protocol.version, changed.to_protocol.version
    splits = changed.from_split, changed.to_split
    before, after = (split.revision.removeprefix("sha256:")[:12] for split in splits)
    return before, after


def runs_table(runs: Sequence[RunView]) -> FittedTable:
    """Return a line per run."""
    table = FittedTable.of(
        Column("run", "id"),
        Column("phase", "id"),
        "state",
        Column("from", "id", left_out=3),
        Column("to", "id", left_out=2),
        Column("sheets", "number"),
        Column("created", "id", left_out=4),
        Column("reason", left_out=1),
    )
    for run in runs:
        table.add_row(
            run.id,
            run.phase,
            run.state,
            *_from_and_to(run),
            f"{run.progress.done}/{run.progress.total}",
            utc_text(run.created_at),
            run.reason,
        )
    return table


def preview_lines(preview: PreviewView) -> Iterator[RenderableType]:
    """Yield the headline of a comparison and its entries, worst movers first."""
    comparison = preview.comparison
    stale = "  STALE: something has changed since" if preview.is_stale else ""
    head = (
        f"{' -> '.join(_from_and_to(comparison))}, "
        f"board {comparison.old_board} -> {comparison.new_board}: "
        f"{comparison.n_entries} entries, {comparison.n_numbers_changed} with new numbers, "
        f"{comparison.n_ranks_changed} with a new rank, "
        f"{comparison.n_newly_ranked} newly ranked, "
        f"{comparison.n_newly_failing} no longer ranked{stale}"
    )
    yield DIRECTIONS[preview.direction]
    yield head
    yield _entries_table(comparison)
    yield from _unranked_lines(comparison)
    yield from _effect_lines(comparison)
    yield from (f"! {blocker}" for blocker in preview.blockers)
    yield from preview.warnings
    yield f"preview {preview.digest}"


def _entries_table(comparison: Comparison) -> FittedTable:
    entries = {entry.submission_id: entry for entry in comparison.entries}
    movers = [entries[key] for key in comparison.worst_movers]
    rest = [entry for entry in comparison.entries if entry not in movers]
    challenge = challenge_of(comparison.challenge)
    metrics = [metric for metric in challenge.metrics if metric.role == "primary"]
    numbers = (Column(metric_head(metric), "number", left_out=1) for metric in metrics)
    table = FittedTable.of("method", "rank", Column("interval", left_out=2), *numbers, "")
    for entry in movers + rest:
        old, new = entry.old, entry.new
        table.add_row(
            entry.method,
            f"{entry.old_rank or '-'} -> {entry.new_rank or '-'}",
            f"{_interval_text(old)} -> {_interval_text(new)}",
            *(f"{_metric_text(old, metric)} -> {_metric_text(new, metric)}" for metric in metrics),
            "no longer ranked" if entry.newly_failing else entry.change.replace("_", " "),
        )
    return table


def _unranked_lines(comparison: Comparison) -> list[str]:
    """Return a line per entry that loses its rank: why."""
    return [
        f"no longer ranked: {entry.method} ({entry.team}): "
        f"{(entry.new and entry.new.unranked_because) or 'not on the new board: on its way, replaced, withdrawn or disqualified'}"
        for entry in comparison.entries
        if entry.newly_failing
    ]


def _effect_lines(comparison: Comparison) -> list[str]:
    """Return a line per linked entry: what its reminder changes, before and after."""
    metrics = challenge_of(comparison.challenge).columns
    lines = []
    for entry in comparison.entries:
        old, new = _effect_of(entry.old), _effect_of(entry.new)
        if old or new:
            words = (
                f"{metric.label} {_signed_effect(old, metric)} -> {_signed_effect(new, metric)}"
                for metric in metrics
                if metric.role == "primary"
            )
            lines.append(f"reminder's effect on {entry.method}: {', '.join(words)}")
    return lines


def _effect_of(standing: Standing | None) -> MetricRow:
    effect = standing and standing.reminder_effect
    return effect.by_metric if effect else {}


def _signed_effect(effect: MetricRow, metric: Metric) -> str:
    value = effect.get(metric.key)
    if value is None:
        return "-"
    return f"+{metric_text(metric, value)}" if value >= 0 else metric_text(metric, value)


def verification_line(found: VerificationView) -> str:
    """Return what a verification has come to."""
    made = found.n_equal + found.n_different + found.n_failed
    words = f"{made} of {found.n_sheets} sheets recomputed: {found.n_equal} equal bit for bit"
    if found.n_different:
        words += f", {found.n_different} DIFFER"
    if found.n_failed:
        words += f", {found.n_failed} could not be recomputed"
    return words


def verification_lines(found: VerificationView) -> Iterator[str]:
    """Yield what a verification has come to, and each sheet that is not equal."""
    yield verification_line(found)
    for problem in found.problems:
        yield f"  {problem.submission_id}  {problem.state}  {problem.note or ''}"


def _interval_text(standing: Standing | None) -> str:
    span = standing and standing.rank_interval
    return f"{span[0]}..{span[1]}" if span else "-"


def _metric_text(standing: Standing | None, metric: Metric) -> str:
    return metric_text(metric, standing.metrics.get(metric.key) if standing else None)


COMMANDS: dict[str, Callable[..., None]] = {
    "start": start,
    "begin": _step_command(
        "start", "Begin to score a drafted run: the step `start` of pages and API."
    ),
    "status": status,
    "pause": _step_command("pause", "Pause a run: no further sheet is started."),
    "resume": _step_command("resume", "Continue a run, and try failed sheets again."),
    "preview": preview,
    "apply": apply,
    "cancel": _step_command("cancel", "End a run that was not applied; the board never changed."),
    "rollback": _step_command("rollback", "Show the board under the earlier protocol again."),
    "close": _step_command(
        "close", "End an applied run for good: it can no longer be rolled back."
    ),
    "verify": verify,
}
