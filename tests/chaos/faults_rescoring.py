"""Faults of a rescoring: what teams submit overtakes it, and nothing ends it half-way."""

import json
import time

from sqlalchemy import select
from sqlalchemy.orm import Session
from tests.chaos.run import OPEN, Run
from tests.chaos.topology import PHASE

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.phases.scoring_keys import shadow_key
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.rescoring.changes import create_run, resume_run, start_run
from exceptiondrive_records.rescoring.flip import apply_run, comparison_of, rollback_run
from exceptiondrive_records.rescoring.progress import failed_sheets, progress_of
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.jobs import EXHAUSTED_CODE
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.rescoring import RunState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_worker.failures import FailureCode

_LONGEST_LIVE_WAIT_S = 30.0
_PATIENCE_S = 1200
_TIME_LIMIT = frozenset({FailureCode.TIME_LIMIT.value})
_OUR_LIMITS = _TIME_LIMIT | {EXHAUSTED_CODE}


def rescore_while_submitting(run: Run) -> str:
    """A protocol update over a thousand submissions; what teams submit meanwhile overtakes it.

    The board stays until the run is applied, and is what it was when that is rolled back.
    """
    n_jobs = 60 if run.is_short else 1000
    _submit_until(run, n_jobs)
    old, start_s = _shown_board(run), run.history.now_s()
    if run.is_short:
        run.slowly(0.1)
    rescoring = _start_run(run, "1.0-chaosa")
    run.topology.wait_until(lambda: run.n_sheets_under(rescoring), "the rescoring to begin")
    run.clients.stream(20, every_s=0)
    run.clients.join()
    run.topology.wait_until(lambda: not run.count(*OPEN, lane=Lane.LIVE), "live jobs")
    left = n_jobs - run.n_sheets_under(rescoring)
    run.at_full_speed()
    waits_s = [run.wait_of_s(call) for call in run.calls_since(start_s) if call.is_accepted]
    _, n_again = _until_ready(run, rescoring, _OUR_LIMITS)
    run.settle(600)
    before, seen = _shown_board(run), _protocols_seen(run, start_s)
    _apply(run, rescoring)
    applied = _shown_board(run)
    _roll_back(run, rescoring)
    assert left > 0, "nothing was overtaken: every sheet was made before"
    assert max(waits_s) < _LONGEST_LIVE_WAIT_S, f"a live job waited {max(waits_s):.0f} s"
    assert seen <= {old[0]}, "a reader saw the new protocol before anyone applied it"
    assert (before[0], applied[0] != old[0]) == (old[0], True), "it was not applied when asked"
    assert _shown_board(run) == before, "rolled back, the board is another one"
    told = "the board changed when it was applied, and back"
    waited = f"20 live jobs waited up to {max(waits_s):.1f} s; {left} of {n_jobs} were left"
    return f"{waited}; {told}{_tried_again(n_again)}"


def _until_ready(run: Run, run_id: str, may_fail_by: frozenset[str]) -> tuple[float, int]:
    """Wait for a run, and do what organizers do: what failed by a limit of time is tried again.

    Limits here are twenty times as strict as usual, and a busy machine meets them. Whatever fails
    otherwise stays failed, and the run never becomes ready.

    Returns:
        Seconds until it was ready, and how many sheets were tried again by hand.
    """
    started, n_again = time.monotonic(), 0
    while (state := _state(run, run_id)) is not RunState.READY:
        with run.topology.database.write() as session:
            found = find_run(session, run_id)
            failed = _failures_of(session, found)
            if failed and set(failed) <= may_fail_by:
                n_again += len(failed)
                resume_run(session, run_id, reason="chaos", actor="chaos")
            progress = progress_of(session, found)
        if time.monotonic() > started + _PATIENCE_S:
            raise TimeoutError(f"{state} after {_PATIENCE_S} s: {progress}, failed by {failed}")
        time.sleep(0.2)
    return time.monotonic() - started, n_again


