"""The steps of the drill: fresh submissions alone, then two updates from draft to rollback."""

import json
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

from sqlalchemy import func, select
from tests.chaos.topology import Topology

from benchmarks.rescore_drill.clients import Clients, short_digest
from benchmarks.rescore_drill.report import Report
from benchmarks.rescore_drill.verdict import demand
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml, parse_protocol

ALLOWED_RATIO = 2.0
"""A run may double the waiting time of fresh submissions, and no more."""


@dataclass(frozen=True)
class Waits:
    """Seconds from upload to score, and of these until a worker last took the job, by submission."""

    to_score_s: tuple[float, ...]
    to_worker_s: tuple[float, ...]

    def __str__(self) -> str:
        score, worker = median(self.to_score_s), median(self.to_worker_s)
        return f"{score:.2f} s (max {max(self.to_score_s):.2f}), {worker:.2f} s for a worker"


def waits_of(database: Database, ids: list[str]) -> Waits:
    """Return the waits of these submissions."""
    query = (
        select(Submission.received_at, Submission.status_at, Job.leased_at)
        .join(Job, (Job.submission_id == Submission.id) & Job.is_first)
        .where(Submission.id.in_(ids))
    )
    with database.read() as session:
        rows = session.execute(query).all()
    return Waits(
        tuple((scored - received).total_seconds() for received, scored, _ in rows),
        tuple((leased - received).total_seconds() for received, _, leased in rows if leased),
    )


def ratio(with_run: Waits, without: Waits) -> float:
    """Return how many times as long the median submission waits."""
    return median(with_run.to_score_s) / median(without.to_score_s)


N_FRESH = 24
PAUSE_S = (0.25, 0.6)
KILL_AFTER_EVERY = 8
SEED = 20261121
UPDATES = {
    "d_safe": ("1.0.1", "d_safe_m = 2.0", "d_safe_m = 2.5"),
    "geometry": ("1.0.2", "footprint_width_m = 1.85", "footprint_width_m = 1.95"),
}
"""Name of the update: version, and the line of protocol 1.0 that it replaces."""
N_STAGES = 4 + 5 * len(UPDATES) + 1


def protocol_of(name: str) -> tuple[str, ProtocolDocument]:
    """Return the document of an update, as text and parsed."""
    version, old_line, new_line = UPDATES[name]
    toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
    toml = toml.replace(old_line, new_line, 1)
    return toml, parse_protocol(toml)


