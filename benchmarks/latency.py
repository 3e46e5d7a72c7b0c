"""More worker processes, and a database that is far: `python -m benchmarks.latency`.

For each number of worker processes and each latency, full-size files wait in the queue; then real
Celery workers start and score them all, with PostgreSQL and broker behind proxies that hold every
message for half a round trip. What a score, a board and the time itself cost, in CPU and in round
trips, is the least-squares fit to all cases; the queueing model (benchmarks/queueing.py) takes its
demands from there and stands beside what was measured. Only ratios within one run mean anything.
"""

import argparse
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import median

import numpy as np
from sqlalchemy import func, select
from tests.chaos.topology import PHASE, Topology

from benchmarks.load import TIMES, add_teams
from benchmarks.load_traffic import Uploads, file_maker, upload
from benchmarks.queueing import Demands, mean_wait_s, throughputs
from benchmarks.report import ms, note, show, times
from benchmarks.upload_to_rank import cpu_by_process_s
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.work.board_requests import pause_after
from exceptiondrive_records.work.tables import BoardRequest, Job

CASES = (
    (1, 0.0),
    (2, 0.0),
    (4, 0.0),
    (8, 0.0),
    (1, 1.0),
    (4, 1.0),
    (8, 1.0),
    (1, 20.0),
    (4, 20.0),
    (8, 20.0),
    (16, 20.0),
)
"""Worker processes, ms of a round trip; the first is given to the model."""
LAN_MS = 0.5
_TEAMS = 8
_CLIENTS = 4
_WARM_UP = 12
"""Files scored first, and counted nowhere: what is made once is made then."""


@dataclass(frozen=True)
class Case:
    """What so many processes did at such a latency."""

    slots: int
    latency_ms: float
    took_s: float
    n_scored: int
    n_boards: int
    round_trips: float
    """To the database, of all processes."""
    cpu_s: dict[str, float]
    """Of each process, in all."""
    accept_cpu_s: dict[str, float]
    """Of each process for one upload."""

    @property
    def per_s(self) -> float:
        """Scores a second."""
        return self.n_scored / self.took_s


@dataclass(frozen=True)
class Cost:
    """What each score and each board adds, and each second."""

    of_score: float
    of_board: float
    of_second: float


