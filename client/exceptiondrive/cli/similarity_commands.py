"""The report of submissions that are alike."""

from typing import Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import show, show_json
from exceptiondrive.cli.records_table import show_records

KIND_WORDS = {"equal_files": "equal files", "equal_answers": "equal answers", "near": "near"}


def similar(
    phase: Annotated[str, typer.Option("--phase", metavar="PHASE", help="Id of the phase.")],
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show teams with equal or near-equal submissions, and teams that may be probing.

    Reasons to ask a team, not proof: planners that both stand still are alike, too.
    """
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.organizer import Organizer

    with Organizer(prepare(server)) as organizer:
        report = organizer.similar(phase)
    if json:
        show_json(report)
        return
    _show_pairs(report)
    _show_probing(report)
    show(f"{report['n_compared']} submissions compared, {report['n_waiting']} waiting for a worker")


def _show_pairs(report: dict[str, Any]) -> None:
    if not report["pairs"]:
        show("no submissions of two teams are alike")
        return
    rows = [
        {
            "alike": KIND_WORDS.get(pair["kind"], pair["kind"]),
            "first": _named(pair["first"]),
            "second": _named(pair["second"]),
            "samples alike": f"{100 * pair['equal_share']:.2f} %",
            "mean distance": f"{pair['mean_distance'] or 0:.2f}",
            "samples that differ": pair["n_different"],
        }
        for pair in report["pairs"]
    ]
    show_records(rows, tuple(rows[0]), json=False)


def _show_probing(report: dict[str, Any]) -> None:
    for found in report["probing"]:
        show(
            f"{found['team']}: {found['n_submissions']} submissions that change at most 1 % of the "
            f"samples of another, {found['first_at']} to {found['last_at']}"
        )


def _named(submission: dict[str, Any]) -> str:
    return f"{submission['team']}: {submission['method']} ({submission['id']})"
