"""The short form of the fault suite, for `make test`: every fault, with fewer files and shorter waits.

A file of tests for each kind of system, two for the commonest, so that they run beside each other.
"""

from collections.abc import Iterator, Sequence

import pytest
from tests.chaos.run import Run
from tests.chaos.suite import FAULTS, Fault, On, run_fault, running

from exceptiondrive_server.launcher.broker import find_broker_binary
from exceptiondrive_server.launcher.child import LaunchError


def faults_on(on: On, *, after: str = "", to: str = "G", last: Sequence[str] = ()) -> list[object]:
    """Return the faults that are injected into such a system, between two ids, as parameters of a test.

    Those that leave most submissions behind come last: the check after each fault looks at all.
    """
    found = [fault for fault in FAULTS if fault.on is on and after < fault.id <= to]
    found.sort(key=lambda fault: fault.id in last)
    return [pytest.param(fault, id=fault.id) for fault in found]


def started(on: On) -> Iterator[Run | None]:
    """Start one system for all of its faults: after each it must be as good as before."""
    try:
        find_broker_binary()
    except LaunchError as error:
        pytest.skip(str(error))
    with running(on, is_short=True) as run:
        yield run


def require_survived(fault: Fault, run: Run | None) -> None:
    if fault.why_not is not None and (reason := fault.why_not()) is not None:
        pytest.skip(reason)
    outcome = run_fault(fault, run)
    assert outcome.is_survived, outcome.text
