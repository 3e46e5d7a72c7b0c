"""Print what is known of a file: the check report, its profile, the score sheet."""

from collections.abc import Iterator, Mapping

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive.challenges import challenge_of
from exceptiondrive.cli.fitted_table import Column, FittedTable
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.faults import CheckReport, FaultGroup
from exceptiondrive_schemas.printable import counted, decimal_text
from exceptiondrive_schemas.protocol import Average, ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import (
    HEADLINE,
    BreakdownRow,
    MetricRow,
    ProtocolRef,
    ScoreSheet,
    metric_text,
)

EXAMPLES_SHOWN = 5
FIRST_LEFT_OUT = 3
"""Of the columns of a board or sheet, metrics that do not rank are left out first."""
SENSITIVITY = "d_safe_x"
AGGREGATES = {"macro_family": "mean of families", "micro": "mean of samples"}


def metric_head(metric: Metric) -> str:
    """Column head: label, unit, and which way is better."""
    arrow = {"higher": " ^", "lower": " v", None: ""}[metric.better]
    unit = "%" if metric.unit == "fraction" else "m"
    return f"{metric.label} {unit}{arrow}"


def report_view(
    report: CheckReport, name: str = "The file", with_all: bool = False
) -> Iterator[RenderableType]:
    """Yield what to print for a report.

    Args:
        report: Outcome of a check.
        name: What to call the file.
        with_all: Whether every sample with a fault is named.
    """
    yield Text(_headline(report, name), style="bold red" if report.faults else "bold green")
    for group in report.faults:
        yield ""
        yield Text.assemble(
            (group.code.value, "bold"), f"  {group.extent(report.n_predictions)}  {group.message}"
        )
        yield _example_table(group)
        if with_all and group.sample_ids:
            yield Text(f"  {' '.join(group.sample_ids)}", style="dim")
        elif group.n_samples > EXAMPLES_SHOWN:
            rest = counted(group.n_samples - EXAMPLES_SHOWN, "sample")
            yield Text(f"  ... and {rest} more; --all names every one", style="dim")
        elif not group.n_samples and group.count > EXAMPLES_SHOWN:
            yield Text(f"  ... and {group.count - EXAMPLES_SHOWN:,} more", style="dim")
    yield from file_view(report)


def file_view(report: CheckReport) -> Iterator[RenderableType]:
    """Yield what a file looks like, what is probably wrong with it, and whether it would rank."""
    for note in report.notes:
        yield Text(f"note: {note}", style="yellow")
    if report.unranked_because is not None:
        unranked = f"it will be scored but not ranked: {report.unranked_because}"
        yield Text(f"warning: {unranked}", style="bold yellow")
    if report.profile is None:
        return
    table = Table(box=None, padding=(0, 1), show_header=False)
    for label, words in report.profile.lines:
        table.add_row(Text(label, style="dim"), words)
    yield table
    for warning in report.profile.warnings:
        yield Text(f"warning: {warning}", style="bold yellow")


def _headline(report: CheckReport, name: str) -> str:
    if not report.faults:
        facts = [report.challenge or "", counted(report.n_predictions or 0, "prediction")]
        facts += [f"split {report.split}"] if report.split else []
        return f"{name} is valid: {', '.join(fact for fact in facts if fact)}"
    faults, kinds = counted(report.n_faults, "fault"), counted(len(report.faults), "kind")
    return f"{name} is not valid: {faults} of {kinds}"


def _example_table(group: FaultGroup) -> FittedTable:
    table = FittedTable.of(
        Column("where", "id", left_out=3),
        Column("sample", "id", left_out=2),
        "expected",
        "got",
        Column("hint", left_out=1),
    )
    for fault in group.examples[:EXAMPLES_SHOWN]:
        cells = fault.path, fault.sample_id, fault.expected, fault.got, fault.hint
        table.add_row(*(cell or "" for cell in cells))
    return table


def sheet_view(
    sheet: ScoreSheet,
    protocol: ProtocolDocument | None = None,
    with_tasks: bool = True,
    n_predictions: int | None = None,
    headline: Average = HEADLINE,
) -> Iterator[RenderableType]:
    """Yield what to print for a score sheet.

    Args:
        sheet: Scores, exact or as published.
        protocol: Gives titles, digits and the headline; else the one that ships with the client
            if it is the sheet's, else ids and two digits are shown.
        with_tasks: Whether to show the rows of the tasks.
        n_predictions: How many samples the file answers, where that is known: more than are scored
            where there are controls or withdrawn samples.
        headline: Which average ranks, where no protocol says it.
    """
    n_scored = counted(sheet.n, "sample")
    if n_predictions not in (None, sheet.n):
        n_scored = f"{counted(n_predictions or 0, 'sample')}, {sheet.n:,} of them in the score, "
        n_scored += "the others controls or withdrawn"
    protocol = protocol or _packaged_protocol_of(sheet.protocol)
    yield Text(
        f"{challenge_of(sheet.challenge).title} · split {sheet.split.name} · "
        f"protocol {sheet.protocol.version} · {n_scored}",
        style="bold",
    )
    edited, source = sheet.coverage.edited, sheet.coverage.source
    answered = _percent_text(edited)
    if source is not None:
        answered += f" edited, {_percent_text(source)} source"
    yield Text(f"answers given: {answered}", style="dim")
    headline = protocol.grading.headline if protocol else headline
    yield _sheet_table(sheet, protocol, with_tasks, headline)
    yield from _unpublished_notes(sheet, protocol, with_tasks)
    yield from _sensitivity_lines(sheet, protocol)
    yield from _plausibility_lines(sheet)
    yield from _extra_tables(sheet)


