"""Where a submission stands, in words."""

import math
from dataclasses import dataclass

from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.submission import QueuePlace, SubmissionStatus, SubmissionView

_MEANING = {
    SubmissionStatus.RECEIVED: "Kept. It cannot be lost any more.",
    SubmissionStatus.QUEUED: "A worker has been called.",
    SubmissionStatus.SCORING: "A worker is scoring it.",
    SubmissionStatus.SCORED: "Every sample has been scored.",
    SubmissionStatus.REJECTED: "The file is wrong. It cost no quota; all faults are listed below.",
    SubmissionStatus.FAILED: "We could not score it. It cost no quota; organizers have been told.",
    SubmissionStatus.WITHDRAWN: "Withdrawn. It stands on no board.",
}
STEPS = (
    SubmissionStatus.RECEIVED,
    SubmissionStatus.QUEUED,
    SubmissionStatus.SCORING,
    SubmissionStatus.SCORED,
)


@dataclass(frozen=True)
class Status:
    """A status with its meaning and, while it waits, its place."""

    word: str
    meaning: str
    place: str | None
    is_final: bool


@dataclass(frozen=True)
class Step:
    """A step on the way to a score; `state` is done, now or ahead."""

    word: str
    state: str


def status_of(submission: SubmissionView) -> Status:
    """Return the status in words."""
    return Status(
        word=submission.status.value,
        meaning=_MEANING[submission.status],
        place=place_words(submission.queue) if submission.queue else None,
        is_final=submission.status.is_terminal,
    )


def place_words(queue: QueuePlace) -> str:
    """Say how many stand ahead and how long that may take."""
    if queue.workers_alive == 0:
        return f"{_ahead(queue.position)}; no worker is running right now, it starts when one does"
    if queue.expected_wait_s is None:
        return _ahead(queue.position)
    return f"{_ahead(queue.position)}, {_wait(queue.expected_wait_s)}"


def steps_of(submission: SubmissionView) -> tuple[Step, ...]:
    """Return the way to the end: a file that was not scored ends with what happened to it."""
    status = submission.status
    if status in STEPS:
        now = STEPS.index(status)
        states = ["done" if at < now else "ahead" for at in range(len(STEPS))]
        states[now] = "done" if status.is_terminal else "now"
        return tuple(Step(s.value, state) for s, state in zip(STEPS, states, strict=True))
    return (Step(SubmissionStatus.RECEIVED.value, "done"), Step(status.value, "ended"))


def _ahead(position: int) -> str:
    return "next in line" if position == 0 else f"{counted(position, 'submission')} ahead"


def _wait(seconds: float) -> str:
    if seconds < 1:
        return "no wait expected"
    if seconds < 90:
        return f"about {math.ceil(seconds)} s to wait"
    return f"about {counted(math.ceil(seconds / 60), 'minute')} to wait"
