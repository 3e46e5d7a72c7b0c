"""From made images to a ranked strategy entry with its reminder effect, every part real.

The one stand-in is the model: a local server that speaks chat completions.
"""

import json
import struct
import subprocess
import threading
import zlib
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.support.processes import BIN, wait_until
from tests.support.system import System

pytestmark = [pytest.mark.slow]
PHASE = "sample-strategy"


class Model(BaseHTTPRequestHandler):
    """Reminds of a stop; decides to stop where it is reminded, and to keep its path where not."""

    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        asked = self.rfile.read(int(self.headers["Content-Length"])).decode()
        text = json.dumps({"strategy": "C" if "recommended" in asked else "A"})
        if "risk reminder" in json.loads(asked)["messages"][0]["content"]:
            text = json.dumps(REMINDER)
        message = {"role": "assistant", "content": text}
        answer = json.dumps(
            {
                "id": "1",
                "object": "chat.completion",
                "created": 0,
                "model": "made",
                "choices": [{"index": 0, "finish_reason": "stop", "message": message}],
            }
        ).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


REMINDER = {
    "hazard_present": True,
    "hazard_type": "LB1",
    "relative_location": "ahead",
    "risk_level": "high",
    "evidence": "a vehicle fills the lane",
    "safety_constraint": "do not pass",
    "recommended_strategy": "C",
}


@pytest.fixture(scope="module")
def model_url() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Model)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/v1"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(scope="module")
def deployment(sample_system: System) -> System:
    """A fresh deployment with the sample split, phases and agents, as a newcomer starts it."""
    wait_until(lambda: is_filled(sample_system), "the sample's agents on the board", 400)
    return sample_system


def is_filled(running: System) -> bool:
    phases = {phase["id"] for phase in running.get("/phases")}
    if PHASE not in phases:
        return False
    try:
        return entry_of(running, "Looking Agent + Reminder").get("reminder_effect") is not None
    except (LookupError, OSError):
        return False


def entry_of(running: System, method: str) -> dict[str, Any]:
    board = running.get(f"/leaderboard?phase={PHASE}")
    found: list[dict[str, Any]] = [e for e in board["entries"] if e["method"] == method]
    return found[0]


def png(shade: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", 2, 2, 8, 0, 0, 0, 0)
    pixels = zlib.compress(bytes([0, shade, shade] * 2))
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    )


def test_images_become_two_linked_entries_and_the_board_shows_what_the_reminder_changed(
    deployment: System, model_url: str, tmp_path: Path
) -> None:
    token = deployment.make_team("agents")

    def run(*arguments: str | Path) -> str:
        done = subprocess.run(
            [BIN / "exceptiondrive", *arguments],
            cwd=tmp_path,
            env=deployment.environment(token) | {"NO_PROXY": "127.0.0.1"},
            check=False,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("manifest", PHASE, "--output", "manifest.json")
    for shade, sample_id in enumerate(
        json.loads((tmp_path / "manifest.json").read_text())["sample_ids"]
    ):
        folder = tmp_path / "images" / sample_id
        folder.mkdir(parents=True)
        (folder / "1.png").write_bytes(png(shade % 256))
    endpoint = ("--base-url", model_url, "--model", "made", "--concurrency", "8")
    run("decide", "images", "--manifest", "manifest.json", "--out", "plain.json", *endpoint)
    run("remind", "images", "--manifest", "manifest.json", "--out", "reminders.jsonl", *endpoint)
    reminded = ("--reminders", "reminders.jsonl", "--attach-reminders")
    run(
        *("decide", "images", "--manifest", "manifest.json", "--out", "reminded.json"),
        *endpoint,
        *reminded,
    )
    submit = ("--phase", PHASE, "--wait", "--json")
    plain = json.loads(run("submit", "plain.json", "--method", "Made", *submit))
    linked = ("--without-reminder", plain["id"])
    with_it = json.loads(run("submit", "reminded.json", "--method", "Made + R", *submit, *linked))
    assert with_it["linked_to"] == plain["id"]
    assert with_it["rank"] == 1
    entry = entry_of(deployment, "Made + R")
    accuracy = entry["reminder_effect"]["differences"]["accuracy"]
    assert entry["reminder_effect"]["without"] == plain["id"]
    assert accuracy["difference"] == accuracy["discordant"] == 1.0
    assert accuracy["verdict"] == "better with the reminder"
    published = deployment.get(f"/entries/{with_it['id']}")
    assert published["sheet"]["extra"]["reminder"]["strategy_accuracy"] == 1.0
    assert "confusion_C" in published["sheet"]["extra"]
