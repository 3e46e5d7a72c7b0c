"""Faults of workers: killed, stopped, frozen, poisoned."""

import os
import signal
import time

from tests.chaos.history import Call
from tests.chaos.run import Hit, Run
from tests.chaos.saboteur import VISIBILITY_S, VISIBILITY_TIMEOUT
from tests.chaos.topology import LEASE_S, MAX_ATTEMPTS, PATIENT

from exceptiondrive_records.operations.overview import overview
from exceptiondrive_records.submissions.submissions import submission_page
from exceptiondrive_records.work.tables import WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus

_DRAINS_WITHIN_S = 10.0
_DELIVERS_AGAIN = "hget"
"""Kombu reads a message that nobody acknowledged only to deliver it again, and nothing else by this command."""


def kill_children(run: Run) -> str:
    """The team of one that is hit sees its next attempt, and then its score."""
    before = run.n_retried()
    run.slowly(0.5)
    victim = run.upload(order="1.5")
    run.topology.wait_until(lambda: run.job_of(victim).state is WorkState.LEASED, "its lease")
    run.clients.stream(7)
    killed = 0
    for _ in range(3):
        run.wait_for_lease()
        killed += run.topology.worker.kill_children()
        time.sleep(0.6)
    assert killed, "no child was killed"
    run.at_full_speed()
    run.topology.wait_until(lambda: _attempt_shown(run, victim) >= 2, "its team to see a retry")
    run.settle()
    retried = run.n_retried() - before
    assert retried, "no job was taken up again"
    run.require_scored([victim])
    return f"{killed} children killed, {retried} jobs retried; a team saw attempt 2, then its score"


def _attempt_shown(run: Run, call: Call) -> int:
    place = run.clients.show(call)["queue"]
    return 0 if place is None else int(place["attempts"])


def kill_parent(run: Run) -> str:
    held = _in_the_middle(run)
    before = run.topology.worker.starts
    run.topology.worker.end(signal.SIGKILL)
    run.topology.wait_until(lambda: run.topology.worker.starts > before, "a restart")
    return _taken_up(run, held)


def kill_group(run: Run) -> str:
    held = _in_the_middle(run)
    run.topology.worker.kill_group()
    return _taken_up(run, held)


def _in_the_middle(run: Run) -> Hit:
    """Let a stream come, and return the jobs that are scored just now and for a while."""
    run.slowly(1.5)
    run.clients.stream(8)
    run.wait_for_lease()
    return run.held()


def _taken_up(run: Run, held: Hit) -> str:
    """Wait until all is well again; whatever was in the middle is begun after its lease."""
    run.at_full_speed()
    back_at = run.until_a_new_worker(held)
    took_s = run.settle()
    return f"settled {took_s:.1f} s after the stream; {run.require_taken_up(held, back_at)}"


def terminate(run: Run) -> str:
    run.slowly(0.5)
    run.clients.stream(6)
    run.wait_for_lease()
    retried = run.n_retried()
    began = time.monotonic()
    code = run.topology.worker.stop()
    took_s = time.monotonic() - began
    left = run.count(WorkState.LEASED)
    run.at_full_speed()
    run.topology.worker.start()
    run.settle()
    assert code == 0, f"exit code {code}"
    assert took_s < _DRAINS_WITHIN_S, f"it took {took_s:.1f} s to stop"
    assert left == 0, "a job was left in the middle"
    assert run.n_retried() == retried, "a job was taken twice"
    return f"drained in {took_s:.1f} s, exit 0, no attempt lost"


def quit_at_once(run: Run) -> str:
    held = _in_the_middle(run)
    run.topology.worker.end(signal.SIGQUIT)
    return _taken_up(run, held)


def freeze_past_the_lease(run: Run) -> str:
    """Freeze a worker in the middle of scoring; another one takes its jobs; then let it go on."""
    run.slowly(2.0)
    stale = run.lines("stale fence rejected")
    run.clients.stream(6, every_s=0.02)
    frozen = run.topology.worker
    _freeze_while_it_scores(run)
    other = run.topology.add_worker()
    time.sleep(LEASE_S + 2)
    run.at_full_speed()
    run.clients.join()
    run.topology.wait_until(lambda: not run.count(WorkState.QUEUED, WorkState.LEASED), "the other")
    n_sheets = run.n_sheets()
    for child in frozen.children:  # before their parent, which would end them for lasting too long
        os.kill(child, signal.SIGCONT)
    run.topology.wait_until(lambda: run.lines("stale fence rejected") > stale, "a late write", 20)
    frozen.thaw()
    time.sleep(2)
    run.settle()
    run.topology.remove_worker(other)
    refused = run.lines("stale fence rejected") - stale
    assert run.n_sheets() == n_sheets, "a late worker wrote a score"
    return f"{refused} late writes refused by the fence, and audited"


