"""A pytest plugin: certificates of authorities are read once per process, not for every client.

`httpx2.get` and each `Client` of ours read them anew: 45 ms of processor time. A certificate that a
test names is read every time: it may have been replaced.
"""

import ssl
from functools import cache
from typing import Any

import certifi
import pytest

OF_THE_MACHINE = (None, certifi.where())


def pytest_configure(config: pytest.Config) -> None:
    make, once = ssl.create_default_context, cache(ssl.create_default_context)

    def made(*purpose: Any, **certificates: Any) -> ssl.SSLContext:
        is_lasting = certificates.get("cafile") in OF_THE_MACHINE
        return (once if is_lasting else make)(*purpose, **certificates)

    ssl.create_default_context = made
