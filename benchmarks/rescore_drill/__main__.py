"""The drill of a protocol update: real files, two workers, fresh submissions, random SIGKILLs.

    python -m benchmarks.rescore_drill --database sqlite|postgres [--submissions 200] [--markdown]

A new required clearance, then a new footprint, each goes from draft to apply to rollback. At the
end nothing may be lost, doubled or mixed, fresh submissions may have waited at most twice as long
as without a run, and the board must have its earlier bytes again; else the exit code is 1.
Needs the files of real planners (tests/support/realdata.py says where); writes only into a temporary folder.
"""

import argparse
import signal
import sys
import time
from contextlib import ExitStack

from tests.chaos.topology import Topology

from benchmarks.rescore_drill.clients import Clients, Reader
from benchmarks.rescore_drill.drill import N_STAGES, UPDATES, Drill
from benchmarks.rescore_drill.report import Report
from benchmarks.rescore_drill.stage import REALDATA, SETTINGS, WORKERS, prepare_records, variations
from benchmarks.rescore_drill.verdict import NotProven, demand, demand_end_state
from exceptiondrive_schemas.protocol import packaged_protocol


def main() -> None:
    """Read the arguments and run."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that no process stays behind
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.rescore_drill",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--database", choices=("sqlite", "postgres"), default="sqlite")
    parser.add_argument("--submissions", type=int, default=200)
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    given = parser.parse_args()
    if not REALDATA.is_dir():
        sys.exit("the real planner files are not where tests/support/realdata.py looks for them")
    began = time.monotonic()
    with Report(N_STAGES) as report:
        verdict = _verdict(given.database, given.submissions, report)
    report.say("the whole drill", f"{time.monotonic() - began:.0f} s")
    report.say("verdict", verdict or "proven")
    title = f"{given.submissions} submissions, two workers, {given.database}"
    report.show(title, as_markdown=given.markdown)
    sys.exit(1 if verdict else 0)


def _verdict(kind: str, n_submissions: int, report: Report) -> str | None:
    """Run the drill; return what was not proven, if anything."""
    try:
        with ExitStack() as stack:
            _drill(kind, n_submissions, report, stack)
    except NotProven as not_proven:
        return f"NOT PROVEN: {not_proven}"
    return None


def _drill(kind: str, n_submissions: int, report: Report, stack: ExitStack) -> None:
    topology = Topology(uses_postgres=kind == "postgres", n_workers=0, settings=SETTINGS)
    stack.callback(topology.close)
    made = variations()
    tokens = prepare_records(topology, n_submissions, made)
    for lane, slots in WORKERS:
        topology.add_worker(lanes=lane, slots=slots)
    clients = Clients(topology.url, tokens, made)
    stack.callback(clients.close)
    clients.n_submitted = n_submissions
    drill = Drill(topology, clients, report)
    drill.first_scores(n_submissions)
    with Reader(topology.url) as reader:  # also while no run is on: it costs time as well
        alone = drill.alone()
        for name in UPDATES:
            drill.update(name, alone)
        covered = [packaged_protocol(), *drill.cover_all()]
    report.say("workers killed (SIGKILL)", drill.n_killed)
    for what, value in demand_end_state(topology.database, clients.n_submitted, covered, reader):
        report.say(what, value)
    demand(not drill.slow, f"fresh submissions waited too long: {'; '.join(drill.slow)}")


if __name__ == "__main__":
    main()
