"""From the first byte of an upload to the published rank, through every real part.

`python -m benchmarks.upload_to_rank` starts the embedded default over a synthetic split of 3,181
samples, uploads ten different full files, and prints how long each took to be on the board. Then it
lets the system idle for a while, uploads forty more without waiting, and prints the CPU time that
each process took for one until nothing is left to do: the whole, and what is above the idle rate.
Heartbeats, the reconciler and polls burn that rate whether files come or not. Before and after, another
process does nothing but the arithmetic of the same files, with the memory of a worker: on a machine that
is slow at the time both are, and their ratio stays.
"""

import gzip
import hashlib
import json
import multiprocessing
import os
import random
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import httpx
from sqlalchemy import select
from tests.support.system import System, running_system

from benchmarks.report import at_most, note, show
from benchmarks.timing import cpu_seconds, typical
from benchmarks.upload import score
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Job, WorkItem
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_worker.process import keep_memory
from exceptiondrive_worker.sample.files import OPEN_FLOORS
from exceptiondrive_worker.splits.floors import FLOORS_FILE
from exceptiondrive_worker.splits.store import load_split, read_split

N_SAMPLES = 3181
PROTOCOL = "1.0"
N_WATCHED, N_IN_A_ROW = 10, 40
IDLE_S = 15.0
TASKS = [
    f"{family}{number}" for family in ("SE", "LB", "BG", "SR", "IC", "RS") for number in (1, 2, 3)
]


def run(_: ProtocolDocument) -> None:
    """Print how long an upload takes to its rank, and what it costs all processes."""
    with tempfile.TemporaryDirectory(prefix="ed-bench-") as folder:
        base = Path(folder)
        texts = (planning_text(number, N_SAMPLES) for number in range(N_WATCHED + N_IN_A_ROW))
        files = [gzip.compress(text, 6) for text in texts]
        with running_bench(base, N_SAMPLES) as (system, token):
            authorization, launcher = {"Authorization": f"Bearer {token}"}, system.launcher.pid
            with httpx.Client(base_url=system.url, headers=authorization, timeout=30) as http:
                times_s = [_upload_to_rank_s(http, data) for data in files[:N_WATCHED]]
                records = Database(_records_url(base))
                _wait_until_all_is_done(records)
                idle = _cpu_while(launcher, lambda: time.sleep(IDLE_S))
                in_a_row = files[N_WATCHED:]
                before = arithmetic_s(base, in_a_row)
                uploads = _cpu_while(launcher, lambda: _upload_all(http, in_a_row, records))
                arithmetic = before + arithmetic_s(base, in_a_row)
                records.dispose()
    _report_times(times_s)
    _report_cpu(idle, uploads, 1000 * typical(arithmetic))


@contextmanager
def running_bench(base: Path, n_samples: int) -> Iterator[tuple[System, str]]:
    """Run the embedded default over a split of its own with an open phase, `bench`; and a team's token."""
    _write_split(_split_file(base), n_samples)
    with running_system(base / "data", base / "splits") as system:
        system.work("register-splits")
        limits = ("--quota-total", "none", "--rejected-per-day", "50")
        system.open_phase("bench", "bench", "--protocol", PROTOCOL, *limits)
        yield system, system.make_team("bench")


