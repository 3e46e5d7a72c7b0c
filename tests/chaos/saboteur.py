"""Runs one of our commands with faults inside: what no signal from outside can hit in time.

`python -m tests.chaos.saboteur server|worker ARGUMENTS`; orders are files in the folder that
CHAOS_ORDERS names. Everything but the sabotaged call is the product's own code.
"""

import gc
import hashlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ORDERS = "CHAOS_ORDERS"
SCORER = "CHAOS_SCORER_VERSION"
"""The worker says that its scorer is this version."""
VISIBILITY_S = "CHAOS_VISIBILITY_TIMEOUT_S"
"""The broker gives a message that was not acknowledged to another worker after so long."""
VISIBILITY_TIMEOUT = "chaos: the transport was given its visibility timeout"


def _orders() -> Path:
    return Path(os.environ[ORDERS])


def _obey(order: str) -> None:
    match order:
        case "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        case "loop":
            while True:
                pass
        case "loop-in-c":  # holds no bytecode boundary at which a signal could be heard
            os.nice(19)  # limits are of time, not of processor time: others may have that
            hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
        case "allocate":
            bytearray(10 * 2**30)
        case _:
            select.select(
                [], [], [], float(order)
            )  # libfaketime lets `time.sleep` fail now and then


def _once(name: str) -> bool:
    """Whether an order was given, which is then used up."""
    try:
        (_orders() / name).unlink()
    except FileNotFoundError:
        return False
    return True


def _sabotage_worker() -> Callable[[], None]:
    import exceptiondrive_scoring
    from exceptiondrive_records.work import dispatch

    exceptiondrive_scoring.SCORER_VERSION = os.environ.get(
        SCORER, exceptiondrive_scoring.SCORER_VERSION
    )
    options = dispatch.transport_options

    def impatient(**named: Any) -> dict[str, Any]:
        wait_s = float(os.environ[VISIBILITY_S])
        print(VISIBILITY_TIMEOUT, file=sys.stderr, flush=True)  # noqa: T201
        restore = {"unacked_restore_interval": 1, "unacked_restore_throttle": 0.5}
        return {**options(**named), **restore, "visibility_timeout": wait_s}

    if VISIBILITY_S in os.environ:
        dispatch.transport_options = impatient

    from exceptiondrive_worker import operator_cli
    from exceptiondrive_worker.stages import Stages

    score = Stages.score

    def sabotaged(self: Stages, target: Any) -> Any:
        for name in (target.file_digest.removeprefix("sha256:"), "every-score"):
            order = _orders() / name
            if order.exists():
                _obey(order.read_text())
        return score(self, target)

    Stages.score = sabotaged  # type: ignore[method-assign]
    return operator_cli.main


def _sabotage_server() -> Callable[[], None]:
    from exceptiondrive_server.operations import cli as operator_cli

    if "serve" not in sys.argv:  # nobody else takes uploads
        return operator_cli.main
    from exceptiondrive_records.work.dispatch import Dispatcher
    from exceptiondrive_server.submissions import upload as module

    submitting: Any = module
    accept, wake, taking = submitting.accept, Dispatcher.wake, threading.local()

    def sabotaged_accept(*arguments: Any, **named: Any) -> Any:
        if _once("kill-before-commit"):
            os.kill(os.getpid(), signal.SIGKILL)
        taking.is_accepted = True
        return accept(*arguments, **named)

    def sabotaged_wake(*arguments: Any) -> bool:
        """What a thread wakes for next, after it has accepted, is that upload."""
        if getattr(taking, "is_accepted", False) and _once("kill-after-commit"):
            os.kill(os.getpid(), signal.SIGKILL)
        taking.is_accepted = False
        return wake(*arguments)

    submitting.accept = sabotaged_accept
    Dispatcher.wake = sabotaged_wake  # type: ignore[assignment, method-assign]
    return operator_cli.main


def run(arguments: Sequence[str]) -> None:
    """Run a command in this process, with the faults that its orders and environment name."""
    which, *sys.argv[1:] = arguments
    gc.disable()  # as the commands do while they import
    command = {"worker": _sabotage_worker, "server": _sabotage_server}[which]()
    gc.freeze()
    gc.enable()
    sys.argv[0] = f"exceptiondrive-{which}"
    command()


if __name__ == "__main__":
    run(sys.argv[1:])
