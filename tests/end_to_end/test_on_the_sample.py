"""Participants of one deployment with the generated sample, every part real.

One makes images into a ranked strategy entry with its reminder effect; the one stand-in is the model,
a local server that speaks chat completions. Another submits in a browser and watches.
"""

import gzip
import html
import json
import os
import re
import struct
import subprocess
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect
from tests.client.notebook import code_of, read_notebook, run_cells
from tests.support.processes import BIN, ROOT, free_port, wait_until
from tests.support.system import System, running_system

pytestmark = [pytest.mark.slow]
PHASE = "sample-strategy"
LONGEST_MS = 180_000


@dataclass(frozen=True)
class Lives:
    """What a newcomer saw before the first stop, and the deployment as it was started again."""

    methods: list[str]
    first_page: str
    page: str
    said: str
    exit_code: int
    methods_again: list[str]
    system: System


@pytest.fixture(scope="module")
def lives(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lives]:
    """Start everything with the generated sample, as `make run` does; stop when all is scored."""
    data, splits = tmp_path_factory.mktemp("sample") / "data", ROOT / "hidden_splits"
    with running_system(data, splits, "--sample") as first:
        first_page = first.read("/")
        wait_until(lambda: "sample: 7 of 7 scored" in first.said(), "the agents", 400)
        wait_until(lambda: is_filled(first), "the boards", 400)
        wait_until(lambda: len(ranked(first)) >= 4, "the planners on the board", 400)
        methods, page = ranked(first), first.read("/")
    said, exit_code = first.said(), first.launcher.returncode
    with running_system(data, splits, "--sample") as second:
        yield Lives(methods, first_page, page, said, exit_code, ranked(second), second)


@pytest.fixture(scope="module")
def sample_system(lives: Lives) -> System:
    """A deployment with the sample split, phases and agents."""
    return lives.system


def ranked(running: System) -> list[str]:
    board = running.get("/leaderboard?phase=sample")
    return [entry["method"] for entry in board["entries"] if entry["rank"] is not None]


def test_a_newcomer_sees_a_living_page_and_a_second_start_keeps_it(lives: Lives) -> None:
    assert "The sample is being made: " in lives.first_page
    assert "no phase yet" not in lives.first_page
    assert lives.methods[0] in lives.page
    assert lives.exit_code == 0
    assert "stopped; the data stays in" in lives.said
    assert lives.methods_again == lives.methods
    wait_until(lambda: "ExceptionDrive runs at" in lives.system.said(), "the address")
    assert "of 7 scored" not in lives.system.said()  # nothing is submitted twice