def _failures_of(session: Session, run: RescoringRun) -> list[str]:
    """Why the sheets failed that a run lacks."""
    failed = failed_sheets(run.phase_id, shadow_key(run)).with_only_columns(Submission.id)
    query = select(Job.note).where(
        Job.submission_id.in_(failed), Job.protocol_digest == run.to_protocol_digest
    )
    return [note or EXHAUSTED_CODE for note in session.scalars(query)]


def _tried_again(n_again: int) -> str:
    return f"; {n_again} met a limit of time and were tried again by hand" if n_again else ""


def _protocols_seen(run: Run, since_s: float) -> set[str]:
    """The protocols of all boards that readers saw since then."""
    boards = [seen.body for seen in run.history.so_far().boards if seen.at_s >= since_s]
    return {json.loads(body)["protocol"]["digest"] for body in boards}


def _apply(run: Run, rescoring: str) -> None:
    with run.topology.database.write() as session:
        compared = comparison_of(session, find_run(session, rescoring))
        assert compared is not None, "there is no preview"
        preview = compared.digest
        apply_run(session, rescoring, preview=preview, reason="seen", actor="chaos")
        applied = find_run(session, rescoring).to_protocol_digest
    run.topology.wait_until(lambda: _newest_seen(run) == applied, "a reader to see the new board")


def _newest_seen(run: Run) -> str:
    """The protocol of the board that readers saw last."""
    digest: str = json.loads(run.history.so_far().boards[-1].body)["protocol"]["digest"]
    return digest


def _roll_back(run: Run, rescoring: str) -> None:
    run.settle()
    with run.topology.database.write() as session:
        rollback_run(session, rescoring, reason="chaos is over", actor="chaos")
    run.settle()


def kill_in_mid_rescore(run: Run) -> str:
    """The board stays the old protocol's; the run goes on by itself until it is ready."""
    topology = run.topology
    _submit_until(run, 60)
    run.settle(300)
    shown = _shown_board(run)
    run.slowly(0.1)
    rescoring = _start_run(run, "1.0-chaosb")
    topology.wait_until(lambda: run.n_sheets_under(rescoring) >= 5, "the middle")
    done = run.n_sheets_under(rescoring)
    for process in topology.supervisor.processes:
        process.kill_group()
    with topology.broker.down():
        run.at_full_speed()
    took_s, n_again = _until_ready(run, rescoring, _TIME_LIMIT)
    run.settle(300)
    n_jobs = run.n_sheets_under(rescoring)
    assert done < n_jobs, "nothing was left when they were killed"
    assert _shown_board(run) == shown, "the board changed before anyone applied anything"
    _apply(run, rescoring)
    assert _shown_board(run) != shown, "it could not be applied"
    _roll_back(run, rescoring)
    assert _shown_board(run) == shown, "rolled back, the board is another one"
    told = f"killed with {done} of {n_jobs} done; ready {took_s:.1f} s later, board unchanged"
    return told + _tried_again(n_again)


def _submit_until(run: Run, n_sheets: int) -> None:
    while (missing := n_sheets - run.n_sheets()) > 0:
        for _ in range(2):
            run.clients.stream((missing + 1) // 2, every_s=0)
        run.settle(600)


def _start_run(run: Run, version: str) -> str:
    """Begin a protocol update, with another d_safe than the phase's."""
    toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"', 1)
    toml = toml.replace("d_safe_scale = 1.0", "d_safe_scale = 1.5", 1)
    with run.topology.database.write() as session:
        protocol = add_protocol(session, toml, "chaos")
        made = create_run(session, PHASE, protocol=protocol.digest, reason="chaos", actor="chaos")
        start_run(session, made.id, reason="chaos", actor="chaos")
        return made.id


def _state(run: Run, run_id: str) -> RunState:
    with run.topology.database.read() as session:
        return find_run(session, run_id).state


def _shown_board(run: Run) -> tuple[str, str]:
    with run.topology.database.read() as session:
        board = current_board(session, PHASE)
    assert board is not None
    return board.protocol_digest, board.body_digest
