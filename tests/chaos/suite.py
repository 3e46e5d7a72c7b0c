"""The fault suite: which faults there are, what each needs, and how one is run."""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from tests.chaos import faults_alone as alone
from tests.chaos import faults_broker as broker
from tests.chaos import faults_files as files
from tests.chaos import faults_rescoring as rescoring
from tests.chaos import faults_scoring as scoring
from tests.chaos import faults_server as server
from tests.chaos import faults_worker as worker
from tests.chaos.run import Run
from tests.chaos.topology import Topology


class On(Enum):
    """What a fault is injected into; faults of one kind share a running topology."""

    SQLITE = "SQLite"
    POSTGRES = "PostgreSQL"
    SMALL_DISK = "SQLite on 6 MB"
    ALONE = "alone"


@dataclass(frozen=True)
class Fault:
    """One row of the table of docs/faults.md, or a variant of one."""

    id: str
    injection: str
    inject: Callable[[Run], str] | Callable[[], str]
    on: On = On.SQLITE
    why_not: Callable[[], str | None] | None = None
    """Says why it cannot be injected on this machine, if so."""


FAULTS = (
    Fault("F01", "SIGKILL worker children in mid-score, 3 times", worker.kill_children),
    Fault("F02", "SIGKILL worker parent", worker.kill_parent),
    Fault("F02b", "SIGKILL the worker's whole group", worker.kill_group),
    Fault("F02c", "SIGKILL everything but the database", worker.kill_everything),
    Fault("F03", "SIGTERM worker with a running job", worker.terminate),
    Fault("F04", "SIGQUIT worker", worker.quit_at_once),
    Fault("F05", "SIGSTOP worker past its lease, SIGCONT", worker.freeze_past_the_lease),
    Fault("F06", "SIGKILL broker, back empty", broker.comes_back_empty),
    Fault("F07", "broker down for 60 s while 12 files are submitted", broker.down_at_submit),
    Fault("F08", "FLUSHALL", broker.flush),
    Fault("F09", "broker down and up 4 times", broker.flap),
    Fault("F10", "SIGSTOP broker for 15 s of uploads", broker.freeze),
    Fault("F11", "broker out of memory (noeviction)", broker.out_of_memory),
    Fault("F12", "broker evicts the queue (allkeys-lru)", broker.evicts),
    Fault("F13", "LPUSH junk of every kind into both queues", broker.junk),
    Fault("F14", "deliver one job 20 times more, several at once", broker.deliver_again),
    Fault("F15", "job outlasts the visibility timeout", worker.outlast_the_visibility_timeout),
    Fault("F16", "a file whose scoring kills its process", worker.poison),
    Fault("F17", "scoring never ends, in Python and in C", worker.endless_loop),
    Fault("F18", "scoring allocates 10 GB", worker.too_much_memory),
    Fault("F19", "connections to the broker fall silent", broker.silence),
    Fault("F20", "200 ms and 5 % resets on the way to the broker", broker.bad_network),
    Fault("F21", "SIGKILL API after the file, before the row", server.kill_api_before_commit),
    Fault(
        "F22",
        "SIGKILL API after the row, before the answer",
        server.kill_api_after_commit,
    ),
    Fault("F22b", "SIGKILL API under a stream", server.kill_api),
    Fault("F23", "SIGKILL the leading reconciler of two", server.kill_leader),
    Fault(
        "F24", "SIGKILL PostgreSQL in mid-score, start it again", server.kill_postgres, On.POSTGRES
    ),
    Fault("F24b", "end every database connection, 4 times", server.cut_postgres, On.POSTGRES),
    Fault("F24c", "SIGKILL worker children, on PostgreSQL", worker.kill_children, On.POSTGRES),
    Fault("F24d", "SIGKILL everything but PostgreSQL", worker.kill_everything, On.POSTGRES),
    Fault(
        "F25",
        "disk of the records full",
        files.full_disk,
        On.SMALL_DISK,
        why_not=files.why_no_mount,
    ),
    Fault("F26", "file store gone", files.store_gone),
    Fault("F26b", "file store read-only", files.read_only_store, why_not=files.why_no_mount),
    Fault("F27", "one bit of a stored upload flips", files.flipped_bit),
    Fault("F28", "split missing", files.split_missing),
    Fault("F28b", "split changed", files.split_changed),
    Fault(
        "F29",
        "workers' clocks 1 h ahead and behind",
        server.wrong_clock,
        On.POSTGRES,
        why_not=server.why_no_faketime,
    ),
    Fault("F30", "6 processes write to SQLite", alone.six_writers, On.ALONE),
    Fault(
        "F31", "1,000 submissions rescored while teams submit", rescoring.rescore_while_submitting
    ),
    Fault("F32", "SIGKILL everything in mid-rescore", rescoring.kill_in_mid_rescore),
    Fault("F33", "a worker of an older scorer joins", scoring.older_scorer),
    Fault("F34", "a protocol edited in place", server.edited_protocol),
    Fault("F35", "withdrawn while it is scored, then sent again", server.withdrawn),
    Fault(
        "F35b",
        "an organizer withdraws the wrong entry, and restores it",
        server.taken_out_by_mistake,
    ),
    Fault("F36", "one submission fails, one answers nothing", scoring.no_score),
    Fault("F37", "back up under load, restore elsewhere", alone.restore_from_backup),
    Fault("F38", "SIGKILL in the middle of a migration", alone.kill_migration, On.ALONE),
    Fault(
        "F38b",
        "SIGKILL in the middle of a migration of PostgreSQL",
        alone.kill_migration_on_postgres,
        On.ALONE,
    ),
)


@dataclass(frozen=True)
class Outcome:
    """What came of one fault."""

    fault: Fault
    is_survived: bool
    text: str
    seconds: float


def run_fault(fault: Fault, run: Run | None) -> Outcome:
    """Inject a fault, wait until everything has settled, and ask the checker."""
    began = time.monotonic()
    try:
        text = fault.inject(run) if run is not None else fault.inject()  # type: ignore[call-arg]
        broken = run.broken() if run is not None else []
    except Exception as error:  # noqa: BLE001 - one row that breaks must not end the table
        words = str(error) if isinstance(error, AssertionError) else repr(error)
        return Outcome(fault, False, words, time.monotonic() - began)
    seconds = time.monotonic() - began
    if broken:
        return Outcome(fault, False, "; ".join(map(str, broken[:5])), seconds)
    return Outcome(fault, True, text, seconds)


@contextmanager
def running(on: On, *, is_short: bool = False) -> Iterator[Run | None]:
    """Start what a kind of faults is injected into."""
    if on is On.ALONE:
        yield None
        return
    disk = Path(tempfile.mkdtemp(prefix="ed-disk-")) if on is On.SMALL_DISK else None
    if disk is not None:
        mount = ["mount", "-t", "tmpfs", "-o", "size=6m,mode=755", "tmpfs", str(disk)]
        subprocess.run(mount, check=True)
    run = None
    try:
        topology = Topology(
            uses_postgres=on is On.POSTGRES,
            data=disk,
            has_canary=True,
            is_forked=is_short,
            every_sample=7 if is_short and disk is None else 1,  # a small disk is to be filled
        )
        run = Run(topology, is_short=is_short)
        yield run
    finally:
        if run is not None:
            run.close()
        if disk is not None:
            subprocess.run(["umount", "-l", str(disk)], check=True)
            shutil.rmtree(disk, ignore_errors=True)
