"""Pages in a real browser, and requests a second: `python -m benchmarks.page_loads NAME=URL ...`.

Loads each page cold in Chromium (1440 x 900; then a phone on slow 4G with a CPU four times slower), asks
for it again and again over one connection, and lets 8 clients of ApacheBench ask at once, where `ab` is
there. Several servers take turns, so that one run compares them. `--plant DATABASE` first writes phases
with boards of 60 and 1,000 invented entries into the records of a running sample (`make run`).
"""

import argparse
import gzip
import http.client
import re
import shutil
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Browser, CDPSession, sync_playwright

PLANTED = {"board-60": 60, "board-1000": 1000}
PAGES = {
    "board, sample": "/?phase=sample",
    "board of 60": "/?phase=board-60",
    "board of 1,000": "/?phase=board-1000",
    "entry": "{entry}",
    "compare": "/compare?phase=sample",
    "protocol": "{protocol}",
}
LOADS, ASKS, CLIENTS, BURST = 5, 30, 8, 300
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 3,
    "is_mobile": True,
    "has_touch": True,
}
SLOW_4G = {"latency": 150, "downloadThroughput": 1.6e6 / 8, "uploadThroughput": 750e3 / 8}
"""Round trip in ms, bytes a second: what Lighthouse calls slow 4G."""
WATCH = """
window.seen = {lcp: 0, cls: 0};
new PerformanceObserver((list) => { for (const e of list.getEntries()) seen.lcp = e.startTime; })
  .observe({type: "largest-contentful-paint", buffered: true});
new PerformanceObserver((list) => {
  for (const e of list.getEntries()) if (!e.hadRecentInput) seen.cls += e.value;
}).observe({type: "layout-shift", buffered: true});
"""


@dataclass(frozen=True)
class Load:
    """One cold load; times in ms."""

    requests: int
    transferred_kb: float
    elements: int
    lcp_ms: float
    shift: float


