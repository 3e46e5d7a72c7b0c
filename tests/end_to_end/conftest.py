"""One deployment with the generated sample, for the modules that need no more."""

from collections.abc import Iterator

import pytest
from tests.support.processes import ROOT
from tests.support.system import System, running_system


@pytest.fixture(scope="module")
def sample_system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """Start everything with the generated sample, as `make run` does."""
    base = tmp_path_factory.mktemp("sample")
    with running_system(base / "data", ROOT / "hidden_splits", "--sample") as running:
        yield running
