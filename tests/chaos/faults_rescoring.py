"""Faults of a rescoring: what teams submit overtakes it, and nothing ends it half-way."""

from sqlalchemy import select
from tests.chaos.run import OPEN, Run
from tests.chaos.topology import PHASE

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.database import database_now
from exceptiondrive_records.phases.scoring_keys import find_run
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.rescoring.runs import cancel_run, create_run, start_run
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.jobs import new_job
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.rescoring import RunState
from exceptiondrive_schemas.submission import SubmissionStatus

_N_SUBMISSIONS = 100
_N_PROTOCOLS = 10
_LONGEST_LIVE_WAIT_S = 30.0


def rescore_while_submitting(run: Run) -> str:
    """A thousand rescoring jobs wait; what teams submit meanwhile overtakes them."""
    versions = [f"1.0-chaosa{number}" for number in range(_N_PROTOCOLS)]
    n_jobs = sum(_add_rescoring(run, version, _N_SUBMISSIONS) for version in versions)
    shown = _shown_protocol(run)
    start_s = run.history.now_s()
    run.clients.stream(20)
    run.clients.join()
    run.topology.wait_until(lambda: not run.count(*OPEN, lane=Lane.LIVE), "live jobs")
    left = run.count(*OPEN, lane=Lane.RESCORE)
    assert _shown_protocol(run) == shown, "the board changed before anyone applied anything"
    waits_s = [run.wait_of_s(call) for call in run.calls_since(start_s) if call.is_accepted]
    run.settle(600)
    assert n_jobs == _N_SUBMISSIONS * _N_PROTOCOLS
    assert left, "nothing was overtaken: all rescoring jobs were done before"
    assert max(waits_s) < _LONGEST_LIVE_WAIT_S, f"a live job waited {max(waits_s):.0f} s"
    assert _shown_protocol(run) == shown
    return f"20 live jobs waited up to {max(waits_s):.1f} s; {left} of {n_jobs} were left then"


def _shown_protocol(run: Run) -> str:
    with run.topology.database.read() as session:
        board = current_board(session, PHASE)
    assert board is not None
    return board.protocol_digest


def kill_in_mid_rescore(run: Run) -> str:
    """The board stays the old protocol's; the run goes on by itself until it is ready."""
    topology = run.topology
    _submit_until(run, 60)
    run.settle(300)
    shown = _shown_board(run)
    run.slowly(0.1)
    rescoring = _start_run(run, "1.0-chaosb")
    topology.wait_until(lambda: run.n_sheets_under(rescoring) >= 5, "the middle")
    pids = [process.pid for process in topology.supervisor.processes]
    broker_pid = topology.broker.process.pid
    done = run.n_sheets_under(rescoring)
    for process in topology.supervisor.processes:
        process.kill_group()
    topology.broker.kill()
    topology.broker.start()
    run.at_full_speed()
    took_s = topology.wait_until(lambda: _state(run, rescoring) is RunState.READY, "ready", 300)
    run.settle(300)
    now = [process.pid for process in topology.supervisor.processes]
    n_jobs = run.n_sheets_under(rescoring)
    assert not set(pids) & set(now), "a process was not killed"
    assert topology.broker.process.pid != broker_pid, "the broker was not killed"
    assert done < n_jobs, "nothing was left when they were killed"
    assert _shown_board(run) == shown, "the board changed before anyone applied anything"
    with topology.database.write() as session:
        cancel_run(session, rescoring, reason="seen enough", actor="chaos")
    return f"killed with {done} of {n_jobs} done; ready by itself {took_s:.1f} s later, board unchanged"


def _submit_until(run: Run, n_sheets: int) -> None:
    while run.n_sheets() < n_sheets:
        run.clients.stream(n_sheets - run.n_sheets(), every_s=0)
        run.settle(300)


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


def _add_rescoring(run: Run, version: str, n_jobs: int) -> int:
    """Queue up to `n_jobs` scored submissions under a protocol with another d_safe."""
    toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"', 1)
    _submit_until(run, n_jobs)
    with run.topology.database.write() as session:
        protocol = add_protocol(session, toml, "chaos")
        now = database_now(session)
        query = select(Submission).where(Submission.status == SubmissionStatus.SCORED)
        found = list(session.scalars(query.limit(n_jobs)))
        phase = session.get_one(Phase, PHASE)
        for submission in found:
            lane = Lane.RESCORE
            session.add(
                new_job(submission, protocol.digest, phase.split_revision, lane, False, now)
            )
    return len(found)
