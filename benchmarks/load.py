"""A deadline rush: `python -m benchmarks.load [--uploads 500] [--minutes 2]`.

Real processes, full-size files of many teams whose arrivals thicken towards the deadline, one team
that floods the queue first, and readers that look at page and board all the while.
"""

import argparse
import gzip
import heapq
import json
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from statistics import median, quantiles

import httpx
from sqlalchemy import select
from tests.chaos.topology import PHASE, Topology

from benchmarks.report import CONSOLE, note, show
from exceptiondrive_records.invariants import unfinished, violations
from exceptiondrive_records.tables import Job, Submission, Team
from exceptiondrive_records.teams import create_team
from exceptiondrive_records.tokens import issue_token

_FLOOD = "flood"
_FLOOD_SHARE = 0.3
_CLIENTS = 12
_WAYPOINTS = 6
_MOVED = "moved"
_BOARD = f"/api/v1/leaderboard?phase={PHASE}"


@dataclass
class Measured:
    """What clients and readers saw."""

    uploads_s: list[float] = field(default_factory=list)
    pages_s: list[float] = field(default_factory=list)
    boards_s: list[float] = field(default_factory=list)
    refused: dict[int, int] = field(default_factory=dict)
    refusals_without_retry_after: int = 0
    rss_mib: dict[str, float] = field(default_factory=dict)


def main() -> None:
    """Run one rush and print what it cost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--uploads", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--teams", type=int, default=40)
    parser.add_argument("--workers", type=int, default=1, help="worker processes of 2 slots")
    parser.add_argument("--copies", type=int, default=8, help="of the 420 samples, in the split")
    parser.add_argument("--postgres", action="store_true")
    parser.add_argument("--simulate", type=float, metavar="SECONDS", help="of one scoring run")
    given = parser.parse_args()
    if given.simulate is not None:
        _simulate(given.simulate, given.uploads, given.minutes * 60, given.teams)
        return
    environment = {"EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "75", "EXCEPTIONDRIVE_TIME_LIMIT_S": "90"}
    environment |= {"EXCEPTIONDRIVE_LEASE_S": "120", "EXCEPTIONDRIVE_BOARD_LEASE_S": "30"}
    topology = Topology(
        uses_postgres=given.postgres,
        n_workers=given.workers,
        split_copies=given.copies,
        settings=environment,
    )
    try:
        _rush(topology, given.uploads, given.minutes * 60, given.teams)
    finally:
        topology.close()


def _simulate(service_s: float, n_uploads: int, rush_s: float, n_teams: int) -> None:
    """Print waits for more slots than this machine has: the same arrivals, teams in turn."""
    rows = []
    for slots in (1, 2, 4, 8, 16, 32):
        waits, firsts = _simulated_waits(service_s, slots, _arrivals(n_uploads, rush_s, n_teams))
        rows.append((slots, *_spread(waits), _spread(firsts)[1]))
    show(
        f"Simulated: {n_uploads} uploads in {rush_s:.0f} s, {service_s:g} s each; seconds to score",
        ("slots", "p50", "p99", "max", "p99 of first files"),
        rows,
    )


def _simulated_waits(
    service_s: float, slots: int, arrivals: list[tuple[float, str]]
) -> tuple[list[float], list[float]]:
    """Return seconds from arrival to score of all files, and of every team's first one."""
    free_at_s = [0.0] * slots
    coming, waiting = sorted(arrivals, reverse=True), list[tuple[int, float, str]]()
    n_of_team: dict[str, int] = {}
    waits, firsts = [], []
    while coming or waiting:
        start_s = heapq.heappop(free_at_s)
        if not waiting:
            start_s = max(start_s, coming[-1][0])
        while coming and coming[-1][0] <= start_s:
            at_s, team = coming.pop()
            n_of_team[team] = n_of_team.get(team, 0) + 1
            heapq.heappush(waiting, (n_of_team[team], at_s, team))
        turn, at_s, team = heapq.heappop(waiting)
        heapq.heappush(free_at_s, start_s + service_s)
        waits.append(start_s + service_s - at_s)
        if turn == 1 and team != _FLOOD:
            firsts.append(waits[-1])
    return waits, firsts


