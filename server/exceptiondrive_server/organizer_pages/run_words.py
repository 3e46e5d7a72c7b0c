"""A rescoring run in words: its state, what comes next, how far it is."""

from dataclasses import dataclass

from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.rescoring import Progress, RunState, RunView
from exceptiondrive_server.organizer_pages.durations import duration_words
from exceptiondrive_server.pages.numbers import grouped

_NEXT = {
    RunState.DRAFT: "drafted, nothing is scored until you start it.",
    RunState.SCORING: "scoring in the background.",
    RunState.PAUSED: "paused; resume it when you like.",
    RunState.READY: "ready; look at the preview, then apply it.",
    RunState.APPLIED: "applied; close it, or roll it back.",
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


@dataclass(frozen=True)
class RunLine:
    """A run in a list."""

    id: str
    phase: str
    change: str
    state: str
    tone: str
    next_words: str
    progress_words: str
    share: float
    """Done, from 0 to 1."""
    run: RunView


def run_line(run: RunView) -> RunLine:
    """Return a run as lists show it."""
    return RunLine(
        id=run.id,
        phase=run.phase,
        change=change_words(run),
        state=state_word(run.state),
        tone=_TONE[run.state],
        next_words=_NEXT[run.state],
        progress_words=progress_words(run.progress),
        share=done_share(run.progress),
        run=run,
    )


def state_word(state: RunState) -> str:
    """Return a state as people write it."""
    return state.value.replace("_", " ")


def change_words(run: RunView) -> str:
    """Say what is changed to what: `protocol 1.0 to 1.1`."""
    parts = []
    if run.from_protocol != run.to_protocol:
        parts.append(f"protocol {run.from_protocol.version} to {run.to_protocol.version}")
    if run.from_split != run.to_split:
        parts.append(f"a new revision of {run.to_split.name}")
    return " and ".join(parts)


def done_share(progress: Progress) -> float:
    """Return the share of sheets that are there; an empty phase is done."""
    return progress.done / progress.total if progress.total else 1.0


def progress_words(progress: Progress) -> str:
    """Say how far it is: `120 of 200 sheets, 3 failed, 4.1 a second, about 20 s left`."""
    parts = [f"{grouped(progress.done)} of {counted(progress.total, 'sheet')}"]
    if progress.failed:
        parts.append(f"{grouped(progress.failed)} failed")
    if progress.sheets_per_s is not None:
        parts.append(f"{progress.sheets_per_s:g} a second")
    if progress.remaining_s is not None and progress.done < progress.total:
        parts.append(f"about {duration_words(progress.remaining_s)} left")
    return ", ".join(parts)