def main() -> None:
    """Plant, or measure and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page_loads", description=__doc__)
    parser.add_argument("servers", nargs="*", metavar="NAME=URL")
    parser.add_argument("--plant", metavar="DATABASE", help="address of the records to write to")
    given = parser.parse_args()
    if given.plant:
        plant(given.plant)
    servers = dict(each.split("=", 1) for each in given.servers)
    if servers:
        _measure(servers)


def plant(database_url: str) -> None:
    """Publish boards of invented entries in phases of their own, over the split of the sample."""
    from tests.support.work import claim_board_of

    from benchmarks.page import big_board
    from exceptiondrive_records.boards.boards import publish_board
    from exceptiondrive_records.db.database import Database
    from exceptiondrive_records.phases.phases import create_phase
    from exceptiondrive_records.phases.tables import Phase
    from exceptiondrive_records.work.board_requests import want_board
    from exceptiondrive_schemas.api.phase_settings import NewPhase
    from exceptiondrive_schemas.protocol import packaged_protocol
    from exceptiondrive_schemas.split import SplitRef

    database = Database(database_url)
    for phase_id, n_entries in PLANTED.items():
        with database.write() as session:
            new = NewPhase(
                id=phase_id,
                challenge="planning",  # type: ignore[arg-type]
                title=phase_id.replace("-", " of ").title(),
                split="sample",
                protocol="1.0",
            )
            create_phase(session, new, actor="benchmark")
            phase = session.get_one(Phase, phase_id)
            split = SplitRef(name="sample", revision=phase.split_revision)
            want_board(session, phase_id, phase.protocol_digest)
            claim = claim_board_of(session, phase_id, phase.protocol_digest)  # before any worker
        assert claim is not None
        board = big_board(packaged_protocol(), n_entries)
        board = board.model_copy(update={"phase": phase_id, "split": split})
        with database.write() as session:
            publish_board(session, claim, board)
    database.dispose()


def _measure(servers: dict[str, str]) -> None:
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    line = "| {:<22} | {:>8} | {:>14} | {:>8} | {:>8} | {:>5} | {:>15} | {:>9} | {:>9} |\n"
    sys.stdout.write(
        line.format("page", "requests", "transferred kB", "elements", "LCP cold", "CLS",
                    "phone LCP / CLS", "median ms", "per s")
    )  # fmt: skip
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        links = {name: _linked(url) for name, url in servers.items()}
        for title, path in PAGES.items():
            for name, url in servers.items():
                address = url.rstrip("/") + path.format_map(links[name])
                desk = [_load(browser, address) for _ in range(LOADS)]
                phone = [_load(browser, address, on_phone=True) for _ in range(LOADS)]
                last = desk[-1]
                sys.stdout.write(
                    line.format(
                        f"{title} ({name})",
                        last.requests,
                        f"{last.transferred_kb:.0f}",
                        f"{last.elements:,}",
                        f"{statistics.median(each.lcp_ms for each in desk):.0f} ms",
                        f"{max(each.shift for each in desk):.3f}",
                        f"{statistics.median(each.lcp_ms for each in phone) / 1000:.2f} s"
                        f" / {max(each.shift for each in phone):.3f}",
                        f"{_median_ms(address):.1f}",
                        _per_second(address),
                    )
                )
                sys.stdout.flush()
        browser.close()


def _load(browser: Browser, address: str, *, on_phone: bool = False) -> Load:
    look: Any = PHONE if on_phone else {"viewport": {"width": 1440, "height": 900}}
    context = browser.new_context(**look)
    try:
        page = context.new_page()
        page.add_init_script(WATCH)
        session = context.new_cdp_session(page)
        bytes_of = _watched_bytes(session)
        if on_phone:
            session.send("Network.emulateNetworkConditions", {"offline": False, **SLOW_4G})
            session.send("Emulation.setCPUThrottlingRate", {"rate": 4})
        page.goto(address, wait_until="load")
        page.wait_for_timeout(1500 if on_phone else 800)
        seen = page.evaluate("seen")
        elements = page.evaluate("document.querySelectorAll('*').length")
        return Load(len(bytes_of), sum(bytes_of) / 1000, elements, seen["lcp"], seen["cls"])
    finally:
        context.close()


def _watched_bytes(session: CDPSession) -> list[float]:
    sizes: list[float] = []
    session.send("Network.enable")
    session.on("Network.loadingFinished", lambda event: sizes.append(event["encodedDataLength"]))
    return sizes


def _linked(url: str) -> dict[str, str]:
    """Addresses of an entry and of the protocol, as the board of the sample links them."""
    html = _body(f"{url.rstrip('/')}/?phase=sample").decode()
    patterns = {
        "entry": r'href="(/entries/[a-z0-9]{10}[^"#]*)',
        "protocol": r'href="(/protocols/[^"#]+)',
    }
    found = {kind: re.search(pattern, html) for kind, pattern in patterns.items()}
    return {kind: one[1] if one else "/" for kind, one in found.items()}


def _body(address: str) -> bytes:
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=60)
    connection.request("GET", f"{parts.path}?{parts.query}", headers={"Accept": "text/html"})
    answer = connection.getresponse()
    body = answer.read()
    return gzip.decompress(body) if answer.headers.get("Content-Encoding") == "gzip" else body


def _median_ms(address: str) -> float:
    """Of one client that keeps its connection, as a browser asks."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=60)
    headers = {"Accept": "text/html", "Accept-Encoding": "gzip"}
    times = []
    for _ in range(ASKS):
        began = time.perf_counter()
        connection.request("GET", f"{parts.path}?{parts.query}", headers=headers)
        connection.getresponse().read()
        times.append(1000 * (time.perf_counter() - began))
    return statistics.median(times)


def _per_second(address: str) -> str:
    if shutil.which("ab") is None:
        return "no ab"
    command = ["ab", "-q", "-k", "-n", str(BURST), "-c", str(CLIENTS), "-H", "Accept: text/html"]
    told = subprocess.run([*command, address], capture_output=True, text=True, check=True).stdout
    found = re.search(r"Requests per second:\s+([\d.]+)", told)
    failed = re.search(r"Non-2xx responses:\s+(\d+)", told)
    return f"{found[1] if found else '?'}{f' ({failed[1]} failed)' if failed else ''}"


if __name__ == "__main__":
    main()
