"""A deadline rush: `python -m benchmarks.load [--uploads 500] [--minutes 2]`.

Real processes, full-size files of many teams whose arrivals thicken towards the deadline, one team
that floods the queue first, and readers of page and board all the while (wrk where it is there).
`--matrix` runs SQLite and PostgreSQL with one worker and two; `--out` writes Markdown.
"""

import argparse
import heapq
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sqlalchemy import exists, func, select
from tests.chaos.topology import PHASE, Topology
from tests.support.fair_share import TeamQueue, served, team_to_serve

from benchmarks.load_traffic import FLOOD, Readers, Reading, Uploads, arrivals, file_maker, upload
from benchmarks.report import note
from exceptiondrive_records.accounts.tokens import issue_token
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Job

_CLIENTS = 12
TIMES = {
    "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "75",
    "EXCEPTIONDRIVE_TIME_LIMIT_S": "90",
    "EXCEPTIONDRIVE_LEASE_S": "120",
    "EXCEPTIONDRIVE_BOARD_LEASE_S": "30",
    "EXCEPTIONDRIVE_RECONCILE_EVERY_S": "1",
    "EXCEPTIONDRIVE_HEARTBEAT_TTL_S": "15",
}


@dataclass(frozen=True)
class Plan:
    """One rush."""

    database: str
    workers: int
    uploads: int
    rush_s: float
    teams: int
    copies: int


@dataclass
class Rush:
    """What one rush cost."""

    plan: Plan
    uploads: Uploads = field(default_factory=Uploads)
    readings: dict[str, Reading] = field(default_factory=dict)
    reader: str = ""
    rss_mib: dict[str, float] = field(default_factory=dict)
    jobs: pd.DataFrame = field(default_factory=pd.DataFrame)
    taken_s: float = 0.0
    drained_s: float = 0.0
    attempts: int = 0
    boards: int = 0
    last_build_s: float | None = None
    broken: int = 0
    load_average: tuple[float, ...] = ()

    @property
    def is_well(self) -> bool:
        """Whether everything was accepted and nothing broken."""
        return not self.broken and len(self.uploads.took_s) == self.plan.uploads


def main() -> None:
    """Run one rush, or the matrix, and print what it cost."""
    given = _arguments()
    databases = ("sqlite", "postgres") if given.matrix else (given.database,)
    workers = (1, 2) if given.matrix else (given.workers,)
    sections, is_well, service_s = [], True, given.simulate
    for database, n_workers in () if given.simulate else product(databases, workers):
        rush_s = given.minutes * 60
        plan = Plan(database, n_workers, given.uploads, rush_s, given.teams, given.copies)
        rush = _run(plan)
        sections.append(_section(rush))
        is_well &= rush.is_well
        service_s = service_s or services_s(rush.jobs).mean()
        print(sections[-1], flush=True)
    sections.append(_simulated(service_s, given.uploads, given.minutes * 60, given.teams))
    print(sections[-1])
    if given.out is not None:
        given.out.write_text("\n".join(sections), "utf-8")
        note(f"written to {given.out}")
    sys.exit(0 if is_well else 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--uploads", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--teams", type=int, default=40)
    parser.add_argument("--workers", type=int, default=1, help="worker processes of 2 slots")
    parser.add_argument("--copies", type=int, default=8, help="of the 420 samples, in the split")
    parser.add_argument("--database", choices=("sqlite", "postgres"), default="sqlite")
    parser.add_argument("--matrix", action="store_true", help="both databases, 1 and 2 workers")
    parser.add_argument("--out", type=Path, help="write the Markdown here too")
    parser.add_argument("--simulate", type=float, metavar="SECONDS", help="of one run; no rush")
    return parser.parse_args()


def _run(plan: Plan) -> Rush:
    topology = Topology(
        uses_postgres=plan.database == "postgres",
        n_workers=plan.workers,
        split_copies=plan.copies,
        settings=TIMES,
    )
    try:
        return _rush(topology, plan)
    finally:
        topology.close()


