"""Take the injection out of each fault, one at a time, and see that the fault fails.

A fault that says "survived" when nothing was done to the system proves nothing. Here each one's injection
is replaced by nothing, or by what a sound system does; the fault has to notice that nothing happened.
"""

import subprocess
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import redis
from tests.chaos import (
    faults_alone,
    faults_files,
    faults_rescoring,
    faults_scoring,
    faults_server,
    faults_worker,
    processes,
    topology,
)
from tests.chaos.clients import Clients, planning_file
from tests.chaos.postgres import Postgres
from tests.chaos.processes import Process
from tests.chaos.proxy import Proxy
from tests.chaos.run import Run
from tests.chaos.suite import Fault, Outcome, run_fault, running
from tests.chaos.topology import Broker, Topology

from exceptiondrive_records.work.dispatch import Dispatcher

Replacement = tuple[Any, str, Any]
"""An object, its attribute, and what stands there instead."""

_SEEN_WITHIN_S = 2.0
_PATIENCE_S = 25.0
_UNHEARD = "CHAOS_UNHEARD"


def _nothing(*_: object, **__: object) -> None:
    """Stand for a signal, a command or an order that is never given."""


def _same(value: object) -> object:
    return value


def _always(value: object) -> Callable[..., object]:
    return lambda *_, **__: value


def _stays(value: object) -> property:
    """Stand for an attribute that keeps this value, whatever it is set to."""
    return property(_always(value), _nothing)


def _one_by_one(writers: list["subprocess.Popen[bytes]"]) -> None:
    for writer in writers:
        assert writer.stdin is not None
        assert writer.stdout is not None
        writer.stdout.readline()
        writer.stdin.write(b"\n")
        writer.stdin.flush()
        writer.wait()


def _an_answer(run: Run) -> bytes:
    return planning_file(run.topology.sample_ids, 1.5)


_NO_SIGNAL = (processes, "signal_process", _nothing)
_NO_GROUP_SIGNAL = (processes, "signal_group", _nothing)
_NO_ORDER = (Topology, "order", _nothing)
_NO_KILL = (faults_alone, "_MIGRATION", faults_alone._MIGRATION.replace("SIGKILL", "SIGCONT"))
_BROKER_STAYS = ((Broker, "kill", _nothing), (Broker, "start", _nothing))

WITHOUT: dict[str, tuple[Replacement, ...]] = {
    "F01": (_NO_SIGNAL,),
    "F02": (_NO_SIGNAL,),
    "F02b": (_NO_GROUP_SIGNAL,),
    "F02c": (_NO_GROUP_SIGNAL,),
    "F02c broker": _BROKER_STAYS,
    "F03": (_NO_SIGNAL,),
    "F04": (_NO_SIGNAL,),
    "F05": (_NO_GROUP_SIGNAL,),
    "F06": _BROKER_STAYS,
    "F07": _BROKER_STAYS,
    "F08": ((redis.Redis, "flushall", _nothing),),
    "F09": _BROKER_STAYS,
    "F10": ((topology, "signal_process", _nothing),),
    "F11": ((redis.Redis, "config_set", _nothing),),
    "F12": ((redis.Redis, "config_set", _nothing),),
    "F13": ((redis.Redis, "lpush", _nothing),),
    "F14": ((Dispatcher, "wake", _always(True)),),
    "F15": ((faults_worker, "VISIBILITY_S", _UNHEARD),),
    "F16": (_NO_ORDER,),
    "F17": (_NO_ORDER,),
    "F18": (_NO_ORDER,),
    "F19": ((Proxy, "is_silent", _stays(False)),),
    "F20 resets": ((Proxy, "reset_share", _stays(0.0)),),
    "F20 delay": ((Proxy, "delay_s", _stays(0.0)),),
    "F21": (_NO_ORDER,),
    "F22": (_NO_ORDER,),
    "F22b": (_NO_GROUP_SIGNAL,),
    "F23": ((Process, "hold_down", _nothing),),
    "F24": ((Postgres, "kill", _nothing), (Postgres, "start", _nothing)),
    "F24b": ((Postgres, "cut_connections", _always(0)),),
    "F24c": (_NO_SIGNAL,),
    "F24d": (_NO_GROUP_SIGNAL,),
    "F25": ((faults_files, "_fill_up", _nothing),),
    "F26": ((faults_files, "_take_away", _nothing), (faults_files, "_put_back", _nothing)),
    "F26b": ((faults_files, "_turn_read_only", _nothing),),
    "F27": ((faults_files, "_flip_a_bit", _nothing),),
    "F28": ((faults_files, "_remove", _nothing),),
    "F28b": ((faults_files, "_changed", _same),),
    "F29": ((faults_server, "_clock", _always({})),),
    "F30": ((faults_alone, "_let_go", _one_by_one),),
    "F31": ((faults_rescoring, "start_run", _nothing),),
    "F32": (_NO_GROUP_SIGNAL,),
    "F32 broker": _BROKER_STAYS,
    "F33": ((faults_scoring, "SCORER", _UNHEARD),),
    "F34": ((faults_server, "_edit_protocol", _nothing),),
    "F35": ((Clients, "withdraw", _always(200)),),
    "F35b taken out": ((Clients, "withdraw", _always(200)),),
    "F35b given back": ((Clients, "restore", _always(200)),),
    "F36 failure": (_NO_ORDER,),
    "F36 silence": ((faults_scoring, "_nothing_answered", _an_answer),),
    "F37": ((Clients, "stream", _nothing),),
    "F38": (_NO_KILL,),
    "F38b": (_NO_KILL,),
}
"""What is replaced, by the id of a fault; a word after it says which of its injections."""


def fails_without(name: str, fault: Fault) -> Outcome:
    """Run a fault, in its short form, on a system of its own, without one of its injections."""
    with running(fault.on, is_short=True) as run, ExitStack() as stack:
        if run is not None:
            run.topology.patience_s = _PATIENCE_S
        stack.enter_context(patch.object(processes, "_SEEN_WITHIN_S", _SEEN_WITHIN_S))
        for owner, attribute, replacement in WITHOUT[name]:
            create = isinstance(replacement, property)
            stack.enter_context(patch.object(owner, attribute, replacement, create=create))
        return run_fault(fault, run)