def _freeze_while_it_scores(run: Run) -> None:
    for _ in range(20):
        run.wait_for_lease()
        run.topology.freeze_between_writes()
        if run.held().jobs:
            return
        run.topology.worker.thaw()
    raise AssertionError("each job had ended when the worker was frozen")


def poison(run: Run) -> str:
    """A file whose scoring kills its process each time, among healthy ones."""
    used, start_s = run.used_today("alpha"), run.history.now_s()
    poisoned = run.upload(order="kill")
    run.clients.stream(6)
    run.settle()
    others = [call for call in run.calls_since(start_s) if call.file_digest != poisoned.file_digest]
    cost = sum(call.team == "alpha" and call.is_accepted for call in others)
    with run.topology.database.read() as session:
        listed, _ = submission_page(session, status=SubmissionStatus.FAILED, limit=50)
        told = {row.id for row in listed if overview(session).n_failed}
    assert run.failure_of(poisoned) == "attempts_exhausted"
    assert run.job_of(poisoned).state is WorkState.DEAD
    assert run.job_of(poisoned).attempts == MAX_ATTEMPTS
    assert run.used_today("alpha") == used + cost, "our own failure cost quota"
    assert poisoned.submission_id in told, "no organizer is told"
    run.require_scored(others)
    return f"dead after {MAX_ATTEMPTS} attempts, organizers told, no quota used; the others scored"


def endless_loop(run: Run) -> str:
    """One scoring run that never ends in Python, one in C."""
    soft, hard = run.upload("alpha", "loop"), run.upload("beta", "loop-in-c")
    start_s = run.history.now_s()
    run.clients.stream(4)
    run.settle(240)
    attempts = [run.job_of(call).attempts for call in (soft, hard)]
    assert run.failure_of(soft) == "time_limit"
    assert run.failure_of(hard) == "attempts_exhausted"
    assert attempts == [MAX_ATTEMPTS] * 2, f"attempts {attempts}"
    run.require_scored(run.calls_since(start_s))
    codes = f"{run.failure_of(soft)}, {run.failure_of(hard)}"
    return f"both failed ({codes}) after {MAX_ATTEMPTS} attempts, the others scored"


def too_much_memory(run: Run) -> str:
    hungry = run.upload(order="allocate")
    start_s = run.history.now_s()
    run.clients.stream(4)
    run.settle()
    assert run.failure_of(hungry) == "out_of_memory"
    assert run.job_of(hungry).attempts == MAX_ATTEMPTS
    run.require_scored(run.calls_since(start_s))
    return f"{run.failure_of(hungry)} after {MAX_ATTEMPTS} attempts, the others scored"


def kill_everything(run: Run) -> str:
    """API, reconcilers, worker and broker at once, in the middle; then start them again."""
    held = _in_the_middle(run)
    for process in run.topology.supervisor.processes:
        process.kill_group()
    with run.topology.broker.down():
        time.sleep(1)
    return _taken_up(run, held)


def outlast_the_visibility_timeout(run: Run) -> str:
    """The broker would deliver again after 1 s what is not acknowledged; the job takes 3 s."""
    run.topology.worker.hold_down()
    environment = {VISIBILITY_S: "1", **PATIENT}
    impatient = [run.topology.add_worker(environment=environment) for _ in range(2)]
    run.topology.wait_until(
        lambda: run.topology.readiness().get("live_workers", 0) >= 4, "two more"
    )
    scored, stale = run.lines("submission scored"), run.lines("stale fence rejected")
    n_again = run.topology.broker.n_calls(_DELIVERS_AGAIN)
    call = run.upload(order="3")
    run.settle()
    time.sleep(2)
    n_again = run.topology.broker.n_calls(_DELIVERS_AGAIN) - n_again
    attempts = run.job_of(call).attempts
    for worker in impatient:
        run.topology.remove_worker(worker)
    run.topology.worker.start()
    timeouts = [VISIBILITY_TIMEOUT in worker.log.read_text() for worker in impatient]
    assert timeouts == [True, True], "the timeout is as long as ever"
    assert n_again == 0, f"{n_again} messages were delivered again"
    assert attempts == 1, f"it ran {attempts} times"
    assert run.lines("submission scored") == scored + 1
    assert run.lines("stale fence rejected") == stale
    return "a job three times as long as the timeout: one execution, no message delivered again"
