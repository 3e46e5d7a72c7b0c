"""`exceptiondrive-build run` and `localize`: stages that ask a model, and proposals for regions."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_build.asking import StageReport, run_stage
from exceptiondrive_build.candidates import walk
from exceptiondrive_build.cli import Json, WorkshopFolder
from exceptiondrive_build.dry_run import StagePlan, dry_run
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.localizing import localize, localize_by_hand
from exceptiondrive_build.stages import STAGES
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_endpoints.errors import GO_ON
from exceptiondrive_schemas.printable import counted, printable


def run(
    stage: Annotated[str, typer.Argument(help="screen, edit or review.")],
    workshop: WorkshopFolder = Path(),
    only_plan: Annotated[
        bool, typer.Option("--dry-run", help="Say what it would take, and ask nothing.")
    ] = False,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Take only this many candidates.")
    ] = None,
    json: Json = False,
) -> None:
    """Ask a model about every candidate that waits for a stage.

    The same command goes on after an interruption and pays for no answer twice. A second run at the
    same stage of the same workshop is refused while one goes on.
    """
    if stage not in STAGES:
        raise typer.BadParameter(f"expected one of {', '.join(STAGES)}", param_hint="STAGE")
    with Workshop(workshop) as opened:
        if not opened.keyframes:
            advice = "Read some in: exceptiondrive-build scenes read SOURCE"
            raise BuildError(f"{workshop}: there are no scenes to ask about.", advice)
        asked = STAGES[stage](opened)
        if only_plan:
            plan = dry_run(asked, walk(opened), limit)
            typer.echo(plan.model_dump_json(indent=2) if json else plan_text(plan))
            return
        try:
            report = run_stage(asked, limit)
        except KeyboardInterrupt:
            typer.echo(f"\nexceptiondrive-build: Interrupted. {GO_ON}", err=True)
            raise
    typer.echo(report.model_dump_json(indent=2) if json else report_text(report))
    if report.is_unreachable:
        raise typer.Exit(5)
    if report.is_in_vain:
        raise typer.Exit(2)


def localize_command(
    detections: Annotated[
        Path | None,
        typer.Option(
            help="A detector's file: corners by sample id in metres of the ego frame, or boxes of "
            "nuScenes results. The box nearest to the target is proposed."
        ),
    ] = None,
    by_hand: Annotated[
        bool,
        typer.Option("--by-hand", help="Propose a rectangle at the target, to be moved by people."),
    ] = False,
    workshop: WorkshopFolder = Path(),
    json: Json = False,
) -> None:
    """Propose a region for every edit that is accepted, or waits for a person who may accept it.

    A detector's file is JSON by sample id, or by keyframe id for all its samples, in one of two forms:
    metres of the ego frame, x ahead, y left; or boxes of nuScenes results, in its global frame.

    \b
    {"ID": [{"corners": [[x, y], [x, y], [x, y], [x, y]], "score": 0.9}]}
    {"results": {"ID": [{"translation": [x, y, z], "size": [width, length, height],
                         "rotation": [w, x, y, z], "detection_score": 0.9}]}}
    """  # noqa: D301 - a mark of click: lines that follow stay as they are
    if (detections is None) != by_hand:
        raise typer.BadParameter("give either --detections FILE or --by-hand")
    with Workshop(workshop) as opened:
        report = localize(opened, detections) if detections else localize_by_hand(opened)
    if json:
        typer.echo(report.model_dump_json(indent=2))
        return
    typer.echo(f"proposed     {report.proposed:,}, as before {report.unchanged:,}")
    for why, count in report.without.items():
        typer.echo(f"  without    {count:,} {why}")


def plan_text(plan: StagePlan) -> str:
    """Return a plan as text."""
    basis = f"measured on {counted(plan.timed_calls, 'call')}" if plan.timed_calls else "guessed"
    lines = [
        f"stage        {plan.stage}",
        f"candidates   {plan.candidates:,} wait, {plan.not_ready:,} may follow from earlier stages",
        f"calls        {plan.calls:,}, with {counted(plan.pictures, 'picture')}",
        f"time         {plan.hours:.2f} h ({basis})",
    ]
    if plan.cost is not None:
        lines.append(f"cost         {plan.cost:.2f} {plan.currency} ({basis})")
    return "\n".join(lines)


def report_text(report: StageReport) -> str:
    """Return a report as text."""
    lines = [
        f"stage        {report.stage}",
        f"decided      {report.decided:,}, still open {report.still_open:,}",
        f"  recorded   {report.recorded_without_answer:,} as without a usable answer",
        *(f"  failed     {count:,} {reason}" for reason, count in report.failed.items()),
        *(f"    {key}: {why}" for key, why in report.first_failures.items()),
        f"calls        {report.calls:,}, requests {report.requests:,}",
        f"tokens       {report.prompt_tokens:,} in, {report.completion_tokens:,} out",
        f"time         {report.seconds:.1f} s",
    ]
    if report.cost is not None:
        lines.append(f"cost         {report.cost:.4f} {report.currency}")
    return printable("\n".join(lines))
