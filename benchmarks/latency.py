"""More worker processes, and a database that is far: `python -m benchmarks.latency`.

For each number of worker processes and each latency, full-size files wait in the queue; then real
Celery workers start and score them all, with PostgreSQL and broker behind proxies that hold every
message for half a round trip. The queueing model (benchmarks/queueing.py) takes its demands from
one process without latency and from the messages counted, and stands beside what was measured. Only
ratios within one run mean anything.
"""

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import median

from sqlalchemy import func, make_url, select
from sqlalchemy import text as sql_text
from tests.chaos.topology import PHASE, Topology

from benchmarks.load import TIMES, add_teams
from benchmarks.load_traffic import Uploads, file_maker, upload
from benchmarks.queueing import Demands, mean_wait_s, throughputs
from benchmarks.report import ms, note, show, times
from benchmarks.upload_to_rank import cpu_by_process_s
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.work.tables import Job

CASES = (
    (1, 0.0),
    (1, 1.0),
    (2, 0.0),
    (4, 0.0),
    (8, 0.0),
    (1, 20.0),
    (4, 1.0),
    (4, 20.0),
    (8, 20.0),
)
"""Worker processes, ms of a round trip. The first two give the model its demands."""
ALONE_ROUND_TRIPS = 6
"""While a score holds the row of its phase's board request and the head of the chain: the request, the
lock, the last line, the time, the lines, the commit (records: `finish_scored`, `seal_audit_lines`)."""
LAN_MS = 0.5
_TEAMS = 8
_CLIENTS = 4


@dataclass(frozen=True)
class Case:
    """What so many processes did at such a latency."""

    slots: int
    latency_ms: float
    per_s: float
    accepted_per_s: float
    cpu_s: dict[str, float]
    """Of each process for one score."""
    accept_cpu_s: dict[str, float]
    """Of each process for one upload."""
    round_trips: float
    """To the database for one score; 0 where none was counted."""


