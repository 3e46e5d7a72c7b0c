"""Faults of scoring, server, files and rescoring, in their short form."""

from collections.abc import Iterator

import pytest
from tests.chaos.run import Run
from tests.chaos.short_form import faults_on, require_survived, started
from tests.chaos.suite import Fault, On

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def run() -> Iterator[Run | None]:
    yield from started(On.SQLITE)


@pytest.mark.parametrize("fault", faults_on(On.SQLITE, after="F14", last=("F31", "F32")))
def test_it_survives(fault: Fault, run: Run | None) -> None:
    require_survived(fault, run)
