"""A pytest plugin: applications in the test process keep no page, so that what was written is seen.

Tests of keeping say how long it is kept; a server in a process of its own keeps pages as it does anywhere.
"""

from exceptiondrive_server.web import kept_pages


def pytest_configure() -> None:
    kept_pages.MAX_AGE_S = 0.0
