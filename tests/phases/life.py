"""A phase lived through: server, worker and clock."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from starlette.testclient import TestClient
from tests.canary.values import CANARY_M
from tests.support.documents import planning_file, region_ahead, split_document
from tests.support.worker import (
    add_split,
    build_wanted_boards,
    due_jobs,
    score_submission,
)

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.splits.splits import list_splits
from exceptiondrive_schemas.split import Split
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.trial_run import try_next_split

TEAMS = {"alpha": "Alpha Institute", "beta": "Beta Labs", "gamma": "Gamma Works"}
SAMPLES = {
    "a": ("SE1", 10.0, "private"),
    "b": ("LB1", 12.0, "public"),
    "c": ("RS1", 14.0, "private"),
    "d": ("SE1", 16.0, "public"),
    "e": ("LB1", 9.0, "private"),
}
"""The parts alternate: whoever takes the first or the last rows of a part takes wrong ones."""
CAREFUL = dict.fromkeys(SAMPLES, 1.0)
PUBLIC_ONLY = CAREFUL | {"a": 9.0, "c": 9.0, "e": 9.0}
"""Good on the public part, a collision on every private sample."""
PRIVATE_ONLY = CAREFUL | {"b": 9.0, "d": 9.0}
Step = dict[str, Any]
REASON: Step = {"reason": "as announced"}


def split_of(samples: Mapping[str, tuple[str, float, str | None]], name: str) -> Split:
    return split_document(
        {
            key: {
                "scene_id": f"scene-{key}",
                "task": task,
                "region": region_ahead(ahead_m, CANARY_M),
                **({"part": part} if part else {}),
            }
            for key, (task, ahead_m, part) in samples.items()
        },
        name,
    )


@dataclass
class Life:
    """Everything a phase goes through, one call each."""

    worker: WorkerSettings
    context: WorkerContext
    server: ServerSettings
    client: TestClient
    tokens: dict[str, str] = field(default_factory=dict)
    begun: Any = None
    """What the beginning returned."""

    @property
    def database(self) -> Database:
        return self.context.database

    def request(self, method: str, path: str, who: str | None = None, **more: Any) -> Any:
        headers = {} if who is None else {"Authorization": f"Bearer {self.tokens[who]}"}
        return self.client.request(method, path, headers=headers, **more)

    def get(self, path: str, who: str | None = None) -> Any:
        return self.request("GET", path, who)

    def json(self, path: str, who: str | None = None) -> Any:
        answer = self.get(path, who)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def organize(self, path: str, document: Step | None = None, method: str = "POST") -> Any:
        body = REASON if document is None else document
        return self.request(method, f"/api/v1/organizer{path}", "organizer", json=body)

    def done(self, path: str, document: Step | None = None, method: str = "POST") -> Any:
        answer = self.organize(path, document, method)
        assert answer.status_code < 300, answer.text
        return answer.json()

    def refused(self, path: str, document: Step, status: int, method: str = "POST") -> str:
        answer = self.organize(path, document, method)
        assert answer.status_code == status, answer.text
        return str(answer.json()["detail"])

    def make_phase(self, phase_id: str = "test", *, split: str = "parted", **more: Any) -> Any:
        usual = {"challenge": "planning", "title": "Test", "protocol": "1.0", "split": split}
        return self.done(
            "/phases",
            {"id": phase_id, "quota_per_day": 100, "rejected_per_day": 100, **usual, **more},
        )

    def change(self, document: Step, phase_id: str = "test") -> Any:
        return self.done(f"/phases/{phase_id}", document, "PATCH")

    def add_split(self, split: Split) -> None:
        add_split(self.database, self.worker.splits_dir, split)

    def upload(
        self,
        who: str,
        speeds_mps: float | dict[str, float],
        method: str = "Planner",
        split: str = "parted",
        phase: str = "test",
    ) -> Any:
        speeds = speeds_mps if isinstance(speeds_mps, dict) else dict.fromkeys(SAMPLES, speeds_mps)
        content = planning_file(speeds, split=split) + b" " * len(who)
        return self.request(
            "POST",
            "/api/v1/submissions",
            who,
            data={"phase": phase, "method": method},
            files={"file": ("planner.json", content)},
        )

    def submit(self, who: str, speeds_mps: float | dict[str, float], *more: str) -> str:
        answer = self.upload(who, speeds_mps, *more)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def work(self) -> None:
        """Do what reconciler and workers do until nothing is left."""
        while True:
            tend_runs(self.database, 4)
            while try_next_split(self.context):
                pass
            jobs = due_jobs(self.database)
            for job_id in jobs:
                score_submission(self.context, job_id)
            if not jobs and not build_wanted_boards(self.context):
                return

    def now(self) -> datetime:
        with self.database.read() as session:
            return database_now(session)

    def ago(self, minutes: float) -> str:
        return (self.now() - timedelta(minutes=minutes)).isoformat()

    def ahead(self, minutes: float) -> str:
        return self.ago(-minutes)

    def move(self, phase_id: str = "test", **dates: Any) -> None:
        """Let time pass: set dates of the phase as no organizer may."""
        with self.database.write() as session:
            phase = find_phase(session, phase_id)
            for key, value in dates.items():
                if key in ("freezes_at", "families_from"):
                    phase.policy = phase.policy.model_copy(update={key: value})
                else:
                    setattr(phase, key, value)

    def board(self, query: str = "", phase: str = "test") -> Any:
        """The board as anybody reads it, without the references that the worker makes for it."""
        board = self.json(f"/api/v1/leaderboard?phase={phase}{query}")
        board["entries"] = [entry for entry in board["entries"] if entry["submission_id"]]
        return board

    def entry_ids(self, query: str = "") -> list[str]:
        return [entry["submission_id"] for entry in self.board(query)["entries"]]

    def start_run(self, phase: str = "test", **target: str) -> str:
        """Carry a rescoring run until it is ready."""
        run = self.done("/rescoring", {"phase": phase, **target, **REASON})["id"]
        self.done(f"/rescoring/{run}/start")
        self.work()
        assert self.json(f"/api/v1/organizer/rescoring/{run}", "organizer")["state"] == "ready"
        return str(run)

    def reveal(self) -> str:
        """Ask for the private part of the split and score it; return the run that is to be applied."""
        self.done("/phases/test/reveal", {"what": "split", "reason": "the end"})
        self.work()
        run: str = self.json("/api/v1/organizer/rescoring?phase=test", "organizer")[0]["id"]
        return run

    def revisions(self) -> dict[str | None, str]:
        """Revisions of the split by its parts; None is the whole."""
        with self.database.read() as session:
            rows = [row for row in list_splits(session) if row.name == "parted"]
        return {row.part: row.revision for row in rows}

    def apply(self, run: str) -> Any:
        preview = self.json(f"/api/v1/organizer/rescoring/{run}/preview", "organizer")
        done = self.done(f"/rescoring/{run}/apply", {"preview": preview["digest"], **REASON})
        self.work()
        return done


Beginning = tuple[str, Callable[[Life], Any]]
"""A name, and what makes it out of three teams."""
