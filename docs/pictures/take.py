"""Take the pictures of the README anew: `make pictures`.

Starts the system as `make run` does, in a folder and on a port of its own, waits until every
planner of the sample stands on the board, and takes the board in light and in dark.
"""

import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

HERE = Path(__file__).parent
SIZE: Any = {"width": 1240, "height": 900}
LONGEST_S = 300
MAX_BYTES = 150_000
BOARD_WITHOUT_PAPER = """() => {
  const card = document.querySelector("#board > .card").getBoundingClientRect();
  const last = document.querySelector("#board-rows .blk-reference").getBoundingClientRect();
  return {x: card.x, y: card.y, width: card.width, height: last.bottom - card.y};
}"""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def main() -> None:
    """Write `board-light.png` and `board-dark.png` beside this file."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder)) as address,
        sync_playwright() as playwright,
    ):
        found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        for scheme in ("light", "dark"):
            look: Any = {"color_scheme": scheme, "viewport": SIZE, "reduced_motion": "reduce"}
            page = browser.new_page(**look)
            page.goto(f"{address}/?phase=sample")
            part = page.evaluate(BOARD_WITHOUT_PAPER)
            page.screenshot(path=HERE / f"board-{scheme}.png", full_page=True, clip=part)
        browser.close()
    for picture in sorted(HERE.glob("*.png")):
        size = picture.stat().st_size
        sys.stdout.write(f"{picture.name}: {size:,} bytes\n")
        if size > MAX_BYTES:
            sys.exit(f"{picture.name} is larger than {MAX_BYTES:,} bytes.")


@contextmanager
def running(folder: Path) -> Iterator[str]:
    """Run the whole system with its sample; give its address once all planners are scored."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    command = Path(sys.executable).parent / "exceptiondrive-server"
    arguments = ["run", "--port", str(port), "--data", str(folder / "data"), "--sample"]
    launcher = subprocess.Popen([command, *arguments], stdout=subprocess.DEVNULL)
    try:
        wait_for_all(f"http://127.0.0.1:{port}", folder / "data" / "sample" / "planners")
        yield f"http://127.0.0.1:{port}"
    finally:
        launcher.terminate()
        launcher.wait(timeout=60)


def wait_for_all(address: str, planners: Path) -> None:
    """Wait until the board holds every planner of the sample."""
    ends = time.monotonic() + LONGEST_S
    while time.monotonic() < ends:
        if planners_on_board(address) >= listed_planners(planners / "planners.json"):
            return
        time.sleep(1)
    sys.exit(f"After {LONGEST_S} s not every planner of the sample stood on the board.")


def listed_planners(listing: Path) -> float:
    """Count the planners that are submitted; before they are known, more than ever come."""
    if not listing.is_file():
        return float("inf")
    lines = json.loads(listing.read_text())
    return sum(1 for line in lines if line.get("challenge", "planning") == "planning")


def planners_on_board(address: str) -> int:
    """Count the scored rows of the sample's board; none while it cannot be read."""
    try:
        with urllib.request.urlopen(f"{address}/api/v1/leaderboard?phase=sample") as answer:
            entries = json.load(answer)["entries"]
    except (urllib.error.URLError, ConnectionError):
        return 0
    return sum(1 for entry in entries if entry["submission_id"])


if __name__ == "__main__":
    main()
