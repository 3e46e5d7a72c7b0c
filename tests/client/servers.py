"""A server with canned answers, and a real one."""

import json
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.testing import CliRunner

from exceptiondrive import Client
from exceptiondrive.cli import app

if TYPE_CHECKING:
    from exceptiondrive_worker.context import WorkerContext


STRAIGHT = [[4.0 * step, 0.0] for step in range(1, 7)]
SPLIT = {
    "schema": "exceptiondrive.split/1",
    "name": "tiny",
    "title": "Tiny",
    "samples": [
        {
            "sample_id": f"s{number}",
            "scene_id": f"scene-{number // 2}",
            "task": ("SE1", "LB1", "SR1", "IC1")[number],
            "region": [[20.0, -1.0], [22.0, -1.0], [22.0, 1.0], [20.0, 1.0]],
        }
        for number in range(4)
    ],
}
Answer = tuple[int, dict[str, str], bytes]


@dataclass
class CannedServer:
    """A real HTTP server on the loopback that gives set answers, the last one for ever."""

    url: str = ""
    answers: dict[str, list[Answer]] = field(default_factory=dict)
    requests: list[tuple[str, str, bytes]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)

    def answer(
        self, path: str, status: int, document: Any, headers: dict[str, str] | None = None
    ) -> None:
        """Add an answer for `METHOD /path`, to be given once the earlier ones are used."""
        body = document if isinstance(document, bytes) else json.dumps(document).encode()
        self.answers.setdefault(path, []).append((status, headers or {}, body))

    def problem(self, path: str, status: int, code: str, **more: Any) -> None:
        """Add an RFC 9457 problem."""
        document = {
            "type": f"/problems/{code}",
            "title": code,
            "status": status,
            "code": code,
            "detail": more.pop("detail", f"The server says {code}."),
        }
        self.answer(path, status, {**document, **more})

    def take(self, path: str) -> Answer:
        """Return the next answer for a path."""
        waiting = self.answers.get(path) or [(404, {}, b"no such canned answer")]
        return waiting.pop(0) if len(waiting) > 1 else waiting[0]


# The real application, in a thread on the loopback over a SQLite file. The worker's own functions
# run in another thread, in place of Celery, which tests/end_to_end has.
@dataclass
class Running:
    """A server with a phase of each challenge on the tiny split, a team and an organizer."""

    url: str
    token: str
    organizer_token: str
    context: "WorkerContext"

    def client(self) -> Client:
        return Client(self.url, self.token)


def run(
    server: Running, *arguments: object, token: str | None = None, typed: str | None = None
) -> Any:
    """Run a command of the client against the server, without a terminal; for the team unless told."""
    return CliRunner().invoke(
        app,
        [str(argument) for argument in arguments],
        input=typed,
        env={"EXCEPTIONDRIVE_SERVER": server.url, "EXCEPTIONDRIVE_TOKEN": token or server.token},
    )


def submit(server: Running, file: Path, *more: object, method: str = "Planner") -> Any:
    """Submit a file to the planning phase by the command."""
    return run(server, "submit", file, "--phase", "dev", "--method", method, *more)


def fill_records(context: "WorkerContext") -> tuple[str, str]:
    """Make protocol, split, two phases, a team and its token, an organizer and theirs."""
    from tests.support.records import add_phase, found

    from exceptiondrive_records.accounts.tokens import PARTICIPANT_SCOPES
    from exceptiondrive_schemas.protocol import packaged_protocol
    from exceptiondrive_worker.splits.admin import publish_split_file, register_all_splits

    protocol = packaged_protocol()
    with context.database.write() as session:
        tokens = found(session, scopes=PARTICIPANT_SCOPES).tokens
    register_all_splits(context.database, context.splits, protocol)
    publish_split_file(context.database, context.files, context.splits, "tiny", protocol)
    with context.database.write() as session:
        for phase, challenge in (("dev", "planning"), ("words", "strategy")):
            usual: Any = {"title": "Development", "split": "tiny", "quota_per_day": 2}
            add_phase(session, phase, challenge=challenge, **usual)
    return tokens["alpha"], tokens["organizer"]


def work_until(context: "WorkerContext", stop: threading.Event) -> None:
    from tests.support.worker import build_wanted_boards, due_jobs, score_submission

    from exceptiondrive_worker.profile_run import describe_next

    while not stop.wait(0.02):
        for job_id in due_jobs(context.database):
            score_submission(context, job_id)
        build_wanted_boards(context)
        describe_next(context)
