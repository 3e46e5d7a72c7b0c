"""A pytest plugin (`-p tests.protections.plugin`): takes one protection away before anything is imported.

Which one is named by the environment variable `EXCEPTIONDRIVE_TAKE_AWAY`; never set it elsewhere.
"""

import os

from tests.protections.plugin_name import NAME
from tests.protections.table import PROTECTIONS

(_wanted,) = [each for each in PROTECTIONS if each.name == os.environ[NAME]]
_wanted.take_away()


def pytest_report_header() -> str:
    """Say it, so that the runner can see that it was done."""
    return f"taken away: {_wanted.name}"
