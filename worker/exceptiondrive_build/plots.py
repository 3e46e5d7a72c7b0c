"""The report as one picture: funnel, families, marks, audit."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.report import Report

FUNNEL = ("combinations", "suitable", "edited", "accepted", "kept", "localized", "verified")
COLOUR, FAINT = "#2f5d8a", "#c8d5e3"
BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.08), "frameon": False}
MARK_COLOURS = ("#a33b2e", "#d98a5b", "#d8cfa8", "#8fb08c", "#3f7d4e")


def draw_report(report: Report, path: Path) -> None:
    """Write the picture; the extension of the path selects the format.

    Raises:
        BuildError: The file cannot be written, or has an unknown format.
    """
    with mpl.rc_context({"svg.hashsalt": report.name, "font.size": 9}):
        figure = Figure(figsize=(11, 7.5), layout="constrained")
        (upper_left, upper_right), (lower_left, lower_right) = figure.subplots(2, 2)
        _funnel(upper_left, report)
        _families(upper_right, report)
        _marks(lower_left, report)
        _audit(lower_right, report)
        figure.suptitle(report.name)
        try:
            figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise BuildError(f"{path}: {why}.") from None


def _funnel(axes: Axes, report: Report) -> None:
    lines = [report.line(line_id) for line_id in FUNNEL]
    bars = axes.barh([line.title for line in lines], [line.n for line in lines], color=COLOUR)
    percents = [line.percent for line in lines]
    labels = [
        f" {line.n:,}" + (f" ({p:.2f} %)" if p is not None else "")
        for line, p in zip(lines, percents, strict=True)
    ]
    axes.bar_label(bars, labels)
    axes.invert_yaxis()
    axes.margins(x=0.5)
    axes.set_title("From scenes to regions, and shares as in the table")


def _families(axes: Axes, report: Report) -> None:
    titles = [cell.title for cell in report.families]
    axes.barh(titles, [cell.suitable for cell in report.families], color=FAINT, label="suitable")
    axes.barh(titles, [cell.accepted for cell in report.families], color=COLOUR, label="accepted")
    axes.invert_yaxis()
    axes.legend(ncols=2, **BELOW)
    axes.set_title("Families")


def _marks(axes: Axes, report: Report) -> None:
    titles = [mark.replace("_", " ") for mark in report.marks]
    left = [0.0] * len(titles)
    for value, colour in enumerate(MARK_COLOURS, start=1):
        counts = [found[value - 1] for found in report.marks.values()]
        axes.barh(titles, counts, left=left, color=colour, label=str(value))
        left = [start + count for start, count in zip(left, counts, strict=True)]
    axes.invert_yaxis()
    axes.legend(ncols=5, **BELOW)
    axes.set_title("Marks of the review, 1 (bad) to 5 (good)")


def _audit(axes: Axes, report: Report) -> None:
    axes.set_title("Audit of the accepted: share that passed")
    if report.audit is None:
        axes.text(0.5, 0.5, "nothing inspected yet", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    share = 100 * report.audit.passed / report.audit.drawn
    spans = {"Wilson": report.audit.wilson, "finite population": report.audit.finite_population}
    for place, (low, high) in enumerate(spans.values()):
        axes.errorbar(
            share,
            place,
            xerr=[[max(share - 100 * low, 0)], [max(100 * high - share, 0)]],
            fmt="o",
            color=COLOUR,
            capsize=4,
        )
    axes.set_yticks(range(len(spans)), list(spans))
    axes.set_ylim(-0.7, len(spans) - 0.3)
    axes.set_xlabel(f"per cent, {report.audit.passed} of {report.audit.drawn}")
