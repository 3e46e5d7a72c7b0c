"""Faults of the broker and of the way to it."""

import signal
import time

from tests.chaos.run import Run, slowest_s

from exceptiondrive_records.doorbell import Doorbell
from exceptiondrive_records.tables import Job

_SLOWEST_UPLOAD_S = 10.0


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
    start_s = run.history.now_s()
    run.topology.broker.process.send_signal(signal.SIGSTOP)
    run.clients.stream(6)
    run.clients.join()
    time.sleep(3)
    run.topology.broker.process.send_signal(signal.SIGCONT)
    slowest = slowest_s(run.calls_since(start_s))
    assert slowest < _SLOWEST_UPLOAD_S, f"an upload took {slowest:.1f} s"
    return f"slowest upload {slowest:.2f} s, settled in {run.settle():.1f} s"


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
    run.clients.stream(6)
    with run.topology.broker.client() as client:
        for rubbish in (b"junk", b"{}", b'{"body": 1}', b"\x00\xff", b"[]"):
            client.lpush("ed:live", rubbish)
    before = run.topology.worker.starts
    took_s = run.settle()
    return (
        f"settled in {took_s:.1f} s; restarts of the worker: {run.topology.worker.starts - before}"
    )


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