def _rush(topology: Topology, plan: Plan) -> Rush:
    rush, stopped = Rush(plan), threading.Event()
    tokens = add_teams(topology, plan.teams)
    make_file = file_maker(topology.sample_ids)
    pages = {"page": f"/?phase={PHASE}", "board as JSON": f"/api/v1/leaderboard?phase={PHASE}"}
    readers = {name: Readers(topology.url + path) for name, path in pages.items()}
    watcher = threading.Thread(target=_watch_memory, args=(topology, rush, stopped))
    watcher.start()
    began = time.monotonic()
    with ThreadPoolExecutor(_CLIENTS) as pool:
        for at_s, team in arrivals(plan.uploads, plan.rush_s, plan.teams):
            time.sleep(max(0.0, at_s - (time.monotonic() - began)))
            pool.submit(upload, topology.url, PHASE, tokens[team], make_file(), rush.uploads)
    rush.taken_s = time.monotonic() - began
    topology.wait_until(lambda: _is_ranked(topology), "the queue to drain", timeout_s=3600)
    rush.drained_s = time.monotonic() - began
    rush.load_average = os.getloadavg()
    stopped.set()
    watcher.join()
    rush.reader = next(iter(readers.values())).tool
    rush.readings = {name: reader.stop() for name, reader in readers.items()}
    _read_records(topology, rush)
    return rush


def add_teams(topology: Topology, n_teams: int) -> dict[str, str]:
    """Make the flooding team and others; tokens by slug."""
    tokens = {}
    with topology.database.write() as session:
        for slug in (FLOOD, *(f"team{number}" for number in range(n_teams))):
            team = create_team(session, slug, slug.title(), actor="load")
            tokens[slug], _ = issue_token(session, team.id, "load", actor="load")
    return tokens


def _watch_memory(topology: Topology, rush: Rush, stopped: threading.Event) -> None:
    while not stopped.wait(1.0):
        for process in topology.supervisor.processes:
            rss = _rss_mib([process.pid, *process.children])
            name = process.name.split("-")[0]
            rush.rss_mib[name] = max(rush.rss_mib.get(name, 0.0), rss)