def test_a_second_launcher_and_a_taken_port_are_refused_in_one_sentence(
    sample_system: System, tmp_path: Path
) -> None:
    def refused(data: Path, port: int | str) -> str:
        done = subprocess.run(
            [BIN / "exceptiondrive-server", "run", "--port", str(port), "--data", data],
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == 2
        return done.stderr

    port = sample_system.url.rpartition(":")[2]
    assert "in use by another `exceptiondrive-server run`" in refused(
        sample_system.data, free_port()
    )
    assert f"port {port} is in use" in refused(tmp_path / "two", port)


class Model(BaseHTTPRequestHandler):
    """Reminds of a stop; decides to stop where it is reminded, and to keep its path where not.

    To every twelfth picture or so it swerves all the same: who answers one letter has no rank.
    """

    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        asked = self.rfile.read(int(self.headers["Content-Length"])).decode()
        picture = asked.partition("base64,")[2].partition('"')[0]
        stop = "E" if zlib.crc32(picture.encode()) % 12 == 0 else "C"
        text = json.dumps({"strategy": stop if "recommended" in asked else "A"})
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
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/v1"
    server.shutdown()
    server.server_close()
    thread.join()


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
    sample_system: System, model_url: str, tmp_path: Path
) -> None:
    token = sample_system.make_team("agents")

    def run(*arguments: str | Path) -> str:
        done = subprocess.run(
            [BIN / "exceptiondrive", *arguments],
            cwd=tmp_path,
            env=sample_system.environment(token) | {"NO_PROXY": "127.0.0.1"},
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
    submit = ("--phase", PHASE, "--wait", "--json", "--allow-unranked")
    plain = json.loads(run("submit", "plain.json", "--method", "Made", *submit))
    linked = ("--without-reminder", plain["id"])
    with_it = json.loads(run("submit", "reminded.json", "--method", "Made + R", *submit, *linked))
    assert with_it["linked_to"] == plain["id"]
    assert with_it["rank"] == 1
    entry = entry_of(sample_system, "Made + R")
    accuracy = entry["reminder_effect"]["differences"]["accuracy"]
    assert entry["reminder_effect"]["without"] == plain["id"]
    assert 0.9 < accuracy["difference"] < 1.0
    assert accuracy["discordant"] == round(accuracy["difference"], 2), "nothing became worse"
    assert accuracy["verdict"] == "better with the reminder"
    published = sample_system.get(f"/entries/{with_it['id']}")
    assert published["sheet"]["extra"]["reminder"]["strategy_accuracy"] == 1.0, "of the reminders"
    assert "confusion_C" in published["sheet"]["extra"]


@pytest.mark.parametrize("phase", ["sample", "sample-strategy"])
def test_the_quick_start_runs_as_pasted(phase: str, sample_system: System, tmp_path: Path) -> None:
    """Every block of the page but the first: client and token are there, this server holds no client."""
    page = sample_system.read(f"/submit?phase={phase}")
    blocks = [
        html.unescape(re.sub("</?i>", "", each))
        for each in re.findall(r'<pre class="term"[^>]*>(.*?)</pre>', page, re.DOTALL)
    ]
    assert len(blocks) == 5
    assert blocks[0].startswith("exceptiondrive login ")
    environment = {
        **sample_system.environment(sample_system.make_team(f"newcomers-of-{phase}")),
        "PATH": f"{BIN}:{os.environ['PATH']}",
    }
    done = subprocess.run(
        ["bash", "-ec", "".join(blocks[1:])],
        cwd=tmp_path,
        env={**environment, "COLUMNS": "400"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    screen = done.stdout + done.stderr
    assert done.returncode == 0, screen
    told = "it will be scored but not ranked: flagged Same answer"
    assert told in screen, "it is told before the upload"
    assert f"not ranked in phase {phase}: flagged Same answer" in screen
    assert "submissions left today" in screen


def test_the_walk_of_a_protocol_update_runs_as_typed(sample_system: System, tmp_path: Path) -> None:
    """Line by line of docs/rescoring.md; run and digest stand on what earlier lines print."""
    text = (ROOT / "docs" / "rescoring.md").read_text(encoding="utf-8")
    walk = text.partition("## A walk")[2].partition("```sh\n")[2].partition("```")[0]
    before, known, screens = ranked(sample_system), {"RUN": "", "DIGEST": ""}, []
    for line in walk.splitlines():
        typed = re.sub("RUN|DIGEST", lambda word: known[word[0]], line)
        done = subprocess.run(
            ["bash", "-c", typed],
            cwd=tmp_path,
            env={
                **sample_system.environment(sample_system.organizers_token),
                "PATH": f"{BIN}:{os.environ['PATH']}",
            },
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, (typed, done.stdout, done.stderr)
        screens.append(done.stdout)
        if run := re.match(r"run (\w+) ", done.stdout):
            known["RUN"] = run[1]
        if digest := re.search(r"^preview (sha256:\w+)$", done.stdout, re.MULTILINE):
            known["DIGEST"] = digest[1]
    assert any("factor of every required clearance 1.0 -> 1.5" in screen for screen in screens)
    assert screens[-1].startswith(f"run {known['RUN']}  rolled_back  phase sample  1.1 -> 1.2")
    assert ranked(sample_system) == before


def test_the_notebook_runs_as_written_to_a_rank(sample_system: System, tmp_path: Path) -> None:
    _, *cells = code_of(read_notebook())
    token = sample_system.make_team("notebook")
    shown = run_cells(cells, tmp_path, sample_system.environment(token))
    assert re.search(r"scored.*, \d+\)$", shown["view.status, view.rank"])


@pytest.fixture(scope="module")
def team_token(sample_system: System) -> str:
    """A team, as an operator makes it."""
    return sample_system.make_team("browsing")


@pytest.fixture(scope="module")
def planner(sample_system: System) -> Path:
    """A file of a synthetic planner, not compressed."""
    kept = sample_system.data / "sample" / "planners" / "bypass-planner.json.gz"
    written = sample_system.data / "mine.json"
    written.write_text(json.dumps(json.loads(gzip.decompress(kept.read_bytes())), indent=1))
    return written


def sign_in(context: BrowserContext, system: System, token: str) -> Page:
    page = context.new_page()
    page.goto(f"{system.url}/my")
    page.fill("input[name=token]", token)
    page.click("text=Sign in >> visible=true >> nth=-1")
    page.wait_for_url("**/my")
    return page


def submit(page: Page, system: System, file: Path, method: str) -> None:
    page.goto(f"{system.url}/submit")
    page.set_input_files("input[name=file]", file)
    page.fill("input[name=method]", method)
    page.click("form.upload button")
    page.wait_for_url(re.compile(r"/submissions/[0-9a-z]{16}$"))


@pytest.mark.browser
def test_a_team_submits_and_watches_it_become_ranked(
    browser: Browser, sample_system: System, team_token: str, planner: Path
) -> None:
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1360, "height": 900}, color_scheme="dark")
    page = sign_in(context, sample_system, team_token)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    submit(page, sample_system, planner, "Watched")
    page.evaluate("window.isStillTheSamePage = true")
    expect(page.locator(".way-rank")).to_be_visible(timeout=LONGEST_MS)
    assert page.evaluate("window.isStillTheSamePage"), "it was followed without a reload"
    page.click("text=Entry on the board")
    expect(page.locator("h1")).to_have_text("Watched")
    page.goto(f"{sample_system.url}/my")
    expect(page.locator(".subs .badge.scored")).to_be_visible()
    assert complaints == []
    context.close()


@pytest.mark.browser
def test_without_script_on_a_phone_a_file_goes_through_the_form_to_a_rank(
    browser: Browser, sample_system: System, team_token: str, planner: Path, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, java_script_enabled=False)
    page = sign_in(context, sample_system, team_token)
    page.goto(f"{sample_system.url}/submit?phase=sample")
    empty = tmp_path / "empty.json"
    empty.write_bytes(b"")
    page.fill("input[name=method]", "Without script")
    page.fill("textarea[name=description]", "Typed once.")
    page.set_input_files("input[name=file]", empty)
    page.click("form.upload button")
    expect(page.locator(".refused")).to_contain_text("The file holds nothing")
    expect(page.locator("input[name=method]")).to_have_value("Without script")
    expect(page.locator("textarea[name=description]")).to_have_value("Typed once.")
    own = tmp_path / "own.json"
    document = json.loads(planner.read_text())
    document["predictions"][0]["edited"] = None
    own.write_text(json.dumps(document))
    page.set_input_files("input[name=file]", own)
    page.click("form.upload button")
    page.wait_for_url(re.compile(r"/submissions/[0-9a-z]{16}$"))
    expect(page.locator(".way-rank")).to_be_visible(timeout=LONGEST_MS)
    page.click("text=Entry on the board")
    expect(page.locator("h1")).to_have_text("Without script")
    context.close()


@pytest.mark.browser
def test_a_wrong_file_shows_the_list_that_the_client_prints(
    browser: Browser, sample_system: System, team_token: str, planner: Path, tmp_path: Path
) -> None:
    document = json.loads(planner.read_text())
    document["predictions"][0]["edited"] = document["predictions"][0]["edited"][:4]
    document["predictions"][1]["source"][2] = [1.0, 900.0]
    del document["predictions"][2]
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps(document))
    manifest = tmp_path / "manifest.json"
    fetched = sample_system.client("manifest", "sample", "-o", manifest, token=team_token)
    assert fetched.returncode == 0, fetched.stderr
    printed = sample_system.client("check", wrong, "--manifest", manifest, "--json")
    assert printed.returncode == 2
    faults = json.loads(printed.stdout)["faults"]
    context = browser.new_context(viewport={"width": 390, "height": 844}, java_script_enabled=False)
    page = sign_in(context, sample_system, team_token)
    submit(page, sample_system, wrong, "Wrong")
    expect(page.locator(".flt")).to_be_visible(timeout=LONGEST_MS)
    assert page.locator(".flt .fgrp code:first-child").first.inner_text() == faults[0]["code"]
    text = page.locator(".flt").inner_text()
    assert len(faults) >= 3
    for fault in faults:
        assert fault["code"] in text
        for example in fault["examples"]:
            assert example["path"] in text
    context.close()