def _packaged_protocol_of(wanted: ProtocolRef) -> ProtocolDocument | None:
    try:
        shipped = packaged_protocol(wanted.version)
    except FileNotFoundError:
        return None
    return shipped if shipped.digest == wanted.digest else None


def _sheet_table(
    sheet: ScoreSheet, protocol: ProtocolDocument | None, with_tasks: bool, headline: Average
) -> FittedTable:
    challenge = challenge_of(sheet.challenge)
    table = FittedTable.of("", Column("n", "number"), *metric_columns(challenge))
    for key in sorted(AGGREGATES, key=lambda key: key != headline):
        row: MetricRow = getattr(sheet, key)
        style = "bold" if key == headline else ""
        table.add_row(AGGREGATES[key], str(sheet.n), *_cells(challenge, row, protocol), style=style)
    families = {family.id: family.title for family in protocol.families} if protocol else {}
    table.add_gap()
    _add_rows(table, challenge, sheet.families, families, protocol)
    if with_tasks:
        tasks = {task.id: f"{task.id} {task.name}" for task in protocol.tasks} if protocol else {}
        table.add_gap()
        _add_rows(table, challenge, sheet.tasks, tasks, protocol)
    return table


def _unpublished_notes(
    sheet: ScoreSheet, protocol: ProtocolDocument | None, with_tasks: bool
) -> Iterator[Text]:
    """Say why rows show no more than how many samples they count, where any does."""
    rows = [*sheet.families.values(), *(sheet.tasks.values() if with_tasks else ())]
    numbers = [row.n for row in rows if row.n and set(row.metrics.values()) == {None}]
    if numbers:
        least = protocol.publication.min_samples_per_cell if protocol else 0
        few = f"fewer than {least}" if max(numbers) < least else "too few"
        which = "families or tasks" if with_tasks else "families"
        yield Text(f"-: {which} of {few} samples are not told, but for their number", style="dim")


def metric_columns(challenge: Challenge) -> Iterator[Column]:
    """Yield the columns of the metrics; those that rank always stay, the last others leave first."""
    ranking = {each.metric for each in challenge.primary_order}
    for index, metric in enumerate(challenge.columns):
        left_out = 0 if metric.key in ranking else FIRST_LEFT_OUT + index
        yield Column(metric_head(metric), "number", left_out)


def _add_rows(
    table: FittedTable,
    challenge: Challenge,
    rows: Mapping[str, BreakdownRow],
    titles: Mapping[str, str],
    protocol: ProtocolDocument | None,
) -> None:
    in_order = [key for key in titles if key in rows]  # kept sheets come sorted by key
    for key in [*in_order, *(key for key in rows if key not in titles)]:
        row = rows[key]
        n = "" if row.n is None else str(row.n)
        table.add_row(titles.get(key, key), n, *_cells(challenge, row.metrics, protocol))


def _cells(challenge: Challenge, row: MetricRow, protocol: ProtocolDocument | None) -> list[str]:
    digits = protocol.publication if protocol else None
    return [metric_text(metric, row.get(metric.key), digits) for metric in challenge.columns]


def _sensitivity_lines(sheet: ScoreSheet, protocol: ProtocolDocument | None) -> Iterator[Text]:
    """One line for each other required clearance that the protocol asks about."""
    hcc = next((m for m in challenge_of(sheet.challenge).metrics if m.key == "hcc"), None)
    digits = protocol.publication if protocol else None
    for name, row in sheet.extra.items():
        if hcc is not None and name.startswith(SENSITIVITY):
            averages = [(f"hcc_{key}", words) for key, words in AGGREGATES.items()]
            parts = [f"{title} {metric_text(hcc, row.get(k), digits)}" for k, title in averages]
            factor = name.removeprefix(SENSITIVITY)
            yield Text(f"HCC % at {factor} times d_safe: {', '.join(parts)}", style="dim")


def _plausibility_lines(sheet: ScoreSheet) -> Iterator[RenderableType]:
    shares = sorted(
        (k, share) for k, share in sheet.plausibility.shares.items() if share is not None
    )
    if shares:
        each = (f"{key.replace('_', ' ')} {_percent_text(share, 1)}" for key, share in shares)
        listed = ", ".join(each)
        yield Text(f"plausibility: {listed}", style="dim")
    for flag in sheet.plausibility.flags:
        yield Text.assemble(("flag ", "yellow"), (flag.label, "bold yellow"), f": {flag.detail}")


def _extra_tables(sheet: ScoreSheet) -> Iterator[RenderableType]:
    """Further named rows: counts as counts, anything else as the fraction that it is.

    In the order of their keys, as kept sheets come; the number of samples first.
    """
    by_columns: dict[tuple[str, ...], FittedTable] = {}
    others = {key: row for key, row in sheet.extra.items() if not key.startswith(SENSITIVITY)}
    for name, unordered in sorted(others.items()):
        row = dict(sorted(unordered.items(), key=lambda cell: (cell[0] != "n", cell[0])))
        table = by_columns.get(tuple(row))
        if table is None:
            titles = (Column(key.replace("_", " "), "number") for key in row)
            table = by_columns[tuple(row)] = FittedTable.of("", *titles)
        is_count = name.startswith("confusion_")
        cells = (_extra_cell(v, is_count or k == "n") for k, v in row.items())
        table.add_row(name.replace("_", " "), *cells)
    yield from by_columns.values()


def _extra_cell(value: float | None, is_count: bool) -> str:
    if value is None:
        return "none"
    return f"{value:.0f}" if is_count else _percent_text(value)


def _percent_text(share: float, decimals: int = 2) -> str:
    """Write a share that is no metric as pages do, one of this machine rounded as a board's."""
    return f"{decimal_text(100 * round(share, 4), decimals)}%"