def arithmetic_s(base: Path, files: list[bytes]) -> list[float]:
    """CPU seconds of parsing, measuring and grading each file, in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, initializer=keep_memory) as process:
        return process.submit(_arithmetic_s, _split_file(base), files).result()


def _arithmetic_s(split_file: Path, files: list[bytes]) -> list[float]:
    protocol = packaged_protocol(PROTOCOL)
    split = load_split(read_split(split_file), protocol)
    jobs = [partial(score, data, split.manifest, split.arrays, protocol) for data in files]
    jobs[0]()
    return [cpu_seconds(job) for job in jobs]


class Spent(NamedTuple):
    """CPU seconds of each process by the name of its program, and how long the clock ran meanwhile."""

    cpu_s: dict[str, float]
    took_s: float


def _cpu_while(launcher: int, happens: Callable[[], None]) -> Spent:
    before, started = cpu_by_process_s(launcher), time.perf_counter()
    happens()
    took_s, after = time.perf_counter() - started, cpu_by_process_s(launcher)
    return Spent({name: after[name] - before.get(name, 0.0) for name in after}, took_s)


def _upload_all(http: httpx.Client, files: list[bytes], records: Database) -> None:
    for data in files:
        _upload(http, data)
    _wait_until_all_is_done(records)


def _wait_until_all_is_done(records: Database) -> None:
    """Wait until every file is scored and stands on a board; no server is asked."""
    kinds = [kind.__mapper__.polymorphic_identity for kind in (Job, BoardRequest)]
    is_open = WorkItem.kind.in_(kinds) & WorkItem.state.in_(OPEN_STATES)
    while True:
        with records.read() as session:
            if session.scalar(select(WorkItem.id).where(is_open).limit(1)) is None:
                return
        time.sleep(0.05)


def cpu_by_process_s(launcher: int) -> dict[str, float]:
    """CPU seconds so far of all processes below this one, by the name of their program."""
    parents, seconds = {}, {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
            words = (entry.parent / "cmdline").read_text().split("\0")
        except OSError:  # it has ended
            continue
        process = int(entry.parent.name)
        parents[process] = int(fields[1])
        ticks = int(fields[11]) + int(fields[12])
        seconds[process] = (_program(words), ticks / os.sysconf("SC_CLK_TCK"))
    found: dict[str, float] = {}
    for process, (name, spent_s) in seconds.items():
        above = process
        while above in parents and above != launcher:
            above = parents[above]
        if above == launcher:
            found[name] = found.get(name, 0.0) + spent_s
    return found


def _program(words: list[str]) -> str:
    if "postgres" in words[0]:
        return "database"
    known = {"serve": "server", "reconcile": "reconciler", "run": "workers"}
    known |= {"benchmarks.latency": "proxies"}
    return next((known[word] for word in words if word in known), "broker")


def _report_cpu(idle: Spent, uploads: Spent, arithmetic_ms: float) -> None:
    """Print what one upload cost, in ms; CPU is told to a hundredth of a second by the system."""
    rows, above_ms = [], 0.0
    for name in (*sorted(uploads.cpu_s), "together"):
        whole_s, idle_s = (_cpu_of(name, spent) for spent in (uploads, idle))
        idle_rate = idle_s / idle.took_s
        whole_ms = 1000 * whole_s / N_IN_A_ROW
        above_ms = whole_ms - 1000 * idle_rate * uploads.took_s / N_IN_A_ROW
        rows.append((name, f"{whole_ms:.0f}", f"{above_ms:.0f}", f"{1000 * idle_rate:.0f}"))
    title = f"CPU of one of {N_IN_A_ROW} uploads in a row, ms"
    show(title, ("", "whole", "above idle", "idle, ms a second"), rows)
    note(f"{N_IN_A_ROW} uploads were done in {uploads.took_s:.1f} s")
    note(f"parsing, measuring and grading one of them by itself takes {arithmetic_ms:.1f} ms")
    at_most("an upload, all processes, above idle", above_ms, 50, "ms of CPU")
    at_most("the same", above_ms / arithmetic_ms, 3, "x its own arithmetic")


def _cpu_of(name: str, spent: Spent) -> float:
    return sum(spent.cpu_s.values()) if name == "together" else spent.cpu_s.get(name, 0.0)


def _report_times(times_s: list[float]) -> None:
    median_s = statistics.median(times_s)
    note(
        f"upload to published rank, {N_SAMPLES:,} samples, {N_WATCHED} uploads on {os.cpu_count()} "
        f"cores: median {median_s:.2f} s, fastest {min(times_s):.2f} s, slowest {max(times_s):.2f} s"
    )
    at_most("upload to published rank, median", median_s, 3, "s")


def _upload_to_rank_s(http: httpx.Client, data: bytes) -> float:
    started = time.perf_counter()
    submission_id = _upload(http, data)
    while not _is_ranked(http, submission_id):
        time.sleep(0.02)
    return time.perf_counter() - started


def _upload(http: httpx.Client, data: bytes) -> str:
    """Upload a file as a method of its own; return the id of the submission."""
    answer = http.post(
        "/api/v1/submissions",
        data={"phase": "bench", "method": f"Planner {hashlib.sha256(data).hexdigest()[:8]}"},
        files={"file": ("planner.json.gz", data)},
    )
    answer.raise_for_status()
    return str(answer.json()["id"])


def _is_ranked(http: httpx.Client, submission_id: str) -> bool:
    answer = http.get("/api/v1/leaderboard", params={"phase": "bench"})
    if answer.status_code == 404:
        return False
    return any(
        entry["submission_id"] == submission_id and entry["rank"] is not None
        for entry in answer.json()["entries"]
    )


def planning_text(number: int, n_samples: int) -> bytes:
    """Return a submission to such a phase, another one for each number."""
    rng = random.Random(1000 + number)
    document = {
        "schema": "exceptiondrive.planning/1",
        "split": "bench",
        "predictions": [
            {"sample_id": _sample_id(i), "source": _path(rng), "edited": _path(rng)}
            for i in range(n_samples)
        ],
    }
    return json.dumps(document).encode()


def _path(rng: random.Random) -> list[list[float]]:
    speed_mps, curvature = rng.uniform(2, 12), rng.gauss(0, 0.01)
    ahead = [speed_mps * 0.5 * step for step in range(1, 7)]
    return [[round(x, 4), round(curvature * x * x / 2, 4)] for x in ahead]


def _write_split(target: Path, n_samples: int) -> None:
    rng = random.Random(7)
    samples = []
    for i in range(n_samples):
        x, y = rng.uniform(6, 30), rng.gauss(0, 2.5)
        region = [[x, y - 0.8], [x + 2, y - 0.8], [x + 2, y + 0.8], [x, y + 0.8]]
        samples.append(
            {
                "sample_id": _sample_id(i),
                "scene_id": f"scene-{i % 150:04d}",
                "task": TASKS[i % len(TASKS)],
                "region": [[round(a, 3), round(b, 3)] for a, b in region],
            }
        )
    document = {
        "schema": "exceptiondrive.split/1",
        "name": "bench",
        "title": "Synthetic split",
        "samples": samples,
    }
    target.parent.mkdir(parents=True)
    target.with_name(FLOORS_FILE).write_text(OPEN_FLOORS)
    target.write_bytes(gzip.compress(json.dumps(document).encode()))


def _sample_id(number: int) -> str:
    return f"{number:08x}e823ae8f040e2b3306002c57"


def _split_file(base: Path) -> Path:
    return base / "splits" / "bench" / "split.json.gz"


def _records_url(base: Path) -> str:
    return f"sqlite:///{base}/data/records.sqlite3"


if __name__ == "__main__":
    run(packaged_protocol())
