"""The short form of the fault suite: some faults of each kind, in every run of the tests."""

from collections.abc import Iterator

import pytest
from tests.chaos.run import Run
from tests.chaos.suite import FAULTS, Fault, On, run_fault, running

from exceptiondrive_server.launcher.broker import NoBrokerError, find_broker_binary

pytestmark = [pytest.mark.slow]
SHORT = [fault for fault in FAULTS if fault.is_short]


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """One topology on SQLite for all of them: after each it must be as good as before."""
    try:
        find_broker_binary()
    except NoBrokerError as error:
        pytest.skip(str(error))
    with running(On.SQLITE) as started:
        assert started is not None
        yield started


@pytest.mark.parametrize("fault", SHORT, ids=[fault.id for fault in SHORT])
def test_it_survives(fault: Fault, run: Run) -> None:
    outcome = run_fault(fault, run)
    assert outcome.is_survived, outcome.text
    assert fault.on is On.SQLITE