def main() -> None:
    """Run the cases and print them beside the model."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description=__doc__)
    parser.add_argument("--uploads", type=int, default=80, help="of each case")
    parser.add_argument("--copies", type=int, default=8, help="of the 420 samples, in the split")
    given = parser.parse_args()
    topology = Topology(
        uses_postgres=True,
        n_workers=0,
        split_copies=given.copies,
        is_database_proxied=True,
        settings={**TIMES, "EXCEPTIONDRIVE_HEARTBEAT_TTL_S": "60"},
    )
    try:
        tokens = list(add_teams(topology, _TEAMS).values())
        cases = []
        for slots, latency_ms in CASES:
            cases.append(_case(topology, tokens, given.uploads, slots, latency_ms))
            note(f"{slots} processes, {latency_ms:g} ms: {cases[-1].per_s:.2f} a second")
        round_trip_s = _round_trip_s(topology)
    finally:
        topology.close()
    _report(cases, round_trip_s)


def _case(
    topology: Topology, tokens: list[str], n_uploads: int, slots: int, latency_ms: float
) -> Case:
    """Let files wait, then score them all."""
    make_file = file_maker(topology.sample_ids)
    files = [make_file() for _ in range(n_uploads)]
    before, began_s, done = _cpu_s(), time.monotonic(), _n_scored(topology)
    with ThreadPoolExecutor(_CLIENTS) as pool:
        for number, data in enumerate(files):
            token = tokens[number % len(tokens)]
            pool.submit(upload, topology.url, PHASE, token, data, Uploads())
    accepted_s = time.monotonic() - began_s
    accept_cpu_s = _since(before, n_uploads)
    _set_latency(topology, latency_ms)
    worker = topology.add_worker(slots=slots)
    target, warm = done + n_uploads, done + slots
    topology.wait_until(lambda: _n_scored(topology) >= warm, "the first scores", 600)
    first, before, began_s = _n_scored(topology), _cpu_s(), time.monotonic()
    round_trips = topology.database_proxy.n_round_trips
    topology.wait_until(lambda: _n_scored(topology) >= target, "all scores", 1200)
    took_s, n_scored = time.monotonic() - began_s, target - first
    round_trips = topology.database_proxy.n_round_trips - round_trips
    found = Case(
        slots,
        latency_ms,
        n_scored / took_s,
        n_uploads / accepted_s,
        _since(before, n_scored),
        accept_cpu_s,
        round_trips / n_scored,
    )
    _set_latency(topology, 0.0)
    topology.remove_worker(worker)
    return found


def _set_latency(topology: Topology, latency_ms: float) -> None:
    for proxy in (topology.proxy, topology.database_proxy):
        proxy.delay_s = latency_ms / 2000


def _n_scored(topology: Topology) -> int:
    with topology.database.read() as session:
        query = select(func.count(Job.id)).where(Job.finished_at.is_not(None))
        return session.scalar(query) or 0


def _cpu_s() -> dict[str, float]:
    return cpu_by_process_s(os.getpid())


def _since(before: dict[str, float], n: int) -> dict[str, float]:
    return {name: (s - before.get(name, 0.0)) / n for name, s in _cpu_s().items()}


def _round_trip_s(topology: Topology) -> float:
    """Seconds of the least question to the database, through the proxy without latency."""
    database = Database(make_url(topology.role_urls[Role.WORKER]).render_as_string(False))
    took_s = []
    with database.read() as session:
        for _ in range(100):
            began_s = time.perf_counter()
            session.execute(sql_text("SELECT 1"))
            took_s.append(time.perf_counter() - began_s)
    database.dispose()
    return median(took_s)


def _report(cases: list[Case], round_trip_s: float) -> None:
    one, counted = cases[0], cases[1]
    cores = os.cpu_count() or 1
    cpu_s = sum(one.cpu_s.values())
    alone_s = ALONE_ROUND_TRIPS * round_trip_s
    waits_s = max(0.0, 1 / one.per_s - cpu_s - alone_s)

    def demands(latency_ms: float) -> Demands:
        late_s = latency_ms / 1000
        others = counted.round_trips - ALONE_ROUND_TRIPS
        return Demands(cpu_s, alone_s + ALONE_ROUND_TRIPS * late_s, waits_s + others * late_s)

    shares = ", ".join(f"{name} {ms(s)}" for name, s in one.cpu_s.items())
    accepting = ", ".join(f"{name} {ms(s)}" for name, s in one.accept_cpu_s.items())
    note(f"one score: {1000 * cpu_s:.0f} ms of CPU ({shares}), {waits_s * 1000:.0f} ms of waiting,")
    note(f"{counted.round_trips:.0f} round trips to the database, {ms(round_trip_s)} ms each at no")
    note(f"latency; one upload: CPU ms {accepting}; {one.accepted_per_s:.1f} accepted a second")
    rows = []
    for case in cases:
        rates = throughputs(demands(case.latency_ms), cores, case.slots)
        at_once = next(c for c in cases if c.slots == case.slots and not c.latency_ms)
        base = throughputs(demands(0.0), cores, case.slots)
        wait = mean_wait_s(0.7 * rates[-1], rates)
        rows.append(
            (
                f"{case.slots}",
                f"{case.latency_ms:g}",
                f"{case.per_s:.2f}",
                f"{rates[-1]:.2f}",
                times(case.per_s / one.per_s),
                times(rates[-1] / throughputs(demands(0.0), cores, 1)[-1]),
                f"{case.per_s / at_once.per_s:.2f}",
                f"{rates[-1] / base[-1]:.2f}",
                f"{wait:.2f}",
            )
        )
    show(
        f"Scores a second on {cores} cores, measured and by the model",
        ("processes", "ms", "measured", "model", "x one", "model", "of no ms", "model", "wait s"),
        rows,
    )
    note("wait: by the model, from arrival to score at 70 % of that throughput; not measured")
    _far(one, counted.round_trips, round_trip_s)


def _far(one: Case, round_trips: float, round_trip_s: float) -> None:
    """Print what the model says where every process has a core of its own."""
    trip_s = LAN_MS / 1000 + round_trip_s
    database_s = one.cpu_s.get("database", 0.0) + one.accept_cpu_s.get("database", 0.0)
    alone_s = 2 * ALONE_ROUND_TRIPS * trip_s  # accepting passes the chain too
    worker_s = one.cpu_s["workers"]
    rows = []
    for slots in (10, 100):
        found = Demands(worker_s, alone_s, (round_trips - ALONE_ROUND_TRIPS) * trip_s)
        rate = throughputs(found, slots, slots)[-1]
        server_s = one.accept_cpu_s.get("server", 0.0)
        rows.append(
            (
                f"{slots}",
                f"{3600 * rate:,.0f}",
                f"{rate * alone_s:.0%}",
                f"{rate * database_s:.2f}",
                f"{rate * one.cpu_s.get('broker', 0.0):.2f}",
                f"{rate * server_s:.2f}",
            )
        )
    show(
        f"By the model: every process on a core of its own, {LAN_MS:g} ms to the database",
        ("processes", "uploads an hour", "chain busy", "cores: database", "broker", "server"),
        rows,
    )


if __name__ == "__main__":
    main()
