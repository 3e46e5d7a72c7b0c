"""A score sheet for people: both aggregates, families, tasks, plausibility."""

from collections.abc import Iterator, Mapping

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive.cli.numbers import challenge_of, metric_head, metric_text
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import Protocol, packaged_protocol
from exceptiondrive_schemas.score_sheet import BreakdownRow, MetricRow, ProtocolRef, ScoreSheet

SENSITIVITY = "d_safe_x"
AGGREGATES = {
    "macro_family": "macro_family (mean of the family means)",
    "micro": "micro (mean over all samples)",
}


def sheet_view(
    sheet: ScoreSheet, protocol: Protocol | None = None, with_tasks: bool = True
) -> Iterator[RenderableType]:
    """Yield what to print for a score sheet.

    Args:
        sheet: Scores, exact or as published.
        protocol: Gives titles, digits and the headline; else the one that ships with the client
            if it is the sheet's, else ids and two digits are shown.
        with_tasks: Whether to show the rows of the tasks.
    """
    protocol = protocol or _shipped(sheet.protocol)
    yield Text(
        f"{challenge_of(sheet.challenge).title} · split {sheet.split.name} · "
        f"protocol {sheet.protocol.version} · {sheet.n} samples",
        style="bold",
    )
    yield _coverage(sheet)
    yield _table(sheet, protocol, with_tasks)
    yield from _sensitivity(sheet, protocol)
    yield from _plausibility(sheet)
    yield from _extra(sheet)


def _shipped(wanted: ProtocolRef) -> Protocol | None:
    try:
        shipped = packaged_protocol(wanted.version)
    except FileNotFoundError:
        return None
    return shipped if shipped.digest == wanted.digest else None


def _coverage(sheet: ScoreSheet) -> Text:
    parts = [f"{sheet.coverage.edited:.2%} edited"]
    if sheet.coverage.source is None:
        parts = [f"{sheet.coverage.edited:.2%}"]
    else:
        parts.append(f"{sheet.coverage.source:.2%} source")
    return Text(f"answers given: {', '.join(parts)}", style="dim")


def _table(sheet: ScoreSheet, protocol: Protocol | None, with_tasks: bool) -> Table:
    challenge = challenge_of(sheet.challenge)
    table = Table(box=None, padding=(0, 1), header_style="bold")
    table.add_column("")
    table.add_column("n", justify="right")
    for metric in challenge.metrics:
        table.add_column(metric_head(metric), justify="right", no_wrap=True)
    headline = protocol.grading.headline if protocol else "macro_family"
    for key in sorted(AGGREGATES, key=lambda key: key != headline):
        row: MetricRow = getattr(sheet, key)
        style = "bold" if key == headline else ""
        table.add_row(AGGREGATES[key], str(sheet.n), *_cells(challenge, row, protocol), style=style)
    table.add_section()
    _add_rows(table, challenge, sheet.families, _family_titles(protocol), protocol)
    if with_tasks:
        table.add_row()
        _add_rows(table, challenge, sheet.tasks, _task_titles(protocol), protocol)
    return table


def _add_rows(
    table: Table,
    challenge: Challenge,
    rows: Mapping[str, BreakdownRow],
    titles: Mapping[str, str],
    protocol: Protocol | None,
) -> None:
    in_order = [key for key in titles if key in rows]  # kept sheets come sorted by key
    for key in [*in_order, *(key for key in rows if key not in titles)]:
        row = rows[key]
        n = "" if row.n is None else str(row.n)
        table.add_row(titles.get(key, key), n, *_cells(challenge, row.metrics, protocol))


def _cells(challenge: Challenge, row: MetricRow, protocol: Protocol | None) -> list[str]:
    digits = protocol.publication if protocol else None
    return [metric_text(metric, row.get(metric.key), digits) for metric in challenge.metrics]


def _family_titles(protocol: Protocol | None) -> dict[str, str]:
    return {family.id: family.title for family in protocol.families} if protocol else {}


def _task_titles(protocol: Protocol | None) -> dict[str, str]:
    return {task.id: f"{task.id} {task.name}" for task in protocol.tasks} if protocol else {}


def _sensitivity(sheet: ScoreSheet, protocol: Protocol | None) -> Iterator[Text]:
    """One line for each other required clearance that the protocol asks about."""
    hcc = next((m for m in challenge_of(sheet.challenge).metrics if m.key == "hcc"), None)
    digits = protocol.publication if protocol else None
    for name, row in sheet.extra.items():
        if hcc is not None and name.startswith(SENSITIVITY):
            averages = ("hcc_macro_family", "macro_family"), ("hcc_micro", "micro")
            parts = [f"{title} {metric_text(hcc, row.get(k), digits)}" for k, title in averages]
            factor = name.removeprefix(SENSITIVITY)
            yield Text(f"HCC % at {factor} times d_safe: {', '.join(parts)}", style="dim")


def _plausibility(sheet: ScoreSheet) -> Iterator[RenderableType]:
    shares = {key: share for key, share in sheet.plausibility.shares.items() if share is not None}
    if shares:
        listed = ", ".join(f"{key.replace('_', ' ')} {share:.1%}" for key, share in shares.items())
        yield Text(f"plausibility: {listed}", style="dim")
    for flag in sheet.plausibility.flags:
        yield Text.assemble(("flag ", "yellow"), (flag.label, "bold yellow"), f": {flag.detail}")


def _extra(sheet: ScoreSheet) -> Iterator[RenderableType]:
    """Further named rows: counts as counts, anything else as the fraction that it is."""
    by_columns: dict[tuple[str, ...], Table] = {}
    others = {key: row for key, row in sheet.extra.items() if not key.startswith(SENSITIVITY)}
    for name, row in others.items():
        table = by_columns.get(tuple(row))
        if table is None:
            table = by_columns[tuple(row)] = Table(box=None, padding=(0, 1), header_style="bold")
            table.add_column("")
            for key in row:
                table.add_column(key.replace("_", " "), justify="right")
        is_count = "n" in row
        table.add_row(name.replace("_", " "), *(_extra_cell(v, is_count) for v in row.values()))
    yield from by_columns.values()


def _extra_cell(value: float | None, is_count: bool) -> str:
    if value is None:
        return "none"
    return f"{value:.0f}" if is_count else f"{value:.2%}"
