"""Faults of the broker and of the way to it."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import redis
from tests.chaos.history import Call
from tests.chaos.junk import JUNK
from tests.chaos.run import Run, percentile, slowest_s

from exceptiondrive_records.work.dispatch import KEY_PREFIX, Dispatcher
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus as Status
from exceptiondrive_schemas.jobs import Lane

_P99_UPLOAD_S = 3.0
_FROZEN_S = 15.0
_BACK_WITHIN_S = 5.0
_BEGUN_WITHIN_S = 10.0
_CONSUMING_WITHIN_S = 60.0
_DOWN_S = 60.0
_ROOM_BYTES = 2**20
_FILLERS = [f"filler-{number}" for number in range(40)]
_JUNK = ((Lane.LIVE, b"junk"), (Lane.RESCORE, b'{"body": 1}'), (Lane.LIVE, b"[]"))


def comes_back_empty(run: Run) -> str:
    run.slowly(0.3)
    run.clients.stream(8, every_s=0.05)
    run.wait_for_lease()
    with run.topology.broker.down():
        meanwhile = run.upload()
        ready = run.topology.readiness()
        time.sleep(0.5)
    run.at_full_speed()
    took_s = run.settle()
    assert meanwhile.status == 202, f"without a broker it was told {meanwhile.status}"
    assert ready.get("is_ready"), "not ready, though uploads are taken"
    assert "delayed" in ready.get("note", ""), "nobody is told that scoring waits"
    return f"202 meanwhile, told that scoring is delayed; settled {took_s:.1f} s after the stream"


def down_at_submit(run: Run) -> str:
    """The broker is away for a minute, and files keep coming."""
    start_s, down_s = run.history.now_s(), 6.0 if run.is_short else _DOWN_S
    with run.topology.broker.down():
        began = time.monotonic()
        run.clients.stream(12, every_s=down_s / 12)
        run.clients.join()
        calls = run.calls_since(start_s)
        assert [call.status for call in calls] == [202] * 12, _told(calls)
        assert {run.status_of(call) for call in calls} <= {Status.RECEIVED, Status.QUEUED}
        time.sleep(max(0.0, down_s - (time.monotonic() - began)))
    took_s = run.settle()
    run.require_scored(calls)
    slowest = f"slowest {slowest_s(calls):.1f} s"
    return f"12 of 12 taken in {down_s:.0f} s ({slowest}), all waited; settled in {took_s:.1f} s"


def flush(run: Run) -> str:
    run.slowly(0.6)
    run.clients.stream(10, every_s=0.02)
    run.topology.wait_until(lambda: run.count(WorkState.QUEUED) >= 3, "jobs that wait")
    with run.topology.broker.client() as client:
        n_flushes, n_keys = run.topology.broker.n_calls("flushall"), int(client.dbsize())
        client.flushall()
    assert run.topology.broker.n_calls("flushall") > n_flushes, "the broker was not flushed"
    waiting = run.waiting()
    assert n_keys, "the broker held nothing that could be lost"
    assert waiting.jobs, "nothing waited"
    run.at_full_speed()
    took_s = run.settle()
    longest_s = run.longest_wait_s(waiting)
    assert longest_s <= _BEGUN_WITHIN_S, f"one was begun {longest_s:.1f} s after"
    begun = f"the {len(waiting.jobs)} that waited were begun within {longest_s:.1f} s"
    return f"{begun}; settled {took_s:.1f} s after the stream"


def _told(calls: list[Call]) -> str:
    return f"not every upload was taken: {[call.status for call in calls]}"


def flap(run: Run) -> str:
    """Each time that the broker goes, files have begun to come, and go on coming."""
    start_s = run.history.now_s()
    for _ in range(4):
        run.clients.stream(4, every_s=0.2)
        with run.topology.broker.down():
            time.sleep(0.8)
        time.sleep(0.8)
    took_s = run.settle()
    run.require_scored(run.calls_since(start_s))
    return f"settled {took_s:.1f} s after the stream; worker exits {_exits(run)}"


def freeze(run: Run) -> str:
    """The broker stops answering for 15 s; uploads go on all the while."""
    start_s, frozen_s = run.history.now_s(), 4.0 if run.is_short else _FROZEN_S
    with run.topology.broker.frozen():
        began = time.monotonic()
        while time.monotonic() < began + frozen_s:
            run.clients.stream(4, every_s=0)
            run.clients.join()
            time.sleep(0.5)
    calls = run.calls_since(start_s)
    assert all(call.status == 202 for call in calls), _told(calls)
    p99_s = percentile([call.took_s for call in calls], 0.99)
    took_s = run.settle()
    assert p99_s < _P99_UPLOAD_S, f"99 % of the uploads took up to {p99_s:.1f} s"
    return f"{len(calls)} of {len(calls)} taken, p99 {p99_s:.2f} s, settled in {took_s:.1f} s"


def out_of_memory(run: Run) -> str:
    """The broker refuses every write for want of memory; nobody who submits hears of it."""
    start_s = run.history.now_s()
    with run.topology.broker.client() as client:
        client.config_set("maxmemory", "1mb")
        run.clients.stream(6)
        run.clients.join()
        time.sleep(2)
        is_full = _refuses_writes(client)
        client.config_set("maxmemory", "64mb")
    took_s, calls = run.settle(), run.calls_since(start_s)
    assert is_full, "the broker was not full"
    assert [call.status for call in calls] == [202] * 6, _told(calls)
    run.require_scored(calls)
    return f"6 of 6 taken, settled {took_s:.1f} s after there was room again"


def _refuses_writes(client: redis.Redis) -> bool:
    try:
        client.set("full", "1")
    except redis.exceptions.OutOfMemoryError:
        return True
    return False


def evicts(run: Run) -> str:
    """The broker throws the queue away while messages wait in it."""
    run.topology.worker.hold_down()
    start_s = run.history.now_s()
    run.clients.stream(8)
    run.clients.join()
    with run.topology.broker.client() as client:
        room = int(client.info("memory")["used_memory"]) + _ROOM_BYTES
        client.config_set("maxmemory-policy", "allkeys-lru")
        client.config_set("maxmemory", room)
        doctor = _doctor(run)
        pushed = _push_out(client, f"{KEY_PREFIX}{Lane.LIVE.value}")
        client.config_set("maxmemory", "64mb")
        client.config_set("maxmemory-policy", "noeviction")
        client.delete(*_FILLERS)
    run.topology.worker.start()
    took_s, calls = run.settle(), run.calls_since(start_s)
    assert pushed, "the queue was not thrown away"
    assert "maxmemory-policy is allkeys-lru" in doctor, "the doctor does not warn"
    run.require_scored(calls)
    return f"queue thrown away, settled {took_s:.1f} s after; the doctor warned of the policy"


def _push_out(client: redis.Redis, key: str) -> bool:
    """Write other keys until there is no room for this one; whether that came to pass."""
    for filler in _FILLERS * 50:
        client.set(filler, b"x" * 2**16)
        if not client.exists(key):
            return int(client.info("stats")["evicted_keys"]) > 0
    return False


def _doctor(run: Run) -> str:
    command = [sys.executable, "-m", "tests.chaos.saboteur", "server", "doctor"]
    environment = run.topology.environment
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def junk(run: Run) -> str:
    """What is no message stands in the queues; what comes after it is taken as ever.

    First one piece, then three in both lanes, then every kind that we know in both lanes.
    """
    worker = run.topology.worker
    starts, dropped = worker.starts, _n_dropped(run)
    every = tuple((lane, message) for lane in Lane for message in JUNK.values())
    heaps = (_JUNK[:1], _JUNK, every)
    waits_s = [_until_a_job_is_taken(run, heap) for heap in heaps]
    run.clients.stream(6)
    run.settle()
    n_pieces = sum(map(len, heaps))
    assert max(waits_s) <= _BACK_WITHIN_S, f"the next job was taken after {waits_s} s"
    assert worker.starts == starts, f"junk ended the worker {worker.starts - starts} times"
    assert _n_dropped(run) - dropped == n_pieces, "the log does not say what was dropped"
    waits = ", ".join(f"{wait_s:.1f} s" for wait_s in waits_s)
    sizes = ", ".join(str(len(heap)) for heap in heaps)
    return f"next job taken {waits} after {sizes} pieces; no restart, each piece in the log"


def _until_a_job_is_taken(run: Run, heap: tuple[tuple[Lane, bytes], ...]) -> float:
    """Put junk before an upload; return how long after it the upload was begun."""
    began = time.monotonic()
    with run.topology.broker.client() as client:
        for lane, message in heap:
            client.lpush(f"{KEY_PREFIX}{lane.value}", message)
        call = run.upload()
        run.topology.wait_until(lambda: run.job_of(call).attempts, "a worker to take the job")
        took_s = time.monotonic() - began
        run.topology.wait_until(lambda: not _n_waiting(client), "the queues to be emptied")
    return took_s


def _n_dropped(run: Run) -> int:
    return run.topology.worker.log.read_text().count("junk dropped from a queue")


def _n_waiting(client: redis.Redis) -> int:
    return sum(int(client.llen(f"{KEY_PREFIX}{lane.value}")) for lane in Lane)


def deliver_again(run: Run) -> str:
    """Ten messages while it is scored, at once from several sides, and ten after it."""
    scored = run.lines("submission scored")
    n_messages = run.topology.broker.n_calls("lpush")
    call = run.upload(order="1")
    dispatcher = Dispatcher(run.topology.environment["EXCEPTIONDRIVE_BROKER_URL"])

    def wake(_: int) -> bool:
        return dispatcher.wake(Lane.LIVE, at_most=10)

    with ThreadPoolExecutor(5) as several:
        assert all(several.map(wake, range(10)))
    run.settle()
    with ThreadPoolExecutor(5) as several:
        assert all(several.map(wake, range(10)))
    with run.topology.broker.client() as client:
        run.topology.wait_until(lambda: not _n_waiting(client), "all to be delivered")
    n_messages = run.topology.broker.n_calls("lpush") - n_messages
    assert n_messages > 20, f"{n_messages} messages were sent"
    run.clients.stream(4)
    run.settle()
    dispatcher.close()
    again: Job = run.job_of(call)
    assert again.attempts == 1, f"it was taken {again.attempts} times"
    assert run.n_scored(call) == 1
    assert run.lines("submission scored") == scored + 5, "a score was recorded twice"
    return f"{n_messages - 1} messages more, of several senders at once: 1 attempt, 1 score"


def silence(run: Run) -> str:
    """Connections stay open and say nothing more, as behind a firewall that forgot them."""
    swallowed_bytes = run.topology.proxy.n_swallowed_bytes
    run.clients.stream(4)
    run.topology.proxy.is_silent = True
    time.sleep(4)
    run.topology.proxy.heal()
    swallowed_bytes = run.topology.proxy.n_swallowed_bytes - swallowed_bytes
    assert swallowed_bytes, "no byte was swallowed"
    began = time.monotonic()
    run.clients.stream(4)
    run.settle()
    took_s = time.monotonic() - began
    assert took_s <= _CONSUMING_WITHIN_S, f"working again after {took_s:.1f} s"
    return f"{swallowed_bytes} bytes swallowed, working again after {took_s:.1f} s"


def bad_network(run: Run) -> str:
    resets, delayed = run.topology.proxy.n_resets, run.topology.proxy.n_delayed
    run.topology.proxy.delay_s, run.topology.proxy.reset_share = 0.2, 0.05
    run.clients.stream(8)
    run.clients.join()
    time.sleep(2)
    run.topology.proxy.heal()
    resets = run.topology.proxy.n_resets - resets
    took_s = run.settle()
    assert resets, "no connection was reset"
    assert run.topology.proxy.n_delayed > delayed, "nothing was held up"
    return f"{resets} resets, settled {took_s:.1f} s after the stream; worker exits {_exits(run)}"


def _exits(run: Run) -> int:
    return len(run.topology.worker.exit_codes)
