"""A rescoring run in words, and its steps as data: effect and button label of each."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

from sqlalchemy.orm import Session

from exceptiondrive_records.phases.phases import titles_of_phases
from exceptiondrive_records.rescoring import changes, flip
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.views import preview_of, run_view
from exceptiondrive_records.splits.splits import newly_counted
from exceptiondrive_schemas.api.rescoring import (
    Comparison,
    PublicRun,
    RunAction,
    RunState,
    RunView,
)
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import Step

_NEXT = {
    RunState.DRAFT: "drafted; nothing is scored until you start it.",
    RunState.SCORING: "scoring in the background.",
    RunState.PAUSED: "paused; resume it when you like.",
    RunState.READY: "ready; look at the preview, then apply it.",
    RunState.APPLIED: "applied; close it, or, unless the board is frozen, roll it back.",
    RunState.CLOSED: "closed; the new protocol stays.",
    RunState.ROLLED_BACK: "rolled back.",
    RunState.CANCELLED: "cancelled; the public board never changed.",
}
_TONE = {
    RunState.DRAFT: "received",
    RunState.SCORING: "scoring",
    RunState.PAUSED: "queued",
    RunState.READY: "ready",
    RunState.APPLIED: "scored",
    RunState.CLOSED: "scored",
    RunState.ROLLED_BACK: "withdrawn",
    RunState.CANCELLED: "withdrawn",
}


MOST_SENTENCES = 8


@dataclass(frozen=True)
class RunLine:
    """A run in words, as lists and its own page show it."""

    run: RunView
    change: str
    """What is changed to what: `protocol 1.0 to 1.1`."""
    state: str
    tone: str
    next_words: str
    share: float
    """Sheets that are there, from 0 to 1; an empty phase is done."""


def run_line(session: Session, run: RunView) -> RunLine:
    """Return a run in words."""
    progress = run.progress
    return RunLine(
        run=run,
        change=change_words(session, run) or "verification of sheets",
        state=run.state.value.replace("_", " "),
        tone=_TONE[run.state],
        next_words=_next_words(run),
        share=progress.done / progress.total if progress.total else 1.0,
    )


def change_words(session: Session, run: RunView | PublicRun) -> str:
    """Return what a run changes to what: `protocol 1.0 to 1.1`; empty for a verification."""
    changes = []
    if run.from_protocol != run.to_protocol:
        changes.append(f"protocol {run.from_protocol.version} to {run.to_protocol.version}")
    if run.from_split != run.to_split:
        which = newly_counted(session, run.from_split, run.to_split)
        what = f"reveal of {which}" if which else "another revision"
        changes.append(f"{what} of {run.to_split.name}")
    return " and ".join(changes)


def _next_words(run: RunView) -> str:
    """Say what can be done next."""
    is_refused = run.trial is not None and run.trial.state == "refused"
    if run.state is RunState.DRAFT and is_refused:
        return "drafted, but it cannot be started: cancel it."
    if run.state is RunState.DRAFT and run.trial is not None and run.trial.state == "held":
        return "drafted, but the floors of its split forbid it."
    if run.state is RunState.READY and run.blockers:
        return "ready, but something prevents applying it."
    return _NEXT[run.state]


@dataclass(frozen=True)
class RunStep:
    """A step of a run."""

    key: RunAction
    button: str
    title: str
    meaning: str
    done: str
    take: Callable[..., RescoringRun]
    command: str
    is_main: bool = False
    is_grave: bool = False
    needs_preview: bool = False
    is_flip: bool = False
    """Moves the pointer to what readers see."""

    def in_a_terminal(self, run_id: str, preview: str) -> str:
        """Return the command that takes this step of a run, of a flip with the preview that was seen."""
        seen = f" --preview {preview}" if self.needs_preview and preview else ""
        return f'exceptiondrive organizer rescore {self.command} {run_id}{seen} --reason "…"'


RUN_STEPS: Mapping[str, RunStep] = {
    step.key: step
    for step in (
        RunStep(
            RunAction.START,
            "Start scoring",
            "Start scoring",
            "Workers score in the background, behind fresh submissions. "
            "The public board does not change.",
            "run_started",
            changes.start_run,
            "begin",
            is_main=True,
        ),
        RunStep(
            RunAction.PAUSE,
            "Pause",
            "Pause the run",
            "No further sheet is started; those in progress are finished.",
            "run_paused",
            changes.pause_run,
            "pause",
        ),
        RunStep(
            RunAction.RESUME,
            "Resume",
            "Resume the run",
            "Scoring continues, and failed sheets are tried again.",
            "run_resumed",
            changes.resume_run,
            "resume",
            is_main=True,
        ),
        RunStep(
            RunAction.APPLY,
            "Apply",
            "Apply the run",
            "All at once, every reader sees the new board, and the teams whose numbers change are "
            "told. While the phase is hidden, only organizers see that board, and teams are told when it "
            "is shown. You can roll back until you close the run.",
            "run_applied",
            flip.apply_run,
            "apply",
            is_main=True,
            is_grave=True,
            needs_preview=True,
            is_flip=True,
        ),
        RunStep(
            RunAction.ROLLBACK,
            "Roll back",
            "Roll back",
            "Readers see the board under the earlier protocol again, with everything scored since, even "
            "what a freeze had hidden; the teams whose numbers change are told. While the phase is hidden, "
            "only organizers see that board and nobody is told.",
            "run_rolled_back",
            flip.rollback_run,
            "rollback",
            is_grave=True,
            is_flip=True,
        ),
        RunStep(
            RunAction.CLOSE,
            "Close",
            "Close the run",
            "The new protocol stays: fresh submissions are scored only under it, and the run "
            "can no longer be rolled back.",
            "run_closed",
            changes.close_run,
            "close",
            is_grave=True,
        ),
        RunStep(
            RunAction.CANCEL,
            "Cancel",
            "Cancel the run",
            "The run ends here. The public board never changed, and sheets already made are kept.",
            "run_cancelled",
            changes.cancel_run,
            "cancel",
            is_grave=True,
        ),
    )
}


def offered(run: RunView) -> tuple[RunStep, ...]:
    """Return the steps that a run offers as it is now: those of its actions that change something."""
    steps = []
    for action in run.actions:
        step = RUN_STEPS[action]
        if action is RunAction.RESUME and run.state is not RunState.PAUSED:
            if not run.progress.failed:
                continue
            step = replace(step, button="Try failed sheets again", is_main=False)
        steps.append(step)
    return tuple(steps)


def page_of_step(session: Session, step: RunStep, run_id: str, preview: str) -> Step:
    """Return the page that asks for a step; `preview` is the digest of the one that was looked at."""
    run = find_run(session, run_id)
    seen = run_view(session, run)
    here = f"/organize/rescoring/{run_id}"
    given = {"preview": preview} if step.needs_preview else {}
    shown = preview_of(session, run_id) if step.is_flip and seen.preview else None
    blockers = flip.obstacles(session, run, step.key) if step.is_flip else ()
    is_stale = step.needs_preview and not blockers and preview != seen.preview
    comparison = None if shown is None else shown.comparison
    facts = [*_facts(run_line(session, seen), titles_of_phases(session)[seen.phase], comparison)]
    if shown is not None and shown.warnings:
        facts.append(("Ends for good", shown.warnings))
    if step.needs_preview and preview:
        facts.append(("Preview", preview))
    return Step(
        section="rescoring",
        title=step.title,
        meaning=step.meaning,
        button=step.button,
        back=f"{here}/preview" if step.needs_preview else here,
        back_words="The preview" if step.needs_preview else "The run",
        fields=(REASON,),
        facts=tuple(facts),
        command=step.in_a_terminal(run_id, preview),
        is_grave=step.is_grave,
        blockers=(flip.STALE,) if is_stale else blockers,
        take=partial(step.take, run_id=run_id, **given),
        done=step.done,
        onward=lambda _: here,
    )


def _facts(
    line: RunLine, phase_title: str, comparison: Comparison | None
) -> Iterator[tuple[str, str | tuple[str, ...]]]:
    sentences = line.run.difference.sentences
    shown = sentences[:MOST_SENTENCES]
    left_out = len(sentences) - len(shown)
    yield "Run", line.change
    yield "Phase", phase_title
    if shown:
        yield "Changes", (*shown, f"and {left_out} more") if left_out else shown
    yield "Sheets", line.run.progress.words
    if comparison is not None:
        of_all = f"{comparison.n_numbers_changed:,} of "
        of_all += counted(comparison.n_entries, "entry", "entries")
        words = f"{of_all} with other numbers, {comparison.n_ranks_changed:,} with another rank"
        failing = comparison.n_newly_failing
        yield "Readers see", f"{words}, {failing:,} no longer ranked" if failing else words
        if failing:
            lost = comparison.no_longer_ranked
            named = [
                f"{one.method}: {lost[one.submission_id]}"
                for one in comparison.entries
                if one.submission_id in lost
            ][:MOST_SENTENCES]
            more = [f"and {failing - len(named):,} more"] if failing > len(named) else []
            yield "No longer ranked", (*named, *more)