def main() -> None:
    """Run the cases and print them beside the model."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description=__doc__)
    parser.add_argument("--uploads", type=int, default=120, help="of each case")
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
        _case(topology, tokens, _WARM_UP, 2, 0.0)
        cases = []
        for slots, latency_ms in CASES:
            cases.append(_case(topology, tokens, given.uploads, slots, latency_ms))
            note(f"{slots} processes, {latency_ms:g} ms: {cases[-1].per_s:.2f} a second")
        alone_s = _alone_s(topology)
    finally:
        topology.close()
    _report(cases, alone_s)


def _case(
    topology: Topology, tokens: list[str], n_uploads: int, slots: int, latency_ms: float
) -> Case:
    """Let files wait, then score them all; counted is from when all processes have one to when one has none."""
    make_file = file_maker(topology.sample_ids)
    files = [make_file() for _ in range(n_uploads)]
    before, done = _cpu_s(), _n_scored(topology)
    with ThreadPoolExecutor(_CLIENTS) as pool:
        for number, data in enumerate(files):
            token = tokens[number % len(tokens)]
            pool.submit(upload, topology.url, PHASE, token, data, Uploads())
    accept_cpu_s = {name: s / n_uploads for name, s in _since(before).items()}
    _set_latency(topology, latency_ms)
    worker = topology.add_worker(slots=slots)
    topology.wait_until(lambda: _n_scored(topology) >= done + slots, "the first scores", 600)
    first, boards, before, began_s = _counts(topology)
    trips = topology.database_proxy.n_round_trips
    enough = max(done + n_uploads - slots, first + 1)
    topology.wait_until(lambda: _n_scored(topology) >= enough, "scores", 1200)
    last, boards_after, _, ended_s = _counts(topology)
    found = Case(
        slots,
        latency_ms,
        ended_s - began_s,
        last - first,
        boards_after - boards,
        topology.database_proxy.n_round_trips - trips,
        _since(before),
        accept_cpu_s,
    )
    topology.wait_until(lambda: _n_scored(topology) >= done + n_uploads, "all scores", 600)
    _set_latency(topology, 0.0)
    topology.remove_worker(worker)
    return found


def _set_latency(topology: Topology, latency_ms: float) -> None:
    for proxy in (topology.proxy, topology.database_proxy):
        proxy.delay_s = latency_ms / 2000


def _counts(topology: Topology) -> tuple[int, int, dict[str, float], float]:
    """Scores, boards and CPU so far, and the time."""
    with topology.database.read() as session:
        n_boards = session.scalar(select(func.sum(BoardRequest.fence))) or 0
    return _n_scored(topology), n_boards, _cpu_s(), time.monotonic()


def _n_scored(topology: Topology) -> int:
    with topology.database.read() as session:
        query = select(func.count(Job.id)).where(Job.finished_at.is_not(None))
        return session.scalar(query) or 0


def _cpu_s() -> dict[str, float]:
    return cpu_by_process_s(os.getpid())


def _since(before: dict[str, float]) -> dict[str, float]:
    return {name: s - before.get(name, 0.0) for name, s in _cpu_s().items()}


def _alone_s(topology: Topology) -> float:
    """Seconds of a transaction that writes an audit line and nothing else: it has the chain for itself."""
    took_s = []
    for number in range(100):
        began_s = time.perf_counter()
        with topology.database.write() as session:
            audit(session, "benchmark", "counted", "latency", {"number": number})
        took_s.append(time.perf_counter() - began_s)
    return median(took_s)


def _cost(cases: Sequence[Case], of: Callable[[Case], float]) -> Cost:
    """Fit what scores, boards and seconds cost; none of them gives anything back."""
    counts = np.array([(case.n_scored, case.n_boards, case.took_s) for case in cases], float)
    spent = np.array([of(case) for case in cases])
    found, *_ = np.linalg.lstsq(counts, spent)
    return Cost(*(max(0.0, float(each)) for each in found))


@dataclass(frozen=True)
class Model:
    """Demands, and what boards and the time itself leave of cores and slots.

    Attributes:
        cpu_s: CPU seconds.
        trips: Round trips to the database.
        alone_s: Seconds that a score has the chain for itself.
        waits_s: Seconds that a score waits for anything but cores, chain and latency.
    """

    cpu_s: Cost
    trips: Cost
    alone_s: float
    waits_s: float = 0.0

    def per_s(self, cores: int, slots: int, latency_ms: float) -> float:
        """Scores a second."""
        late_s = latency_ms / 1000
        build_s = self.cpu_s.of_board + self.trips.of_board * late_s
        boards_per_s = 1 / (build_s + pause_after(build_s))
        cores_left = cores - self.cpu_s.of_second - boards_per_s * self.cpu_s.of_board
        demands = Demands(
            self.cpu_s.of_score * cores / max(cores_left, 0.1),
            self.alone_s,
            self.waits_s + self.trips.of_score * late_s,
        )
        rates = [0.0, *throughputs(demands, cores, slots)]
        slots_left = slots - boards_per_s * build_s
        return float(np.interp(slots_left, range(len(rates)), rates))


def _fitted(cases: Sequence[Case], alone_s: float, cores: int) -> Model:
    """Take costs from all cases; the wait from the first, so that the model has its rate."""
    cpu_s = _cost(cases, lambda case: sum(case.cpu_s.values()))
    trips = _cost(cases, lambda case: case.round_trips)
    first, low_s, high_s = cases[0], 0.0, 10.0
    for _ in range(40):
        middle_s = (low_s + high_s) / 2
        rate = Model(cpu_s, trips, alone_s, middle_s).per_s(cores, first.slots, first.latency_ms)
        low_s, high_s = (middle_s, high_s) if rate > first.per_s else (low_s, middle_s)
    return Model(cpu_s, trips, alone_s, low_s)


def _report(cases: list[Case], alone_s: float) -> None:
    cores = os.cpu_count() or 1
    model = _fitted(cases, alone_s, cores)
    for name, cost, unit in (("CPU", model.cpu_s, 1000), ("round trips", model.trips, 1)):
        of = (cost.of_score, cost.of_board, cost.of_second)
        told = ", ".join(
            f"{unit * each:.0f} a {what}"
            for each, what in zip(of, ("score", "board", "second"), strict=True)
        )
        note(f"{name}{', ms' if unit > 1 else ''}: {told}")
    note(f"alone with the chain {ms(alone_s)} ms; other waits {ms(model.waits_s)} ms")
    rows = []
    for case in cases:
        rate = model.per_s(cores, case.slots, case.latency_ms)
        same = next((c for c in cases if c.slots == case.slots and not c.latency_ms), None)
        one = next(c for c in cases if c.latency_ms == case.latency_ms)
        rows.append(
            (
                f"{case.slots}",
                f"{case.latency_ms:g}",
                f"{case.per_s:.2f}",
                f"{rate:.2f}",
                f"{rate / case.per_s - 1:+.0%}",
                times(case.per_s / one.per_s),
                "" if same is None else f"{case.per_s / same.per_s:.2f}",
                f"{case.n_boards}",
                f"{case.round_trips / case.n_scored:.0f}",
                f"{1000 * sum(case.cpu_s.values()) / case.n_scored:.0f}",
            )
        )
    show(
        f"Scores a second on {cores} cores, measured and by the model",
        (
            "processes",
            "ms",
            "measured",
            "model",
            "off",
            "x one",
            "of 0 ms",
            "boards",
            "trips a score",
            "CPU ms",
        ),
        rows,
    )
    _far(cases, model)


def _far(cases: list[Case], model: Model) -> None:
    """Print what the model says where every process has a core of its own."""

    def cpu_s(name: str) -> float:
        of_score = _cost(cases, lambda case: case.cpu_s.get(name, 0.0)).of_score
        return of_score + median(case.accept_cpu_s.get(name, 0.0) for case in cases)

    of_worker = _cost(cases, lambda case: case.cpu_s.get("workers", 0.0))
    rows = []
    for slots in (10, 100):
        for latency_ms in (LAN_MS, 20.0):
            found = Model(
                of_worker, model.trips, 2 * model.alone_s
            )  # accepting passes the chain too
            rate = found.per_s(slots, slots, latency_ms)
            demands = Demands(
                of_worker.of_score, 2 * model.alone_s, model.trips.of_score * latency_ms / 1000
            )
            wait_s = mean_wait_s(0.7 * rate, throughputs(demands, slots, slots))
            rows.append(
                (
                    f"{slots}",
                    f"{latency_ms:g}",
                    f"{3600 * rate:,.0f}",
                    f"{rate * 2 * model.alone_s:.0%}",
                    f"{rate * cpu_s('database'):.2f}",
                    f"{rate * cpu_s('broker'):.2f}",
                    f"{rate * cpu_s('server'):.2f}",
                    f"{wait_s:.2f}",
                )
            )
    show(
        "By the model: every process on a core of its own",
        (
            "processes",
            "ms",
            "uploads an hour",
            "chain busy",
            "cores: database",
            "broker",
            "server",
            "wait s",
        ),
        rows,
    )
    note("wait: from arrival to score at 70 % of that throughput; not measured")


if __name__ == "__main__":
    main()
