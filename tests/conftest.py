"""Real databases, brokers and browsers for all tests; nothing is mocked. See tests/support."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest_plugins = [
    "tests.canary.plugin",  # the whole run is searched for a withheld coordinate
    "tests.chaos.story",
    "tests.support.broker",
    "tests.support.browser",
    "tests.support.databases",
    "tests.support.fresh_pages",
    "tests.support.order",
    "tests.support.snapshots",
    "tests.support.speed",
]


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may enter, unlike pytest's own."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)
