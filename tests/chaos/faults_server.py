"""Faults of API, reconcilers, database, clocks and records."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from sqlalchemy import func, select, text
from tests.chaos.history import Call
from tests.chaos.processes import state_of
from tests.chaos.run import OPEN, Run
from tests.chaos.topology import PHASE

from exceptiondrive.receipts import verify_receipt
from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.dispatch import KEY_PREFIX
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane


def kill_api_before_commit(run: Run) -> str:
    """The file is stored, the row is not: the client tries again."""
    run.topology.order("kill-before-commit")
    call = run.upload()
    run.settle()
    assert _tries(run, call.file_digest) > 1, "the API was not killed"
    assert call.status == 202, f"the second try was told {call.status}"
    assert _n_rows(run, call) == 1, "an orphan row"
    return f"{_tries(run, call.file_digest)} tries, one submission, 202"


def kill_api_after_commit(run: Run) -> str:
    """The row is there, the answer is not: trying again gives the same submission."""
    run.topology.order("kill-after-commit")
    data = run.clients.new_file()
    call = run.clients.submit(data, "alpha")
    run.settle()
    again = run.clients.submit(data, "alpha")
    assert _tries(run, call.file_digest) > 2, "the API was not killed"
    assert call.status == again.status == 200, f"told {call.status}, then {again.status}"
    assert call.submission_id == again.submission_id
    assert _n_rows(run, call) == 1, "one upload, two submissions"
    _require_receipt(run, call)
    return f"{_tries(run, call.file_digest) - 1} tries, the same submission, 200, its receipt holds"


def _require_receipt(run: Run, call: Call) -> None:
    """The receipt of a submission is signed, and tells of these bytes."""
    receipt, keys = (run.topology.folder / name for name in ("receipt.json", "receipt-keys.json"))
    receipt.write_text(json.dumps(run.clients.show(call, "/receipt")))
    keys.write_text(json.dumps(run.clients.receipt_keys()))
    signed = verify_receipt(receipt, keys=keys).receipt.statement
    assert (signed.submission_id, signed.file_digest) == (call.submission_id, call.file_digest)


def kill_api(run: Run) -> str:
    server, start_s = run.topology.server, run.history.now_s()
    run.clients.stream(8, every_s=0.2)
    time.sleep(0.5)
    server.kill_group()
    took_s = run.settle()
    calls = run.calls_since(start_s)
    before = [call for call in calls if call.started_s < start_s + 0.5]
    assert 0 < len(before) < len(calls), "it was not killed in the middle of the stream"
    run.require_scored(calls)
    return f"another process serves; settled {took_s:.1f} s after the stream"


def kill_leader(run: Run) -> str:
    """Two reconcilers: the leader dies, the other takes over."""
    run.slowly(0.3)
    run.clients.stream(10, every_s=0.02)
    before = run.leader()
    for process in run.topology.reconcilers:
        if before is not None and f":{process.pid}:" in before:
            leader = process.pid
            process.hold_down()
            break
    else:
        raise AssertionError(f"none of the two leads: {before}")
    assert state_of(leader) == "Z", "the leader lives"
    took_s = run.topology.wait_until(lambda: run.leader() != before, "another leader")
    process.start()
    most, alive = _most_messages(run)
    run.at_full_speed()
    run.settle()
    assert most <= alive + _AT_ONCE, f"{most} messages waited, {alive} workers live"
    return f"the other led after {took_s:.1f} s; at most {most} messages waited ({alive} workers)"


_AT_ONCE = 2
"""Whoever wakes a lane looks how many messages wait, then sends: some may look at once."""


def _most_messages(run: Run) -> tuple[int, int]:
    """Watch the lane of the teams until all is scored: messages that wait, and workers."""
    most, alive = 0, 1

    def is_done() -> bool:
        nonlocal most, alive
        with run.topology.database.read() as session:
            alive = max(alive, live_workers(session, Lane.LIVE))
        with run.topology.broker.client() as client:
            most = max(most, int(client.llen(f"{KEY_PREFIX}{Lane.LIVE.value}")))
        return not run.clients.is_streaming() and not run.count(*OPEN, lane=Lane.LIVE)

    run.topology.wait_until(is_done, "all to be scored")
    return most, alive


def kill_postgres(run: Run) -> str:
    assert run.topology.postgres is not None
    start_s = run.history.now_s()
    run.slowly(0.3)
    run.clients.stream(8)
    run.wait_for_lease()
    run.topology.postgres.kill()
    assert not run.topology.postgres.answers(), "the database answers"
    time.sleep(1)
    run.topology.postgres.start()
    run.at_full_speed()
    took_s = run.settle()
    calls = run.calls_since(start_s)
    unavailable = [call for call in calls if call.status == 503]
    assert unavailable, "nobody noticed that the database was away"
    assert {call.status for call in calls} <= {202, 200, 503}, [call.status for call in calls]
    assert all(call.retry_after for call in unavailable), "a 503 without Retry-After"
    run.require_scored(calls)
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
    clocks = [_clock(library, shift) for shift in ("+1h", "-1h")]
    assert [round(_ahead_s(clock) / 3600) for clock in clocks] == [1, -1], "the clocks are right"
    skewed = [run.topology.add_worker(environment=clock) for clock in clocks]
    run.topology.worker.hold_down()
    run.topology.wait_until(
        lambda: run.topology.readiness().get("live_workers", 0) >= 4, "two more"
    )
    lost, start_s = run.n_lost_leases(), run.history.now_s()
    run.slowly(1.0)  # several passes of the reconciler, less than a lease
    run.clients.stream(8)
    run.wait_for_lease()
    run.clients.join()
    run.at_full_speed()
    run.settle()
    run.require_scored(run.calls_since(start_s))
    for worker in skewed:
        run.topology.remove_worker(worker)
    run.topology.worker.start()
    assert run.n_lost_leases() == lost, "a lease was thought to have expired"
    return "no lease expired early or late"


def _clock(library: Path, shift: str) -> dict[str, str]:
    """The environment of a process whose clock goes wrong by so much."""
    return {
        "LD_PRELOAD": str(library),
        "FAKETIME": shift,
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "57",
        "EXCEPTIONDRIVE_TIME_LIMIT_S": "58",
        "EXCEPTIONDRIVE_LEASE_S": "60",  # an hour is longer, and a full machine does not end it
    }


def _ahead_s(clock: dict[str, str]) -> float:
    """How far the clock of a process that is started so is ahead."""
    command = [sys.executable, "-c", "import time; print(time.time())"]
    environment = {**os.environ, **clock}
    return float(subprocess.check_output(command, env=environment, text=True)) - time.time()


def edited_protocol(run: Run) -> str:
    """Someone edits a protocol in the database: what names it is refused, not scored by it."""
    run.topology.worker.hold_down()
    call = run.upload()
    _edit_protocol(run, "4.084", "4.085")
    run.topology.worker.start()
    time.sleep(3)
    assert run.n_scored(call) == 0, "it was scored under an altered protocol"
    alarms = {found.rule for found in run.violations(is_settled=False)}
    assert "protocol altered" in alarms, f"the check of the records says {alarms}"
    _edit_protocol(run, "4.085", "4.084")
    run.topology.worker.kill_group()
    run.settle()
    assert run.n_scored(call) == 1
    return "not scored while altered; scored once the text was right again"


def withdrawn(run: Run) -> str:
    """A submission is withdrawn while it is being scored."""
    withdrawn, stale = run.lines("submission withdrawn"), run.lines("stale fence rejected")
    run.slowly(1.5)
    data = run.clients.new_file()
    call = run.clients.submit(data, "alpha")
    run.wait_for_lease()
    status = run.clients.withdraw(call)
    run.at_full_speed()
    run.topology.wait_until(lambda: run.lines("stale fence rejected") > stale, "the late score")
    again = run.clients.submit(data, "alpha")
    run.settle()
    assert status == 200
    assert run.status_of(call) is SubmissionStatus.WITHDRAWN
    assert run.n_scored(call) == 0, "a withdrawn submission was scored"
    assert run.lines("submission withdrawn") == withdrawn + 1
    assert again.status == 202, f"the same file again was told {again.status}"
    assert again.submission_id != call.submission_id
    run.require_scored([again])
    return "tombstone and audit line kept, the late score refused; the same file counts again"


def taken_out_by_mistake(run: Run) -> str:
    """An organizer takes the wrong entry out while others submit, and gives it back."""
    call = run.upload()
    run.settle()
    scored, restored = run.n_scored(call), run.lines("submission restored")
    assert call.submission_id in _on_board(run)
    with run.topology.database.write() as session:
        token, _ = issue_token(session, None, "organizer", ORGANIZER_SCOPES, actor="chaos")
    others = [run.upload("beta")]
    assert run.clients.withdraw(call, token) == 200
    run.settle()
    assert run.status_of(call) is SubmissionStatus.WITHDRAWN
    assert call.submission_id not in _on_board(run), "the entry stays on the board"
    assert _n_rows(run, call) == 1, "the tombstone is gone"
    others.append(run.upload("gamma"))
    assert run.clients.restore(call, token) == 200
    run.settle()
    run.require_scored([call, *others])
    assert call.submission_id in _on_board(run), "given back, it is not on the board"
    assert run.n_scored(call) == scored, "it was scored twice"
    assert run.lines("submission restored") == restored + 1
    return "off the board with its tombstone, and back with its old score"


def _on_board(run: Run) -> set[str]:
    with run.topology.database.read() as session:
        board = current_board(session, PHASE)
        entries = [] if board is None else json.loads(board.body)["entries"]
    return {entry["submission_id"] for entry in entries}


def _n_rows(run: Run, call: Call) -> int:
    with run.topology.database.read() as session:
        query = select(func.count()).where(Submission.file_digest == call.file_digest)
        return session.scalar(query) or 0


def _tries(run: Run, digest: str) -> int:
    return sum(call.file_digest == digest for call in run.history.calls)


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
