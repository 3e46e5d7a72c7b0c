"""A deadline rush: `python -m benchmarks.load [--uploads 500] [--minutes 2]`.

Real processes, full-size files of many teams whose arrivals thicken towards the deadline, one team
that floods the queue first, and readers of page and board all the while (wrk where it is there).
`--matrix` runs SQLite and PostgreSQL with one worker and two; `--out` writes Markdown.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

import pandas as pd
from sqlalchemy import exists, func, select
from tests.chaos.topology import PHASE, Topology

from benchmarks.load_records import (
    chart,
    first_files,
    queue_over_time,
    services_s,
    spread,
    taken_before,
    waits_s,
)
from benchmarks.load_simulation import SLOTS, simulated_waits
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


if __name__ == "__main__":
    main()