def _rush(topology: Topology, n_uploads: int, rush_s: float, n_teams: int) -> None:
    tokens = _add_teams(topology, n_teams)
    make_file = _file_maker(topology.sample_ids)
    size_kib = len(make_file()) / 1024
    note(
        f"{len(topology.sample_ids)} samples, {size_kib:.0f} KiB a file, {n_teams} teams and a flood"
    )
    measured, stopped = Measured(), threading.Event()
    watchers = [
        threading.Thread(target=watch, args=(topology, measured, stopped))
        for watch in (_read_pages, _look_at_memory)
    ]
    for watcher in watchers:
        watcher.start()
    began = time.monotonic()
    with ThreadPoolExecutor(_CLIENTS) as pool:
        for at_s, team in _arrivals(n_uploads, rush_s, n_teams):
            time.sleep(max(0.0, at_s - (time.monotonic() - began)))
            pool.submit(_upload, topology, tokens[team], make_file(), measured)
    taken_s = time.monotonic() - began
    topology.wait_until(lambda: _is_done(topology), "the queue to drain", timeout_s=3600)
    drained_s = time.monotonic() - began
    stopped.set()
    for watcher in watchers:
        watcher.join()
    _print(topology, measured, n_uploads, taken_s, drained_s)


def _arrivals(n_uploads: int, rush_s: float, n_teams: int) -> list[tuple[float, str]]:
    """The flood comes at once; all others thicken towards the deadline."""
    rng = random.Random(20261121)
    n_flood = int(n_uploads * _FLOOD_SHARE)
    flood = [(0.05 * number, _FLOOD) for number in range(n_flood)]
    others = [
        (rush_s * (1 - rng.random() ** 2), f"team{rng.randrange(n_teams)}")
        for _ in range(n_uploads - n_flood)
    ]
    return sorted(flood + others)


def _add_teams(topology: Topology, n_teams: int) -> dict[str, str]:
    tokens = {}
    with topology.database.write() as session:
        for slug in (_FLOOD, *(f"team{number}" for number in range(n_teams))):
            team = create_team(session, slug, slug.title(), actor="load")
            tokens[slug], _ = issue_token(session, team.id, "load", actor="load")
    return tokens


def _file_maker(sample_ids: Sequence[str]) -> Callable[[], bytes]:
    """Return what makes gzipped files, each with other bytes: one of ten drives, one point moved."""
    rng = random.Random(7)

    def drive() -> list[list[float]]:
        mps, drift = rng.uniform(1, 12), rng.gauss(0, 0.2)
        return [
            [round(mps * step / 2, 3), round(drift * step + rng.gauss(0, 0.05), 3)]
            for step in range(1, _WAYPOINTS + 1)
        ]

    def document() -> str:
        predictions = [
            {"sample_id": sample_id, "source": drive(), "edited": drive()}
            for sample_id in sample_ids
        ]
        head = {"schema": "exceptiondrive.planning/1", "split": "sample"}
        predictions[0]["source"] = _MOVED
        return json.dumps({**head, "predictions": predictions})

    documents = [document() for _ in range(10)]

    def make() -> bytes:
        text = rng.choice(documents).replace(json.dumps(_MOVED), json.dumps(drive()), 1)
        return gzip.compress(text.encode(), compresslevel=1)

    return make


def _upload(topology: Topology, token: str, data: bytes, measured: Measured) -> None:
    """Upload; who is sent away comes again when told to."""
    headers = {"Authorization": f"Bearer {token}"}
    method = f"m{random.randrange(3)}"
    while True:
        began = time.monotonic()
        try:
            answer = httpx.post(
                f"{topology.url}/api/v1/submissions",
                data={"phase": PHASE, "method": method},
                files={"file": ("f.json.gz", data)},
                headers=headers,
                timeout=60,
            )
        except httpx.HTTPError:
            measured.refused[0] = measured.refused.get(0, 0) + 1
            time.sleep(1)
            continue
        if answer.status_code in (200, 202):
            measured.uploads_s.append(time.monotonic() - began)
            return
        measured.refused[answer.status_code] = measured.refused.get(answer.status_code, 0) + 1
        wait_s = answer.headers.get("Retry-After")
        measured.refusals_without_retry_after += wait_s is None
        time.sleep(min(5.0, float(wait_s or 1)))


