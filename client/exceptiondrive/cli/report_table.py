"""A check report for people: the server's sentences, then where, expected, got and hint."""

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive_schemas.faults import CheckReport, FaultGroup

EXAMPLES_SHOWN = 5


def report_view(report: CheckReport, name: str = "The file") -> Iterator[RenderableType]:
    """Yield what to print for a report.

    Args:
        report: Outcome of a check.
        name: What to call the file.
    """
    yield Text(_headline(report, name), style="bold red" if report.faults else "bold green")
    for group in report.faults:
        yield ""
        yield _group_line(group)
        yield _examples(group)
        rest = group.count - min(len(group.examples), EXAMPLES_SHOWN)
        if rest > 0:
            yield Text(f"  ... and {rest} more", style="dim")
    for note in report.notes:
        yield Text(f"note: {note}", style="yellow")


def _headline(report: CheckReport, name: str) -> str:
    if not report.faults:
        facts = [report.challenge or "", f"{report.n_predictions} predictions"]
        facts += [f"split {report.split}"] if report.split else []
        return f"{name} is valid: {', '.join(fact for fact in facts if fact)}"
    total = sum(group.count for group in report.faults)
    kinds = len(report.faults)
    return (
        f"{name} is not valid: {total} fault{'s' * (total > 1)} of {kinds} kind{'s' * (kinds > 1)}"
    )


def _group_line(group: FaultGroup) -> Text:
    return Text.assemble((group.code.value, "bold"), f"  x {group.count}  {group.message}")


def _examples(group: FaultGroup) -> Table:
    shown = group.examples[:EXAMPLES_SHOWN]
    has_sample = any(fault.sample_id for fault in shown)
    has_hint = any(fault.hint for fault in shown)
    table = Table(box=None, padding=(0, 2), header_style="dim")
    for title, is_shown in (
        ("where", True),
        ("sample", has_sample),
        ("expected", True),
        ("got", True),
        ("hint", has_hint),
    ):
        if is_shown:
            table.add_column(title, overflow="fold")
    for fault in shown:
        cells = [fault.path]
        cells += [fault.sample_id or ""] if has_sample else []
        cells += [fault.expected, fault.got]
        cells += [fault.hint or ""] if has_hint else []
        table.add_row(*(Text(cell) for cell in cells))
    return table
