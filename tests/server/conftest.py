"""The application, and what the tests of the server make: board entries and a split."""

from collections.abc import Callable

import pytest
from tests.support.application import (  # noqa: F401 - fixtures
    api,
    api_on_both,
    as_problem,
    browse,
    entry,
    logs,
    make_api,
)

from exceptiondrive_schemas.board import BoardEntry


@pytest.fixture
def make_entry() -> Callable[..., BoardEntry]:
    """Makes a board entry; keywords replace fields and metrics."""
    return entry