def _read_pages(topology: Topology, measured: Measured, stopped: threading.Event) -> None:
    addresses = ((f"/?phase={PHASE}", measured.pages_s), (_BOARD, measured.boards_s))
    with httpx.Client(base_url=topology.url, timeout=60) as http:
        while not stopped.wait(0.1):
            for address, times_s in addresses:
                began = time.monotonic()
                if http.get(address).status_code == 200:
                    times_s.append(time.monotonic() - began)


def _look_at_memory(topology: Topology, measured: Measured, stopped: threading.Event) -> None:
    while not stopped.wait(1.0):
        for process in topology.supervisor.processes:
            pids = [process.pid, *process.children]
            rss = sum(_rss_mib(pid) for pid in pids)
            name = process.name.split("-")[0]
            measured.rss_mib[name] = max(measured.rss_mib.get(name, 0.0), rss)


def _rss_mib(pid: int) -> float:
    found = subprocess.run(
        ["ps", "-o", "rss=", "-p", str(pid)], capture_output=True, text=True, check=False
    )
    return float(found.stdout.strip() or 0) / 1024


def _is_done(topology: Topology) -> bool:
    with topology.database.read() as session:
        return not unfinished(session)


def _waits(topology: Topology) -> dict[str, list[float]]:
    """By team: seconds from acceptance to the end of scoring, in order of submission."""
    with topology.database.read() as session:
        query = (
            select(Team.slug, Job.created_at, Job.finished_at)
            .join(Submission, Submission.team_id == Team.id)
            .join(Job, Job.submission_id == Submission.id)
            .order_by(Job.created_at)
        )
        waits: dict[str, list[float]] = {}
        for slug, created_at, finished_at in session.execute(query):
            assert finished_at is not None
            waits.setdefault(slug, []).append((finished_at - created_at).total_seconds())
    return waits


def _services(topology: Topology) -> list[float]:
    with topology.database.read() as session:
        rows = session.execute(select(Job.leased_at, Job.finished_at))
        return [(end - start).total_seconds() for start, end in rows if start and end]


def _print(
    topology: Topology, measured: Measured, n_uploads: int, taken_s: float, drained_s: float
) -> None:
    waits = _waits(topology)
    firsts = [team[0] for slug, team in waits.items() if slug != _FLOOD]
    everything = [wait for team in waits.values() for wait in team]
    with topology.database.read() as session:
        broken = violations(session)
    show(
        "Deadline rush",
        ("", "p50", "p99", "max"),
        [
            ("upload to answer, s", *_spread(measured.uploads_s)),
            ("page, s", *_spread(measured.pages_s)),
            ("board as JSON, s", *_spread(measured.boards_s)),
            ("scoring run of one worker slot, s", *_spread(_services(topology))),
            ("accepted to scored, all, s", *_spread(everything)),
            ("accepted to scored, first file of a team, s", *_spread(firsts)),
            ("accepted to scored, the flooding team, s", *_spread(waits[_FLOOD])),
        ],
    )
    memory = ", ".join(f"{name} {mib:.0f}" for name, mib in sorted(measured.rss_mib.items()))
    note(
        f"accepted {len(measured.uploads_s)} of {n_uploads} in {taken_s:.0f} s "
        f"({n_uploads / taken_s:.1f}/s), all scored after {drained_s:.0f} s "
        f"({n_uploads / drained_s:.1f}/s)"
    )
    note(
        f"sent away, by status: {measured.refused or 'nobody'}; "
        f"without Retry-After: {measured.refusals_without_retry_after}"
    )
    note(f"most memory, MiB: {memory}")
    CONSOLE.print(f"invariants broken: {len(broken)}")
    if broken or len(measured.uploads_s) != n_uploads:
        sys.exit(1)


def _spread(values_s: list[float]) -> tuple[str, str, str]:
    if len(values_s) < 2:
        return ("-", "-", "-")
    p99 = quantiles(values_s, n=100, method="inclusive")[98]
    return (f"{median(values_s):.3f}", f"{p99:.3f}", f"{max(values_s):.3f}")


if __name__ == "__main__":
    main()
