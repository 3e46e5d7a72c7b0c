"""A pytest plugin: the whole run fails where the canary leaves the worker, and says where.

Watched are answers (of applications in this process, and those that a client got from another),
log lines, what tests print and processes write, commands to brokers, rows of databases, files.
"""

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.canary.watch import WATCH, watched_asgi, watched_client, watched_log

SCANNED: set[Path] = set()
FOUND_BY_WORKERS: list[str] = []


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "publishes_regions: makes a split public, regions and all")
    _wrap("starlette.applications", "Starlette", "__call__", watched_asgi)
    _wrap("httpx", "Client", "send", watched_client)
    _wrap("structlog.testing", "LogCapture", "__call__", watched_log)


def _wrap(module: str, kind: str, name: str, wrapper: Any) -> None:
    try:
        owner = getattr(importlib.import_module(module), kind)
    except ImportError:
        return
    setattr(owner, name, wrapper(getattr(owner, name)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    WATCH.is_paused = item.get_closest_marker("publishes_regions") is not None
    try:
        return (yield)
    finally:
        WATCH.is_paused = False


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    folder = getattr(item, "funcargs", {}).get("tmp_path")
    if folder is not None and folder not in SCANNED:
        SCANNED.add(folder)
        WATCH.look_in_folder(folder)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    for name, text in report.sections:
        WATCH.look("printed", text, f"{report.nodeid} {name}")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    factory = getattr(session.config, "_tmp_path_factory", None)
    base = getattr(factory, "_basetemp", None)
    for folder in sorted(base.iterdir()) if base is not None else ():
        is_own = folder.is_dir() and not folder.is_symlink() and "popen-gw" not in folder.name
        if is_own and folder not in SCANNED:
            WATCH.look_in_folder(folder)
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["canary"] = WATCH.found
    elif WATCH.found or FOUND_BY_WORKERS:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    FOUND_BY_WORKERS.extend(getattr(node, "workeroutput", {}).get("canary", []))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    found = [*WATCH.found, *FOUND_BY_WORKERS]
    if not found:
        return
    terminalreporter.section("a withheld coordinate has left the worker", red=True, bold=True)
    for line in found[:50]:
        terminalreporter.write_line(line)
