"""Every fault of the kind, in its short form."""

from collections.abc import Iterator

import pytest
from tests.chaos.run import Run
from tests.chaos.short_form import faults_on, require_survived, started
from tests.chaos.suite import Fault, On

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def run() -> Iterator[Run | None]:
    yield from started(On.ALONE)


@pytest.mark.parametrize("fault", faults_on(On.ALONE))
def test_it_survives(fault: Fault, run: Run | None) -> None:
    require_survived(fault, run)
