"""A pytest plugin: certificates of authorities are read once per process, not for every client.

`httpx.get` and each `Client` of ours read them anew: 45 ms of processor time.
"""

import ssl
from functools import cache

import pytest


def pytest_configure(config: pytest.Config) -> None:
    ssl.create_default_context = cache(ssl.create_default_context)  # type: ignore[assignment]
