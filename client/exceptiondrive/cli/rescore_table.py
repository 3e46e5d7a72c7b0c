"""Runs, previews and verifications as a person reads them in a terminal."""

from typing import Any, Self

from rich.console import RenderableType
from rich.table import Table

from exceptiondrive.cli.output import console, has_terminal
from exceptiondrive_schemas.challenges import CHALLENGES

Record = dict[str, Any]
_ENDED = ("closed", "rolled_back", "cancelled")


def run_lines(run: Record) -> list[RenderableType]:
    """Return state, progress, changes and blockers of a run."""
    head = (
        f"run {run['id']}  {run['state']}  phase {run['phase']}  "
        f"{run['from_protocol']['version']} -> {run['to_protocol']['version']}"
    )
    lines: list[RenderableType] = [
        head,
        f"  {progress_line(run)}",
        f"  {run['difference']['sentence']}",
    ]
    lines += [f"  - {change['sentence']}" for change in run["difference"]["changes"]]
    if run["difference"].get("remark"):
        lines.append(f"  note: {run['difference']['remark']}")
    if run["state"] not in _ENDED:
        lines += [f"  ! {blocker}" for blocker in run["blockers"]]
    return lines


def progress_line(run: Record) -> str:
    """Return how far a run is, in one line."""
    progress = run["progress"]
    words = f"{progress['done']} of {progress['total']} sheets"
    if progress["failed"]:
        words += f", {progress['failed']} failed"
    if progress["sheets_per_s"]:
        words += f", {progress['sheets_per_s']:g} a second"
    if progress["remaining_s"]:
        words += f", about {_duration(progress['remaining_s'])} left"
    return words


def _duration(seconds: float) -> str:
    """Write a length of time in its largest unit."""
    for unit, length_s in (("days", 86_400), ("hours", 3_600), ("minutes", 60)):
        if seconds >= 1.5 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{max(1, round(seconds))} s"


def runs_table(runs: list[Record]) -> Table:
    """Return a line per run."""
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for head in ("run", "phase", "state", "from", "to", "sheets", "created", "reason"):
        table.add_column(head, overflow="fold")
    for run in runs:
        progress = run["progress"]
        table.add_row(
            run["id"],
            run["phase"],
            run["state"],
            run["from_protocol"]["version"],
            run["to_protocol"]["version"],
            f"{progress['done']}/{progress['total']}",
            run["created_at"][:16],
            run["reason"],
        )
    return table


def preview_lines(preview: Record) -> list[RenderableType]:
    """Return the headline of a comparison and its entries, worst movers first."""
    comparison = preview["comparison"]
    stale = "  STALE: something has changed since" if preview["is_stale"] else ""
    head = (
        f"{comparison['from_protocol']['version']} -> {comparison['to_protocol']['version']}, "
        f"board {comparison['old_board']} -> {comparison['new_board']}: "
        f"{comparison['n_entries']} entries, {comparison['n_numbers_changed']} with new numbers, "
        f"{comparison['n_ranks_changed']} with a new rank, "
        f"{comparison['n_newly_failing']} newly failing{stale}"
    )
    lines: list[RenderableType] = [head, _entries_table(comparison)]
    lines += _effect_lines(comparison)
    lines += [f"! {blocker}" for blocker in preview["blockers"]]
    lines.append(f"preview {preview['digest']}")
    return lines


def _entries_table(comparison: Record) -> Table:
    entries = {entry["submission_id"]: entry for entry in comparison["entries"]}
    movers = [entries[key] for key in comparison["worst_movers"]]
    rest = [entry for entry in comparison["entries"] if entry not in movers]
    challenge = CHALLENGES[comparison["challenge"]]
    metrics = [metric.key for metric in challenge.metrics if metric.role == "primary"]
    table = Table(box=None, padding=(0, 1), header_style="bold")
    table.add_column("method", overflow="fold")
    table.add_column("rank")
    table.add_column("interval")
    for metric in metrics:
        table.add_column(metric, justify="right")
    table.add_column("")
    for entry in movers + rest:
        old, new = entry["old"], entry["new"]
        table.add_row(
            entry["method"],
            f"{_of(old, 'rank')} -> {_of(new, 'rank')}",
            f"{_interval(old)} -> {_interval(new)}",
            *(f"{_metric(old, key)} -> {_metric(new, key)}" for key in metrics),
            "newly failing" if entry["newly_failing"] else entry["change"].replace("_", " "),
        )
    return table


def _effect_lines(comparison: Record) -> list[str]:
    """Return a line per linked entry: what its reminder changes, before and after."""
    metrics = CHALLENGES[comparison["challenge"]].metrics
    lines = []
    for entry in comparison["entries"]:
        sides = [_effect(entry[side]) for side in ("old", "new")]
        if any(sides):
            words = (
                f"{metric.key} {_signed(sides[0], metric.key)} -> {_signed(sides[1], metric.key)}"
                for metric in metrics
                if metric.role == "primary"
            )
            lines.append(f"reminder's effect on {entry['method']}: {', '.join(words)}")
    return lines


def _effect(standing: Record | None) -> Record:
    effect = None if standing is None else standing.get("reminder_effect")
    return {} if effect is None else dict(effect["differences"])


def _signed(effect: Record, key: str) -> str:
    value = effect[key]["difference"] if key in effect else None
    return "-" if value is None else f"{value:+.4f}"


def verification_line(found: Record) -> str:
    """Return what a verification has come to."""
    made = found["n_equal"] + found["n_different"] + found["n_failed"]
    words = f"{made} of {found['n_sheets']} sheets recomputed: {found['n_equal']} equal bit for bit"
    if found["n_different"]:
        words += f", {found['n_different']} DIFFER"
    if found["n_failed"]:
        words += f", {found['n_failed']} could not be recomputed"
    return words


class Bar:
    """A bar on a terminal; elsewhere nothing moves."""

    def __init__(self, what: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        self._bar = Progress(
            TextColumn(what),
            BarColumn(),
            TextColumn("{task.description}"),
            console=console(stderr=True),
            transient=True,
            disable=not has_terminal(),
        )
        self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, done: int, total: int, words: str) -> None:
        """Move the bar."""
        self._bar.update(self._task, completed=done, total=total, description=words)


def _of(standing: Record | None, key: str) -> str:
    value = None if standing is None else standing[key]
    return "-" if value is None else str(value)


def _interval(standing: Record | None) -> str:
    span = None if standing is None else standing["rank_interval"]
    return "-" if span is None else f"{span[0]}..{span[1]}"


def _metric(standing: Record | None, key: str) -> str:
    value = None if standing is None else standing["metrics"].get(key)
    return "-" if value is None else f"{value:.4f}"
