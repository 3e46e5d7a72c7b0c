"""Faults of the broker and of the way to it."""

import signal
import time

import redis
from tests.chaos.run import Run, percentile, slowest_s

from exceptiondrive_records.broker_options import KEY_PREFIX
from exceptiondrive_records.doorbell import Doorbell
from exceptiondrive_records.tables import Job
from exceptiondrive_schemas.jobs import Lane

_P99_UPLOAD_S = 3.0
_FROZEN_S = 15.0
_BACK_WITHIN_S = 5.0
_JUNK = ((Lane.LIVE, b"junk"), (Lane.RESCORE, b'{"body": 1}'), (Lane.LIVE, b"[]"))


def comes_back_empty(run: Run) -> str:
    run.slowly(0.3)
    run.clients.stream(8, every_s=0.05)
    run.wait_for_lease()
    run.topology.broker.kill()
    time.sleep(0.5)
    run.topology.broker.start()
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream"


def down_at_submit(run: Run) -> str:
    start_s = run.history.now_s()
    run.topology.broker.kill()
    run.clients.stream(6)
    run.clients.join()
    calls = run.calls_since(start_s)
    assert [call.status for call in calls] == [202] * 6, "an upload was not taken"
    time.sleep(2)
    run.topology.broker.start()
    return f"6 of 6 taken (slowest {slowest_s(calls):.1f} s), settled in {run.settle():.1f} s"


def flush(run: Run) -> str:
    run.slowly(0.3)
    run.clients.stream(10, every_s=0.02)
    run.wait_for_lease()
    with run.topology.broker.client() as client:
        client.flushall()
    run.at_full_speed()
    return f"settled {run.settle():.1f} s after the stream"


def flap(run: Run) -> str:
    run.clients.stream(8)
    for _ in range(4):
        run.topology.broker.kill()
        time.sleep(0.8)
        run.topology.broker.start()
        time.sleep(0.8)
    return f"settled {run.settle():.1f} s after the stream; worker exits {_exits(run)}"


def freeze(run: Run) -> str:
    """The broker stops answering for 15 s; uploads go on all the while."""
    start_s, began = run.history.now_s(), time.monotonic()
    run.topology.broker.process.send_signal(signal.SIGSTOP)
    while time.monotonic() < began + _FROZEN_S:
        run.clients.stream(4, every_s=0)
        run.clients.join()
        time.sleep(0.5)
    run.topology.broker.process.send_signal(signal.SIGCONT)
    calls = run.calls_since(start_s)
    assert all(call.status == 202 for call in calls), "an upload was not taken"
    p99_s = percentile([call.took_s for call in calls], 0.99)
    took_s = run.settle()
    assert p99_s < _P99_UPLOAD_S, f"99 % of the uploads took up to {p99_s:.1f} s"
    return f"{len(calls)} of {len(calls)} taken, p99 {p99_s:.2f} s, settled in {took_s:.1f} s"


def out_of_memory(run: Run) -> str:
    with run.topology.broker.client() as client:
        client.config_set("maxmemory", "1mb")
        run.clients.stream(6)
        run.clients.join()
        time.sleep(2)
        client.config_set("maxmemory", "64mb")
    return f"all taken, settled {run.settle():.1f} s after there was room again"


def evicts(run: Run) -> str:
    with run.topology.broker.client() as client:
        client.config_set("maxmemory-policy", "allkeys-lru")
        client.config_set("maxmemory", "1mb")
        run.clients.stream(8)
        run.clients.join()
        client.config_set("maxmemory", "64mb")
        client.config_set("maxmemory-policy", "noeviction")
    return f"settled {run.settle():.1f} s after; doctor names the policy"


def junk(run: Run) -> str:
    """What is no message stands in both queues; what comes after it is scored all the same.

    Each may end the worker once; it must be back as soon as after an ordinary restart.
    """
    run.topology.worker.kill_group()
    restart_s = _until_a_job_is_taken(run)
    run.settle()
    before = run.topology.worker.starts
    with run.topology.broker.client() as client:
        for lane, rubbish in _JUNK:
            client.lpush(f"{KEY_PREFIX}{lane.value}", rubbish)
        began = time.monotonic()
        run.topology.wait_until(lambda: not _n_waiting(client), "the queues to be emptied")
    _until_a_job_is_taken(run)
    back_s, restarts = time.monotonic() - began, run.topology.worker.starts - before
    run.clients.stream(6)
    run.settle()
    assert restarts <= len(_JUNK), f"{restarts} restarts for {len(_JUNK)} pieces of junk"
    allowed_s = _BACK_WITHIN_S + 2 * restart_s * max(restarts, 1)
    assert back_s < allowed_s, f"back after {back_s:.1f} s, an ordinary restart: {restart_s:.1f} s"
    return f"{restarts} restarts, next job taken {back_s:.1f} s later ({restart_s:.1f} s for one)"


def _until_a_job_is_taken(run: Run) -> float:
    began = time.monotonic()
    call = run.upload()
    run.topology.wait_until(lambda: run.job_of(call).attempts, "a worker to take the job")
    return time.monotonic() - began


def _n_waiting(client: redis.Redis) -> int:
    return sum(int(client.llen(f"{KEY_PREFIX}{lane.value}")) for lane in Lane)


def deliver_again(run: Run) -> str:
    call = run.upload()
    doorbell = Doorbell(run.topology.environment["EXCEPTIONDRIVE_BROKER_URL"])
    job = run.job_of(call)
    for _ in range(10):
        assert doorbell.ring_score(job.id, job.lane)
    run.clients.stream(4)
    run.settle()
    attempts = run.job_of(call).attempts
    for _ in range(10):
        assert doorbell.ring_score(job.id, job.lane)
    time.sleep(1.5)
    run.settle()
    doorbell.close()
    again: Job = run.job_of(call)
    assert again.attempts == attempts, "a finished job was taken again"
    return f"20 messages more, {again.attempts} attempt"


def silence(run: Run) -> str:
    """Connections stay open and say nothing more, as behind a firewall that forgot them."""
    run.clients.stream(4)
    run.topology.proxy.is_silent = True
    time.sleep(4)
    run.topology.proxy.heal()
    began = time.monotonic()
    run.clients.stream(4)
    run.settle()
    return f"working again after {time.monotonic() - began:.1f} s"


def bad_network(run: Run) -> str:
    run.topology.proxy.delay_s, run.topology.proxy.reset_share = 0.2, 0.05
    run.clients.stream(8)
    run.clients.join()
    time.sleep(2)
    run.topology.proxy.heal()
    return f"settled {run.settle():.1f} s after the stream; worker exits {_exits(run)}"


def _exits(run: Run) -> int:
    return len(run.topology.worker.exit_codes)
