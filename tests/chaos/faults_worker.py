"""Faults of workers: killed, stopped, frozen, poisoned."""

import signal
import time

from tests.chaos.run import Run
from tests.chaos.saboteur import VISIBILITY_S
from tests.chaos.topology import LEASE_S

from exceptiondrive_records.tables import JobState
from exceptiondrive_schemas.submission import SubmissionStatus


def kill_children(run: Run) -> str:
    run.slowly(0.5)
    run.clients.stream(8)
    killed = 0
    for _ in range(3):
        run.wait_for_lease()
        killed += run.topology.worker.kill_children()
        time.sleep(0.6)
    run.at_full_speed()
    run.settle()
    assert killed, "no child was killed"
    assert run.n_retried(), "no job was taken up again"
    return f"{killed} children killed, {run.n_retried()} jobs retried"


def kill_parent(run: Run) -> str:
    run.slowly(0.5)
    run.clients.stream(8)
    run.wait_for_lease()
    before = run.topology.worker.starts
    run.topology.worker.send(signal.SIGKILL)
    run.topology.wait_until(lambda: run.topology.worker.starts > before, "a restart")
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream; restarted"


def kill_group(run: Run) -> str:
    run.slowly(0.5)
    run.clients.stream(8)
    run.wait_for_lease()
    run.topology.worker.kill_group()
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream"


def terminate(run: Run) -> str:
    run.slowly(0.5)
    retried = run.n_retried()
    run.clients.stream(6)
    run.wait_for_lease()
    began = time.monotonic()
    code = run.topology.worker.stop()
    took_s = time.monotonic() - began
    left = run.count(JobState.LEASED)
    run.at_full_speed()
    run.topology.worker.start()
    run.settle()
    assert code == 0, f"exit code {code}"
    assert left == 0, "a job was left in the middle"
    assert run.n_retried() == retried, "a job was taken twice"
    return f"drained in {took_s:.1f} s, exit 0, no attempt lost"


def quit_at_once(run: Run) -> str:
    run.slowly(0.5)
    run.clients.stream(6)
    run.wait_for_lease()
    run.topology.worker.send(signal.SIGQUIT)
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream"


def freeze_past_the_lease(run: Run) -> str:
    """Freeze a worker in the middle of scoring; another one takes its jobs; then let it go on."""
    run.slowly(1.0)
    stale = run.lines("stale fence rejected")
    run.clients.stream(4, every_s=0.02)
    run.wait_for_lease()
    frozen = run.topology.worker
    frozen.send_group(signal.SIGSTOP)
    other = run.topology.add_worker()
    time.sleep(LEASE_S + 2)
    run.at_full_speed()
    run.clients.join()
    run.topology.wait_until(lambda: not run.count(JobState.QUEUED, JobState.LEASED), "the other")
    n_sheets = run.n_sheets()
    frozen.send_group(signal.SIGCONT)
    time.sleep(2)
    run.settle()
    run.topology.remove_worker(other)
    refused = run.lines("stale fence rejected") - stale
    assert run.n_sheets() == n_sheets, "a late worker wrote a score"
    return f"{refused} late writes refused by the fence"


def poison(run: Run) -> str:
    """A file whose scoring kills its process each time, among healthy ones."""
    poisoned = run.upload(order="kill")
    run.clients.stream(6)
    run.settle()
    assert run.status_of(poisoned) is SubmissionStatus.FAILED
    assert run.job_of(poisoned).state is JobState.DEAD
    return f"dead after {run.job_of(poisoned).attempts} attempts, the others scored"


def endless_loop(run: Run) -> str:
    """One scoring run that never ends in Python, one in C."""
    soft, hard = run.upload("alpha", "loop"), run.upload("beta", "loop-in-c")
    run.clients.stream(4)
    run.settle(240)
    assert run.failure_of(soft) == "time_limit"
    assert run.status_of(hard) is SubmissionStatus.FAILED
    return f"both failed ({run.failure_of(soft)}, {run.failure_of(hard)}), the others scored"


def too_much_memory(run: Run) -> str:
    hungry = run.upload(order="allocate")
    run.clients.stream(4)
    run.settle()
    assert run.failure_of(hungry) == "out_of_memory"
    return f"{run.failure_of(hungry)} after {run.job_of(hungry).attempts} attempts"


def kill_everything(run: Run) -> str:
    """API, reconcilers, worker and broker at once, in the middle; then start them again."""
    run.slowly(0.4)
    run.clients.stream(8)
    run.wait_for_lease()
    for process in run.topology.supervisor.processes:
        process.kill_group()
    run.topology.broker.kill()
    time.sleep(1)
    run.topology.broker.start()
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream"


def outlast_the_visibility_timeout(run: Run) -> str:
    """The broker would deliver again after 1 s what is not acknowledged; the job takes 3 s."""
    run.topology.worker.hold_down()
    impatient = [run.topology.add_worker(environment={VISIBILITY_S: "1"}) for _ in range(2)]
    run.topology.wait_until(lambda: run.topology.readiness()["live_workers"] >= 4, "two more")
    scored, stale = run.lines("submission scored"), run.lines("stale fence rejected")
    call = run.upload(order="3")
    run.wait_for_lease()
    with run.topology.broker.client() as client:
        held = client.hlen("ed:unacked")
    run.settle()
    time.sleep(2)
    attempts = run.job_of(call).attempts
    for worker in impatient:
        run.topology.remove_worker(worker)
    run.topology.worker.start()
    assert held == 0, f"{held} messages wait for an acknowledgement"
    assert attempts == 1, f"it ran {attempts} times"
    assert run.lines("submission scored") == scored + 1
    assert run.lines("stale fence rejected") == stale
    return "a job three times as long as the timeout: one execution, 0 messages unacknowledged"