def _rss_mib(pids: Sequence[int]) -> float:
    command = ["ps", "-o", "rss=", "-p", ",".join(str(pid) for pid in pids)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return sum(float(word) for word in found.stdout.split()) / 1024


def _is_ranked(topology: Topology) -> bool:
    """Whether every file is scored, and stands on a board; what files look like may come later."""
    waits = [kind.state.in_(OPEN_STATES) for kind in (Job, BoardRequest)]
    with topology.database.read() as session:
        return not any(session.scalar(select(exists().where(each))) for each in waits)


def _read_records(topology: Topology, rush: Rush) -> None:
    with topology.database.read() as session:
        query = (
            select(Team.slug, Job.created_at, Job.leased_at, Job.finished_at)
            .join(Submission, Submission.team_id == Team.id)
            .join(Job, Job.submission_id == Submission.id)
            .where(Job.leased_at.is_not(None), Job.finished_at.is_not(None))
        )
        rush.jobs = pd.DataFrame(
            session.execute(query), columns=["team", "created_at", "leased_at", "finished_at"]
        )
        rush.attempts = session.scalar(select(func.sum(Job.attempts))) or 0
        rush.boards = session.scalar(select(func.count(BoardRow.id))) or 0
        rush.last_build_s = session.scalar(select(func.max(BoardRequest.took_s)))
        rush.broken = len(violations(session))


def _section(rush: Rush) -> str:
    """One rush as Markdown."""
    plan, seen, jobs = rush.plan, rush.uploads, rush.jobs
    firsts = first_files(jobs)
    before = taken_before(jobs, firsts)
    rows = [
        ("upload to answer, s", *spread(seen.took_s)),
        *((f"{name}, s", *_of_reading(found)) for name, found in rush.readings.items()),
        ("one scoring run, s", *spread(services_s(jobs))),
        ("accepted to scored, all, s", *spread(waits_s(jobs))),
        ("accepted to scored, a team's first file, s", *spread(waits_s(firsts))),
        (
            "accepted to scored, the flooding team, s",
            *spread(waits_s(jobs[jobs.team == FLOOD])),
        ),
        ("files taken while a first file waited", *spread(before["all"])),
        ("of them, files of the flood", *spread(before.flood)),
    ]
    looks = sum(found.n for found in rush.readings.values())
    errors = sum(found.errors for found in rush.readings.values())
    build = "not measured" if rush.last_build_s is None else f"{rush.last_build_s:.2f} s"
    memory = ", ".join(f"{name} {mib:.0f}" for name, mib in sorted(rush.rss_mib.items()))
    lines = [
        f"### {plan.database}, {plan.workers} worker(s) of two slots, {datetime.now(UTC):%Y-%m-%d}",
        f"{plan.uploads} uploads in {plan.rush_s:.0f} s, {plan.teams} teams and a flood; "
        + f"{os.cpu_count()} cores, load {rush.load_average[0]:.1f} at the end.",
        "",
        "| | p50 | p99 | longest |",
        "|---|---|---|---|",
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
        f"- Accepted {len(seen.took_s)} of {plan.uploads} in {rush.taken_s:.0f} s "
        + f"({len(seen.took_s) / rush.taken_s:.1f}/s); all scored after {rush.drained_s:.0f} s "
        + f"({len(jobs) / rush.drained_s:.1f}/s).",
        f"- Sent away, by status: {seen.refused or 'nobody'}; without `Retry-After`: "
        + f"{seen.refusals_without_retry_after}.",
        f"- {looks} looks at page and board by {rush.reader}, {errors} failed; "
        + f"{rush.boards} boards, last build {build}.",
        f"- {rush.attempts} attempts for {len(jobs)} scores. Invariants broken: {rush.broken}.",
        f"- Most memory, MiB: {memory}.",
        "",
        "```text",
        *chart(queue_over_time(jobs)),
        "```",
        "",
    ]
    return "\n".join(lines)


def _of_reading(found: Reading) -> tuple[str, str, str]:
    return (f"{found.p50_s:.3f}", f"{found.p99_s:.3f}", f"{found.longest_s:.3f}")


def _simulated(service_s: float, n_uploads: int, rush_s: float, n_teams: int) -> str:
    lines = [
        f"### Simulated: {n_uploads} uploads in {rush_s:.0f} s, {service_s:.2f} s each, by slots",
        "",
        "| slots | p50 s | p99 s | longest s | p99 of a team's first file, s |",
        "|---|---|---|---|---|",
    ]
    for slots in SLOTS:
        waits, firsts = simulated_waits(service_s, slots, n_uploads, rush_s, n_teams)
        lines.append("| " + " | ".join((str(slots), *spread(waits), spread(firsts)[1])) + " |")
    return "\n".join([*lines, ""])


# What the records tell of a rush after it: waits, turns and the queue over time. All pure; `jobs` is a
# table of scoring runs: `team`, and when each was accepted, begun (`leased_at`) and ended (`finished_at`).

N_POINTS = 60
_BARS = "▁▂▃▄▅▆▇█"


def spread(values: ArrayLike) -> tuple[str, str, str]:
    """Median, 99th percentile and largest."""
    of = np.asarray(values, dtype=np.float64)
    if len(of) < 2:
        return ("-", "-", "-")
    median, p99, most = np.quantile(of, [0.5, 0.99, 1.0])
    return (f"{median:.3f}", f"{p99:.3f}", f"{most:.3f}")


def waits_s(jobs: pd.DataFrame) -> "pd.Series[float]":
    """Seconds from acceptance to the score."""
    return (jobs.finished_at - jobs.created_at).dt.total_seconds()


def services_s(jobs: pd.DataFrame) -> "pd.Series[float]":
    """Seconds of the scoring runs themselves."""
    return (jobs.finished_at - jobs.leased_at).dt.total_seconds()


def first_files(jobs: pd.DataFrame) -> pd.DataFrame:
    """The first file of every team but the flooding one."""
    firsts = jobs.sort_values("created_at").drop_duplicates("team")
    return firsts[firsts.team != FLOOD]


def taken_before(jobs: pd.DataFrame, firsts: pd.DataFrame) -> pd.DataFrame:
    """How many jobs were begun while each of `firsts` waited: of `all` teams, of the `flood`."""
    pairs = firsts[["created_at", "leased_at"]].merge(jobs, how="cross", suffixes=("_first", ""))
    pairs["is_before"] = pairs.leased_at.between(
        pairs.created_at_first, pairs.leased_at_first, inclusive="neither"
    )
    pairs["is_of_flood"] = pairs.is_before & (pairs.team == FLOOD)
    found = pairs.groupby("created_at_first")[["is_before", "is_of_flood"]].sum()
    return found.set_axis(["all", "flood"], axis=1)


def queue_over_time(jobs: pd.DataFrame) -> pd.DataFrame:
    """How many waited (`waiting`) and how long the oldest had (`oldest_s`), by second of the rush."""
    begin, end = jobs.created_at.min(), jobs.finished_at.max()
    found = {}
    for second in np.linspace(0, (end - begin).total_seconds(), N_POINTS):
        at = begin + pd.Timedelta(seconds=second)
        waits = jobs[(jobs.created_at <= at) & (at < jobs.leased_at)]
        oldest_s = (at - waits.created_at.min()).total_seconds() if len(waits) else 0.0
        found[second] = {"waiting": len(waits), "oldest_s": oldest_s}
    return pd.DataFrame.from_dict(found, orient="index")


def chart(queue: pd.DataFrame) -> list[str]:
    """Two lines of bars: how many wait, and the age of the oldest."""
    return [
        f"waiting files  {_bars(list(queue.waiting))}  most {queue.waiting.max():.0f}",
        f"oldest waits   {_bars(list(queue.oldest_s))}  most {queue.oldest_s.max():.0f} s",
        f"               0 s{f'{queue.index[-1]:.0f} s':>{max(1, len(queue) - 3)}}",
    ]


def _bars(values: Sequence[float]) -> str:
    most = max(values) or 1.0
    return "".join(" " if v == 0 else _BARS[min(7, int(8 * v / most))] for v in values)


# The same arrivals with more slots than this machine has, in the order of fair share

_START = datetime(2026, 1, 1, tzinfo=UTC)
SLOTS = (1, 2, 4, 8, 16, 32)


def simulated_waits(
    service_s: float, slots: int, n_uploads: int, rush_s: float, n_teams: int
) -> tuple[list[float], list[float]]:
    """Return seconds from arrival to score of all files, and of every team's first one."""
    queue = _Queue()
    coming = sorted(arrivals(n_uploads, rush_s, n_teams), reverse=True)
    running: list[tuple[float, str]] = []
    now_s, waits, firsts = 0.0, list[float](), list[float]()
    while coming or running or queue.is_waiting:
        while coming and coming[-1][0] <= now_s:
            queue.add(*coming.pop())
        while running and running[0][0] <= now_s:
            queue.end(heapq.heappop(running)[1])
        while len(running) < slots and queue.is_waiting:
            team, at_s, is_first = queue.take(now_s)
            heapq.heappush(running, (now_s + service_s, team))
            waits.append(now_s + service_s - at_s)
            if is_first and team != FLOOD:
                firsts.append(waits[-1])
        events = [coming[-1][0]] if coming else []
        events += [running[0][0]] if running else []
        now_s = min(events, default=now_s)
    return waits, firsts


class _Queue:
    """Live jobs of teams, as the records hold them."""

    def __init__(self) -> None:
        self._arrived_s: dict[str, list[float]] = {}
        self._taken: dict[str, int] = {}
        self._of_team: dict[str, TeamQueue] = {}

    @property
    def is_waiting(self) -> bool:
        return any(team.n_waiting for team in self._of_team.values())

    def add(self, at_s: float, team: str) -> None:
        known = self._of_team.get(team) or TeamQueue(len(self._of_team), 0, 0, _START, None)
        self._arrived_s.setdefault(team, []).append(at_s)
        self._of_team[team] = replace(known, n_waiting=known.n_waiting + 1)

    def take(self, now_s: float) -> tuple[str, float, bool]:
        """Give a slot its next job: team, arrival, whether it is the team's first."""
        queues = {name: self._with_oldest(name) for name in self._of_team}
        chosen = team_to_serve(list(queues.values()))
        assert chosen is not None
        team = next(name for name, queue in queues.items() if queue.team_id == chosen.team_id)
        n_taken = self._taken.get(team, 0)
        self._taken[team] = n_taken + 1
        self._of_team[team] = served(chosen, _START + timedelta(seconds=now_s))
        return team, self._arrived_s[team][n_taken], n_taken == 0

    def end(self, team: str) -> None:
        known = self._of_team[team]
        self._of_team[team] = replace(known, n_running=known.n_running - 1)

    def _with_oldest(self, team: str) -> TeamQueue:
        known, n_taken = self._of_team[team], self._taken.get(team, 0)
        arrived_s = self._arrived_s[team]
        oldest_s = arrived_s[min(n_taken, len(arrived_s) - 1)]
        return replace(known, oldest_at=_START + timedelta(seconds=oldest_s))


if __name__ == "__main__":
    main()
