"""Faults of disk, file store and split files."""

import gzip
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.chaos.history import Call
from tests.chaos.run import Run
from tests.chaos.topology import MAX_ATTEMPTS

from exceptiondrive_records.work.tables import WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus


def full_disk(run: Run) -> str:
    """The disk of the records fills up, then there is room again."""
    ballast = run.topology.data / "ballast"
    run.clients.stream(3)
    run.settle()
    before = run.sheets()
    assert before, "nothing was scored before"
    _fill_up(ballast)
    told = [run.clients.submit(run.clients.new_file(), "alpha", patient=False) for _ in range(4)]
    ballast.unlink(missing_ok=True)
    run.clients.stream(6)
    run.settle()
    statuses = [call.status for call in told]
    refused = [call for call in told if call.status == 503]
    assert refused, f"the disk was not full: {statuses}"
    assert set(statuses) <= {202, 503}, statuses
    assert all(call.retry_after for call in refused), "a 503 without Retry-After"
    run.require_no_rows(refused)
    assert before.items() <= run.sheets().items(), "a score of before is lost, or another one"
    return f"while full: {statuses}; the {len(before)} scores of before are as they were"


def _fill_up(ballast: Path) -> None:
    """Write until nothing more goes onto the disk."""
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(b"\0" * 4096)


def store_gone(run: Run) -> str:
    """The folder of uploads is away, as an unmounted volume, for longer than all attempts of a job."""
    aside, used = run.topology.folder / "uploads-aside", run.used_today("beta")
    log = run.topology.worker.log
    n_before = log.read_text().count(_READ_IN_VAIN)
    run.topology.freeze_between_writes()
    accepted = run.upload()
    _take_away(run.topology.uploads, aside)
    run.topology.worker.thaw()
    told = [run.clients.submit(run.clients.new_file(), "beta", patient=False) for _ in range(3)]
    ready = run.topology.readiness()
    run.topology.wait_until(
        lambda: log.read_text().count(_READ_IN_VAIN) > n_before + MAX_ATTEMPTS, "reads in vain"
    )
    _put_back(run.topology.uploads, aside)
    assert run.used_today("beta") == used, "it cost quota"
    run.clients.stream(4)
    run.settle()
    run.require_scored([accepted])
    assert run.job_of(accepted).attempts == 1, "an outage used attempts"
    assert all(call.status == 503 and call.retry_after for call in told), told
    assert not ready.get("is_ready"), "ready without a store"
    run.require_no_rows(told)
    return "3 of 3 told 503 with Retry-After, not ready, no row, no quota used; what was accepted waited"


_READ_IN_VAIN = '"code": "store_unavailable", "error"'


def _take_away(folder: Path, aside: Path) -> None:
    folder.rename(aside)
    folder.write_text("not a folder")


def _put_back(folder: Path, aside: Path) -> None:
    folder.unlink()
    aside.rename(folder)


def read_only_store(run: Run) -> str:
    """The store's file system turns read-only."""
    _mount(run, "-t", "tmpfs", "-o", "size=128m", "tmpfs")
    (run.topology.uploads / "mounted").touch()  # an empty folder counts as away
    try:
        run.clients.stream(3)
        run.settle()
        _turn_read_only(run)
        used = run.used_today("beta")
        told = [run.clients.submit(run.clients.new_file(), "beta", patient=False) for _ in range(3)]
        _mount(run, "-o", "remount,rw")
        assert run.used_today("beta") == used, "it cost quota"
        run.clients.stream(3)
        run.settle()
        kept = run.topology.folder / "kept"
        shutil.copytree(run.topology.uploads, kept)
    finally:
        subprocess.run(["umount", "-l", str(run.topology.uploads)], check=True)
    shutil.copytree(kept, run.topology.uploads, dirs_exist_ok=True)
    assert all(call.status == 503 and call.retry_after for call in told), told
    run.require_no_rows(told)
    return "3 of 3 told 503 with Retry-After, no row, no quota used"


def flipped_bit(run: Run) -> str:
    """A stored upload changes before it is scored."""
    run.topology.worker.hold_down()
    call = run.upload()
    name = call.file_digest.removeprefix("sha256:")
    path = run.topology.uploads / name[:2] / name
    _flip_a_bit(path)
    run.topology.worker.start()
    run.settle()
    assert run.failure_of(call) == "upload_damaged"
    assert run.n_scored(call) == 0
    alarms = {found.rule for found in run.violations()}
    assert alarms == {"upload damaged"}, f"the check of the records says {alarms}"
    _flip_a_bit(path)  # so that the checker may ask for every file
    return "failed: upload_damaged, never scored; the check of the records names the file"


def _flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)


def split_missing(run: Run) -> str:
    """The split is away: nothing is scored until it is back."""
    return _until_it_is_back(run, _remove)


def _remove(path: Path) -> None:
    path.unlink()


def split_changed(run: Run) -> str:
    """The split is another one than was registered: nothing is scored until that is back."""
    return _until_it_is_back(run, lambda path: path.write_bytes(_changed(path.read_bytes())))


def _until_it_is_back(run: Run, do_harm: Callable[[Path], object]) -> str:
    path = run.topology.splits / "sample" / "split.json.gz"
    whole = path.read_bytes()
    run.upload()
    run.settle()
    for is_started_anew in (False, True):
        if is_started_anew:
            run.topology.worker.hold_down()
        do_harm(path)
        if is_started_anew:
            run.topology.worker.start()
            run.topology.wait_until(lambda: run.topology.readiness().get("live_workers"), "workers")
        calls = _staying_queued(run)
        path.write_bytes(whole)
        run.settle()
        assert all(run.status_of(call) is SubmissionStatus.SCORED for call in calls)
    return (
        "stayed queued with 0 attempts, also of a worker that had it; scored when the file was back"
    )


def _staying_queued(run: Run) -> list[Call]:
    refusals = _n_refusals(run)
    calls = [run.upload(), run.upload("beta")]
    run.topology.wait_until(lambda: _n_refusals(run) > refusals, "a worker to refuse the split")
    assert all(run.job_of(call).attempts == 0 for call in calls), "an attempt was used up"
    assert all(run.job_of(call).state is WorkState.QUEUED for call in calls)
    return calls


def _n_refusals(run: Run) -> int:
    return run.topology.worker.log.read_text().count("split unavailable: its jobs stay queued")


def _changed(whole: bytes) -> bytes:
    document = json.loads(gzip.decompress(whole))
    document["samples"][0]["region"][0][0] += 0.5
    return gzip.compress(json.dumps(document).encode())


def _mount(run: Run, *arguments: str) -> None:
    subprocess.run(["mount", *arguments, str(run.topology.uploads)], check=True)


def _turn_read_only(run: Run) -> None:
    _mount(run, "-o", "remount,ro")


def why_no_mount() -> str | None:
    """Say why no small or read-only file system can be mounted, if so."""
    if os.getuid() == 0 and shutil.which("mount") is not None:
        return None
    return "needs root and `mount`, for a file system of its own"
