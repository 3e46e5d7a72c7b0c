"""`exceptiondrive-build report` and `audit plan`: the numbers as text, and as a plot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from exceptiondrive_build.cli import Json, WorkshopFolder
from exceptiondrive_build.numbers import AuditPlan, audit_plan
from exceptiondrive_build.report import Line, Report, report
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.datasheet import Cell
from exceptiondrive_schemas.printable import counted

PIPED_WIDTH = 140
MOST_REASONS = 10
audits = typer.Typer(rich_markup_mode=None, help="Inspections of what the review accepted.")


def report_command(
    workshop: WorkshopFolder = Path(),
    plot: Annotated[Path | None, typer.Option(help="Draw it, too: FILE.svg, .png or .pdf.")] = None,
    json: Json = False,
) -> None:
    """Count everything: funnel, families, marks, audit, agreement, time and money."""
    with Workshop(workshop) as opened:
        found = report(opened)
    if json:
        typer.echo(found.model_dump_json(indent=2))
    else:
        show_report(found)
    if plot is not None:
        from exceptiondrive_build.plots import draw_report

        draw_report(found, plot)


@audits.command("plan")
def plan_command(
    workshop: WorkshopFolder = Path(),
    share: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Expected share that passes; by default as seen so far."),
    ] = None,
    json: Json = False,
) -> None:
    """Say how many of the accepted edits to draw for which width of the interval."""
    with Workshop(workshop) as opened:
        plan = audit_plan(opened, share)
    if json:
        typer.echo(plan.model_dump_json(indent=2))
    else:
        show_plan(plan)


def show_report(found: Report) -> None:
    """Print a report as text."""
    out = _console()
    out.print(_funnel(found.funnel))
    out.print(_cells("family", found.families))
    out.print(_cells("task", found.tasks))
    marks = Table("mark", "1", "2", "3", "4", "5", "mean", title="Marks of the review")
    for mark, counts in found.marks.items():
        n = sum(counts)
        mean = sum(value * count for value, count in enumerate(counts, start=1)) / n if n else None
        marks.add_row(mark.replace("_", " "), *map(str, counts), _number(mean))
    out.print(marks)
    for title, reasons in (
        ("rejected", found.rejected_because),
        ("unsuitable", found.unsuitable_because),
        ("no usable answer", found.without_answer),
    ):
        for reason, count in list(reasons.items())[:MOST_REASONS]:
            out.print(f"{title}: {count:,} {reason}")
        rest = list(reasons.values())[MOST_REASONS:]
        if rest:
            out.print(f"{title}: {sum(rest):,} of {counted(len(rest), 'further kind')}: --json")
    if found.audit is not None:
        audit = found.audit
        out.print(
            f"audit: {audit.passed} of {audit.drawn} passed, {audit.passed / audit.drawn:.2%}; "
            f"Wilson interval {_span(audit.wilson)}, of the finite population of "
            f"{audit.accepted:,} {_span(audit.finite_population)} ({audit.confidence:.0%})"
        )
    if found.agreement is not None:
        agreed = found.agreement
        out.print(
            f"agreement: {agreed.n:,} regions read twice, {agreed.same_word:,} with the same word, "
            f"{agreed.beyond:,} for a third reader; median IoU {_number(agreed.iou_median)}, "
            f"greatest corner distance {_number(agreed.corner_m_max)} m, "
            f"alpha {_number(agreed.alpha)}"
        )
    out.print(_time_and_money(found))
    for note in found.notes:
        out.print(f"note: {note}")


def show_plan(plan: AuditPlan) -> None:
    """Print how many edits to draw for which width of the interval."""
    table = Table(
        "width of the interval",
        "draw",
        "share",
        title=f"{plan.accepted:,} accepted, {plan.share:.2%} expected to pass",
    )
    for row in plan.rows:
        table.add_row(f"{row.width:.0%}", f"{row.draw:,}", f"{row.draw / plan.accepted:.2%}")
    _console().print(table)


def _console() -> Console:
    out = Console(highlight=False, markup=False, emoji=False)
    if not out.is_terminal:
        out.width = max(out.width, PIPED_WIDTH)
    return out


def _funnel(lines: Sequence[Line]) -> Table:
    table = Table("", "n", "of", "%", title="From scenes to regions")
    for line in lines:
        percent = "" if line.percent is None else f"{line.percent:.2f}"
        table.add_row(line.title, f"{line.n:,}", f"{line.of:,}", percent)
    return table


def _cells(kind: str, found: Sequence[Cell]) -> Table:
    accepted = sum(cell.accepted for cell in found)
    table = Table(kind, "combinations", "suitable", "accepted", "% of suitable", "% of accepted")
    for cell in found:
        table.add_row(
            f"{cell.id} {cell.title}",
            f"{cell.candidates:,}",
            f"{cell.suitable:,}",
            f"{cell.accepted:,}",
            _percent(cell.accepted, cell.suitable),
            _percent(cell.accepted, accepted),
        )
    return table


def _time_and_money(found: Report) -> Table:
    table = Table("stage", "done", "hours", "cost", "left", "hours left", "cost left")
    for spent in found.spent:
        table.add_row(
            spent.stage,
            f"{spent.calls:,} calls",
            f"{spent.hours:.2f}",
            _money(spent.cost, found.currency),
            f"{spent.left.calls:,} calls",
            f"{spent.left.hours:.2f}",
            _money(spent.left.cost, found.currency),
        )
    for people in found.people:
        table.add_row(
            people.stage,
            f"{people.decisions:,} decisions",
            f"{people.hours:.2f}",
            "",
            f"{people.open:,} decisions",
            _number(people.hours_left),
            "",
        )
    return table


def _money(value: float | None, currency: str) -> str:
    return "–" if value is None else f"{value:,.2f} {currency}"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _percent(n: int, of: int) -> str:
    return f"{100 * n / of:.2f}" if of else "–"


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.2%} to {ends[1]:.2%}"
