"""Faults of API, reconcilers, database, disk and files."""

import gzip
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

from sqlalchemy import text
from tests.chaos.run import Run

from exceptiondrive_records.tables import JobState, Submission
from exceptiondrive_schemas.submission import SubmissionStatus


def kill_api_before_commit(run: Run) -> str:
    """The file is stored, the row is not: the client tries again."""
    run.topology.order("kill-before-commit")
    call = run.upload()
    run.settle()
    assert _tries(run, call.file_digest) > 1, "the API was not killed"
    assert call.status == 202, f"the second try was told {call.status}"
    return f"{_tries(run, call.file_digest)} tries, one submission, 202"


def kill_api_after_commit(run: Run) -> str:
    """The row is there, the answer is not: trying again gives the same submission."""
    run.topology.order("kill-after-commit")
    call = run.upload()
    run.settle()
    assert _tries(run, call.file_digest) > 1, "the API was not killed"
    assert call.status == 200, f"the second try was told {call.status}"
    return f"{_tries(run, call.file_digest)} tries, the same submission, 200"


def kill_api(run: Run) -> str:
    run.clients.stream(8)
    time.sleep(0.5)
    run.topology.server.kill_group()
    return f"settled {run.settle():.1f} s after the stream"


def kill_leader(run: Run) -> str:
    """Two reconcilers: the leader dies, the other takes over."""
    run.slowly(0.3)
    run.clients.stream(10)
    before = run.leader()
    for process in run.topology.reconcilers:
        if before is not None and f":{process.pid}:" in before:
            process.hold_down()
            break
    else:
        raise AssertionError(f"none of the two leads: {before}")
    took_s = run.topology.wait_until(lambda: run.leader() != before, "another leader")
    run.at_full_speed()
    process.start()
    run.settle()
    return f"the other led after {took_s:.1f} s"


def kill_postgres(run: Run) -> str:
    assert run.topology.postgres is not None
    run.slowly(0.3)
    run.clients.stream(8)
    run.wait_for_lease()
    run.topology.postgres.kill()
    time.sleep(1)
    run.topology.postgres.start()
    run.at_full_speed()
    took_s = run.settle()
    unavailable = [call for call in run.history.calls if call.status == 503]
    assert all(call.retry_after for call in unavailable), "a 503 without Retry-After"
    return f"{len(unavailable)} x 503 with Retry-After, settled in {took_s:.1f} s"


def cut_postgres(run: Run) -> str:
    assert run.topology.postgres is not None
    run.clients.stream(8)
    cut = 0
    for _ in range(4):
        cut += run.topology.postgres.cut_connections()
        time.sleep(0.4)
    run.settle()
    assert cut, "no connection was cut"
    return f"{cut} connections cut"