@dataclass
class Drill:
    """One drill on one database."""

    topology: Topology
    clients: Clients
    report: Report
    n_killed: int = 0
    slow: list[str] = field(default_factory=list)
    """Sentences of waits that were too long; judged at the end, so that the table is whole."""

    def first_scores(self, n_submissions: int) -> None:
        """Score what waits, and build the first board."""
        self.report.stage("first scores")
        began = time.monotonic()
        self.wait(lambda: self._n_scored() == n_submissions, "first scores", self._n_scored)
        self.report.say("first scoring of all", f"{time.monotonic() - began:.0f} s")
        self.report.stage("first board")
        self.wait(lambda: self.clients.n_entries() == n_submissions, "the first board")

    def alone(self) -> dict[str, Waits]:
        """Submit fresh files while no run is on: calm, then with workers killed."""
        found = {}
        for name, kills in (("calm", False), ("killed", True)):
            self.report.stage(f"fresh submissions, no run, {name}")
            found[name] = self._fresh(f"alone-{name}", kills=kills)
            self.report.say(f"fresh: median wait to score, no run, {name}", found[name])
        return found

    def update(self, name: str, alone: dict[str, Waits]) -> None:
        """Carry one update from draft to apply to rollback, and compare the board's bytes."""
        toml, protocol = protocol_of(name)
        self.clients.add_protocol(toml)
        run = self.clients.draft(protocol.version)
        run_id = run["id"]
        self.report.say(f"{name}: difference", run["difference"]["sentence"])
        before, began = self.clients.board(), time.monotonic()
        self.clients.step(run_id, "start")
        for kind, kills in (("calm", False), ("killed", True)):
            self.report.stage(f"{name}: fresh submissions during the run, {kind}")
            waits = self._fresh(f"{name}-{kind}", kills=kills)
            times = ratio(waits, alone[kind])
            self.report.say(f"{name}: median wait during the run, {kind}", f"{waits}: {times:.2f}x")
            if times > ALLOWED_RATIO:
                self.slow.append(f"{name}, {kind}: {times:.2f} times as long as without a run")
            if kind == "calm":
                self.report.say(f"{name}: sheets done by then", self._standing(run_id))
        self._ready(run_id, name)
        self.report.say(f"{name}: draft to ready", f"{time.monotonic() - began:.0f} s")
        same = json.loads(before)["protocol"] == json.loads(self.clients.board())["protocol"]
        demand(same, "the public board changed its protocol before apply")
        self.report.stage(f"{name}: apply and roll back")
        self._flip(run_id, name)

    def cover_all(self) -> list[ProtocolDocument]:
        """Run to each version once more: only what came since is missing, and is made."""
        self.report.stage("a second run to each version")
        protocols = []
        for name in UPDATES:
            protocol = protocol_of(name)[1]
            run = self.clients.draft(protocol.version)
            had = run["progress"]["done"]
            self.clients.step(run["id"], "start")
            self._ready(run["id"], f"{name} again")
            done = self.clients.run(run["id"])["progress"]
            self.clients.step(run["id"], "cancel")
            made = done["done"] - had
            self.report.say(f"{name}: a second run makes only what is missing", f"{made} sheets")
            protocols.append(protocol)
        return protocols

    def wait(
        self,
        question: Callable[[], object],
        what: str,
        count: Callable[[], object] | None = None,
        timeout_s: float = 900,
    ) -> None:
        """Wait until a question is answered with yes."""
        deadline = time.monotonic() + timeout_s
        while not question():
            if time.monotonic() > deadline:
                raise RuntimeError(f"waited {timeout_s:g} s in vain for {what}")
            if count is not None:
                self.report.standing(f"{what}: {count()}")
            time.sleep(0.2)

    def _ready(self, run_id: str, name: str) -> None:
        self.report.stage(f"{name}: until it is ready")
        n_entries = self.clients.n_submitted
        self.wait(lambda: self.clients.n_entries() == n_entries, "fresh ones on the board")

        def may_be_applied() -> bool:
            run = self.clients.run(run_id)
            return run["state"] == "ready" and not run["blockers"]

        self.wait(may_be_applied, f"{name} to be ready", lambda: self._standing(run_id))

    def _flip(self, run_id: str, name: str) -> None:
        old = self.clients.board()
        preview = self.clients.organize("GET", f"/rescoring/{run_id}/preview")
        began = time.monotonic()
        self.clients.step(run_id, "apply", preview=preview["digest"])
        applied_s, new = time.monotonic() - began, self.clients.board()
        began = time.monotonic()
        self.clients.step(run_id, "rollback")
        back_s, again = time.monotonic() - began, self.clients.board()
        board = preview["comparison"]["new_board"]
        demand(json.loads(new)["board"] == board, "apply showed another board than the previewed")
        demand(new != old, "apply changed nothing")
        demand(again == old, "rollback did not give the earlier bytes")
        numbers = preview["comparison"]["n_numbers_changed"]
        self.report.say(f"{name}: entries with new numbers", f"{numbers}")
        self.report.say(f"{name}: apply, rollback", f"{applied_s:.2f} s, {back_s:.2f} s")
        three = " -> ".join(short_digest(body) for body in (old, new, again))
        self.report.say(f"{name}: board before -> applied -> rolled back", three)

    def _fresh(self, prefix: str, *, kills: bool) -> Waits:
        """Submit one at a time, with random kills between if wanted, and wait for all scores.

        Pauses and kills are the same each time, so that waits differ by the run alone.
        """
        ids, chance = [], random.Random(SEED)
        for number in range(N_FRESH):
            ids.append(self.clients.submit(f"{prefix}-{number}"))
            time.sleep(chance.uniform(*PAUSE_S))
            if kills and number % KILL_AFTER_EVERY == KILL_AFTER_EVERY - 2:
                self.n_killed += self._kill_a_worker(chance)
        self.wait(lambda: self._n_scored(ids) == len(ids), f"{prefix} to be scored")
        return waits_of(self.topology.database, ids)

    def _kill_a_worker(self, chance: random.Random) -> int:
        """SIGKILL a whole worker, or only its scoring processes; return how many were killed."""
        worker = self.topology.workers[chance.randrange(len(self.topology.workers))]
        if chance.random() < 0.5:
            worker.kill_group()
            worker.start()  # at once: how long a supervisor waits is not what is measured
            return 1
        return worker.kill_children()

    def _n_scored(self, ids: list[str] | None = None) -> int:
        query = select(func.count()).where(Submission.status == SubmissionStatus.SCORED)
        if ids is not None:
            query = query.where(Submission.id.in_(ids))
        with self.topology.database.read() as session:
            return session.scalar(query) or 0

    def _standing(self, run_id: str) -> str:
        run = self.clients.run(run_id)
        return f"{run['progress']['done']} of {run['progress']['total']}, {run['state']}"
