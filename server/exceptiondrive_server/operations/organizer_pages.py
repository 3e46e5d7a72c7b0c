"""The first page of the organizers: what needs attention."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_records.operations.dashboard import Attention, LaneQueue, WorkerSign, attention
from exceptiondrive_records.rescoring.views import run_view
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import list_teams
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.rescoring import RunView
from exceptiondrive_server.rescoring.steps import RunLine, run_line
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    duration_words,
    organizer_page,
)

# What the overview says: the list of what waits, the queue of each lane, the workers.


_LANE_TITLES = {Lane.LIVE: "Fresh submissions", Lane.RESCORE: "Rescoring"}
_SLOW_S = 300.0
"""A fresh submission that has waited longer than this is worth a look."""


@dataclass(frozen=True)
class Task:
    """Something that an organizer should look at; `level` is bad, warn or ok."""

    words: str
    url: str
    link_words: str
    level: str


@dataclass(frozen=True)
class LaneCard:
    """The queue of one lane in words."""

    title: str
    waiting: int
    words: str
    is_slow: bool


@dataclass(frozen=True)
class WorkerLine:
    """One worker."""

    name: str
    lanes: str
    slots: int
    seen: str
    is_alive: bool


@dataclass(frozen=True)
class OverviewPage:
    """Everything that `overview.html` needs."""

    tasks: tuple[Task, ...]
    lanes: tuple[LaneCard, ...]
    n_alive: int
    n_slots: int
    n_received_today: int
    workers: tuple[WorkerLine, ...]
    runs: tuple[RunLine, ...]
    pending: tuple[Team, ...]
    failed: tuple[tuple[Submission, str], ...]


def overview_view(
    found: Attention, *, runs: Sequence[RunView], team_names: Mapping[int, str]
) -> OverviewPage:
    """Set the overview."""
    alive = [worker for worker in found.workers if worker.is_alive]
    return OverviewPage(
        tasks=tuple(_tasks(found, runs)),
        lanes=tuple(_lane(queue) for queue in found.queue),
        n_alive=len(alive),
        n_slots=sum(worker.slots for worker in alive),
        n_received_today=found.n_received_today,
        workers=tuple(_worker(worker) for worker in found.workers),
        runs=tuple(run_line(run) for run in runs),
        pending=found.pending,
        failed=tuple((one, team_names[one.team_id]) for one in found.failed),
    )


def _tasks(found: Attention, runs: Sequence[RunView]) -> list[Task]:
    """What to do, worst first."""
    tasks = []
    if not any(worker.is_alive for worker in found.workers):
        words = "No worker is alive: nothing is scored. Start one; nothing is lost meanwhile."
        tasks.append(Task(words, "#workers", "See the workers", "bad"))
    if found.n_failed:
        words = f"{counted(found.n_failed, 'submission')} failed by our own fault."
        tasks.append(Task(words, "/organize/submissions?status=failed", "Look and retry", "bad"))
    if found.pending:
        verb = "waits" if len(found.pending) == 1 else "wait"
        words = f"{counted(len(found.pending), 'team')} {verb} for your approval."
        tasks.append(Task(words, "/organize/teams?show=pending", "Look at them", "warn"))
    for queue in found.queue:
        if queue.lane is Lane.LIVE and (queue.oldest_s or 0) > _SLOW_S:
            words = f"A fresh submission has waited for {duration_words(queue.oldest_s or 0)}."
            tasks.append(Task(words, "#queue", "See the queue", "warn"))
    for run in runs:
        line = run_line(run)
        link = f"/organize/rescoring/{run.id}"
        tasks.append(
            Task(f"Rescoring of {run.phase}: {line.next_words}", link, "See the run", "warn")
        )
    return tasks


def _lane(queue: LaneQueue) -> LaneCard:
    parts = [f"{queue.running} running"]
    if queue.held:
        parts.append(f"{queue.held} held by a paused run")
    if queue.oldest_s is not None:
        parts.append(f"the oldest waits for {duration_words(queue.oldest_s)}")
    is_slow = queue.lane is Lane.LIVE and (queue.oldest_s or 0) > _SLOW_S
    return LaneCard(_LANE_TITLES[queue.lane], queue.waiting, ", ".join(parts), is_slow)


def _worker(worker: WorkerSign) -> WorkerLine:
    return WorkerLine(
        name=worker.worker_id,
        lanes=", ".join(worker.lanes),
        slots=worker.slots,
        seen=f"{duration_words(worker.age_s)} ago",
        is_alive=worker.is_alive,
    )


router = APIRouter(include_in_schema=False)


@router.get("/organize")
def show_overview(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """Show what waits for an organizer, the queue, and the workers."""
    with services.database.read() as session:
        found = attention(session)
        content = overview_view(
            found,
            runs=tuple(run_view(session, run) for run in found.open_runs),
            team_names={team.id: team.name for team in list_teams(session)},
        )
    return organizer_page(
        request, browser, "operations/organizer_overview.html", "overview", page=content
    )