def wrong_clock(run: Run) -> str:
    """Workers an hour ahead and an hour behind; leases follow the database's clock."""
    library = _faketime()
    assert library is not None
    skewed = [
        run.topology.add_worker(
            environment={
                "LD_PRELOAD": str(library),
                "FAKETIME": shift,
                "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            }
        )
        for shift in ("+1h", "-1h")
    ]
    run.topology.worker.hold_down()
    run.topology.wait_until(lambda: run.topology.readiness()["live_workers"] >= 4, "two more")
    retried = run.n_retried()
    run.clients.stream(8)
    run.settle()
    for worker in skewed:
        run.topology.remove_worker(worker)
    run.topology.worker.start()
    assert run.n_retried() == retried, "a lease was thought to have expired"
    return "no lease expired early or late, nothing retried"


def full_disk(run: Run) -> str:
    """The disk of the records fills up, then there is room again."""
    ballast = run.topology.data / "ballast"
    before = run.n_sheets()
    with ballast.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(b"\0" * 4096)
        except OSError:
            pass
    told = [run.clients.submit(run.clients.new_file(), "alpha", patient=False) for _ in range(4)]
    ballast.unlink(missing_ok=True)
    run.clients.stream(6)
    run.settle()
    statuses = [call.status for call in told]
    assert any(status == 503 for status in statuses), f"the disk was not full: {statuses}"
    assert run.n_sheets() >= before
    return f"while full: {statuses}; earlier rows intact"


def store_gone(run: Run) -> str:
    """The folder of uploads is away, as an unmounted volume."""
    aside = run.topology.folder / "uploads-aside"
    run.topology.uploads.rename(aside)
    run.topology.uploads.write_text("not a folder")
    told = [run.clients.submit(run.clients.new_file(), "beta", patient=False) for _ in range(3)]
    ready = run.topology.readiness()
    run.topology.uploads.unlink()
    aside.rename(run.topology.uploads)
    run.clients.stream(4)
    run.settle()
    assert all(call.status == 503 and call.retry_after for call in told), told
    assert not ready.get("is_ready"), "ready without a store"
    return "3 of 3 told 503 with Retry-After, not ready, no row"


def read_only_store(run: Run) -> str:
    """The store's file system turns read-only."""
    _mount(run, "-t", "tmpfs", "-o", "size=64m", "tmpfs")
    try:
        run.clients.stream(3)
        run.settle()
        _mount(run, "-o", "remount,ro")
        told = [run.clients.submit(run.clients.new_file(), "beta", patient=False) for _ in range(3)]
        _mount(run, "-o", "remount,rw")
        run.clients.stream(3)
        run.settle()
        kept = run.topology.folder / "kept"
        shutil.copytree(run.topology.uploads, kept)
    finally:
        subprocess.run(["umount", "-l", str(run.topology.uploads)], check=True)
    shutil.copytree(kept, run.topology.uploads, dirs_exist_ok=True)
    assert all(call.status == 503 and call.retry_after for call in told), told
    return "3 of 3 told 503 with Retry-After, no row"


def flipped_bit(run: Run) -> str:
    """A stored upload changes before it is scored."""
    run.topology.worker.hold_down()
    call = run.upload()
    name = call.file_digest.removeprefix("sha256:")
    path = run.topology.uploads / name[:2] / name
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    run.topology.worker.start()
    run.settle()
    assert run.failure_of(call) == "upload_damaged"
    data[100] ^= 1
    path.write_bytes(data)  # so that the checker may ask for every file
    return "failed: upload_damaged, never scored"


def split_missing(run: Run) -> str:
    """The split is away, then changed: nothing is scored until the registered one is back."""
    path = run.topology.splits / "sample" / "split.json.gz"
    whole = path.read_bytes()
    run.topology.worker.hold_down()
    path.unlink()
    run.topology.worker.start()
    calls = [run.upload(), run.upload("beta")]
    time.sleep(2.5)
    path.write_bytes(_changed_split(whole))
    time.sleep(2.5)
    assert all(run.job_of(call).attempts == 0 for call in calls), "an attempt was used up"
    assert all(run.job_of(call).state is JobState.QUEUED for call in calls)
    path.write_bytes(whole)
    run.settle()
    assert all(run.status_of(call) is SubmissionStatus.SCORED for call in calls)
    return "stayed queued with 0 attempts; scored when the file was back"


def _changed_split(whole: bytes) -> bytes:
    document = json.loads(gzip.decompress(whole))
    document["samples"][0]["region"][0][0] += 0.5
    return gzip.compress(json.dumps(document).encode())


def edited_protocol(run: Run) -> str:
    """Someone edits a protocol in the database: what names it is refused, not scored by it."""
    run.topology.worker.hold_down()
    call = run.upload()
    _edit_protocol(run, "4.084", "4.085")
    run.topology.worker.start()
    time.sleep(3)
    assert run.n_scored(call) == 0, "it was scored under an altered protocol"
    _edit_protocol(run, "4.085", "4.084")
    run.topology.worker.kill_group()
    run.settle()
    assert run.n_scored(call) == 1
    return "not scored while altered; scored once the text was right again"


def withdrawn(run: Run) -> str:
    """A submission is withdrawn while it is being scored."""
    run.slowly(1.5)
    call = run.upload()
    run.wait_for_lease()
    status = run.clients.withdraw(call)
    run.at_full_speed()
    run.settle()
    time.sleep(2)
    with run.topology.database.read() as session:
        row = session.get_one(Submission, call.submission_id)
    assert status == 200
    assert row.status is SubmissionStatus.WITHDRAWN
    assert run.lines("submission withdrawn") >= 1
    return "tombstone and audit line kept, the late score refused"


def _tries(run: Run, digest: str) -> int:
    return sum(call.file_digest == digest for call in run.history.calls)


def _mount(run: Run, *arguments: str) -> None:
    subprocess.run(["mount", *arguments, str(run.topology.uploads)], check=True)


def why_no_mount() -> str | None:
    """Say why no small or read-only file system can be mounted, if so."""
    if os.getuid() == 0 and shutil.which("mount") is not None:
        return None
    return "needs root and `mount`, for a file system of its own"


def why_no_faketime() -> str | None:
    """Say why no process can be given another clock, if so."""
    return None if _faketime() else "needs libfaketime: as root, apt-get install faketime"


def _faketime() -> Path | None:
    return next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)


def _edit_protocol(run: Run, before: str, after: str) -> None:
    """As an intruder with all rights on the database: past the trigger that forbids it."""
    statement = f"UPDATE protocols SET toml = replace(toml, '{before}', '{after}')"
    with run.topology.database.write() as session:
        triggers = session.execute(
            text(
                "SELECT name, sql FROM sqlite_master WHERE tbl_name = 'protocols' AND type = 'trigger'"
            )
        ).all()
        for name, _ in triggers:
            session.execute(text(f'DROP TRIGGER "{name}"'))
        session.execute(text(statement))
        for _, again in triggers:
            session.execute(text(again))
