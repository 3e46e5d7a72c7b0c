"""docs/building-a-split.md, walked as it stands: from scenes to a planner on the board.

The one stand-in is the server of the models. Two people decide over the review page's own requests.
"""

import gzip
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import httpx
import pytest
from tests.support.processes import BIN, ROOT, free_port, plain_environment, wait_until
from tests.support.system import System, running_system

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
PAGE = ROOT / "docs" / "building-a-split.md"
CHECKED = ["location", "views", "calibration", "task"]
WATCH_S = 180.0


def blocks() -> list[str]:
    """The shell blocks of the page, in their order."""
    found = re.findall(r"```sh\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    return [str(block) for block in found]


class Walk:
    """One folder in which the blocks of the page are run, as by an organizer in a shell."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self._environment = plain_environment(
            PATH=f"{BIN}:{os.environ['PATH']}", PYTHONPATH=str(ROOT)
        )

    def text(self, block: str) -> str:
        """A block with a port that is free here."""
        return block.replace("8000", str(self.port)).replace("800[01]", "800[01]")

    def run(self, block: str, **environment: str) -> str:
        """Run a block to its end; every command of it has to succeed."""
        done = subprocess.run(
            ["bash", "-eo", "pipefail", "-c", self.text(block)],
            cwd=self.folder,
            env=environment | self._environment,
            check=False,
            capture_output=True,
            text=True,
            timeout=600,
        )
        assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    @contextmanager
    def serving(self, block: str, sign: str) -> Iterator[str]:
        """Run a block that serves, until it has said `sign`; give the line that says it."""
        log = self.folder / f"{abs(hash(block))}.log"
        with log.open("wb") as said:
            process = subprocess.Popen(
                ["bash", "-c", f"exec {self.text(block)}"],
                cwd=self.folder,
                env=self._environment | {"PYTHONUNBUFFERED": "1"},
                stdout=said,
                stderr=subprocess.STDOUT,
            )
        try:
            wait_until(lambda: sign in log.read_text(), f"{sign!r} of {block!r}", WATCH_S)
            yield next(line for line in log.read_text().splitlines() if sign in line)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=60)


class Reviewer:
    """A person at the page: what the page's script asks for, asked for here."""

    def __init__(self, address: str, name: str) -> None:
        site = httpx.URL(address)
        origin = f"http://{site.host}:{site.port}"
        self._http = httpx.Client(
            base_url=origin, headers={"Origin": origin}, follow_redirects=True, trust_env=False
        )
        assert self._http.get(site.path).status_code == 200
        assert self._http.post("/sign-in", data={"name": name}).status_code == 200
        self.decided = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def another_address(self) -> str:
        return str(self._posted("/api/address", {})["address"])

    def decide_some(self, queue: str) -> int:
        """Decide the cards that this person can have now; return how many there were."""
        cards = self._posted(f"/api/{queue}/claim", {"have": 0})["cards"]
        for card in cards:
            value: dict[str, Any] = {"passed": True}
            if queue == "verify":
                value = {"accepted": True, "corners": card["corners"], "checked": CHECKED}
            self._posted(f"/api/{queue}/decide", {"card": card["id"], "value": value})
        self.decided += len(cards)
        return len(cards)

    def _posted(self, path: str, document: dict[str, Any]) -> dict[str, Any]:
        answer = self._http.post(path, json=document)
        assert answer.status_code == 200, answer.text
        found: dict[str, Any] = answer.json()
        return found


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The page walked to the frozen files."""
    walk = Walk(tmp_path_factory.mktemp("walk"))
    scenes, stand_in, stages, review, freeze, *_ = blocks()
    walk.run(scenes)
    with walk.serving(stand_in, "stand-in at"):
        walk.run(stages)
    with (
        walk.serving(f"{review.strip()} --port 0\n", "for the next browser: ") as line,
        Reviewer(line.partition(": ")[2], "Ada") as ada,
        Reviewer(ada.another_address(), "Grace") as grace,
    ):
        for queue in ("inspect", "verify"):
            while ada.decide_some(queue) + grace.decide_some(queue):
                pass
        assert ada.decided
        assert grace.decided
    walk.run(freeze)
    return walk


def test_what_is_frozen_went_through_every_stage(walk: Walk) -> None:
    report = json.loads(walk.run("exceptiondrive-build report -w shop --json"))
    funnel = {line["id"]: line["n"] for line in report["funnel"]}
    assert funnel["combinations"] == funnel["screened"] == 6 * 21
    assert funnel["suitable"] == funnel["edited"] == funnel["reviewed"]
    assert funnel["kept"] == funnel["localized"] == funnel["verified"] > 10
    assert report["agreement"]["iou_mean"] == 1.0
    split = json.loads(gzip.decompress((walk.folder / "frozen" / "split.json.gz").read_bytes()))
    assert len(split["samples"]) == funnel["verified"]
    assert (walk.folder / "report.svg").stat().st_size > 1000


@pytest.fixture(scope="module")
def system(walk: Walk) -> Iterator[System]:
    with running_system(walk.folder / "data", walk.folder / "hidden_splits") as running:
        yield running


def test_the_split_becomes_a_phase_and_a_planner_is_ranked_on_it(
    walk: Walk, system: System
) -> None:
    *_, register, submit = blocks()
    organizer = system.operate("exceptiondrive-server", "create-organizer", "test").split()[-1]
    records = {"EXCEPTIONDRIVE_DATABASE_URL": f"sqlite:///{system.data}/records.sqlite3"}
    walk.run(register, **system.environment(organizer), **records)
    token = system.make_team("walkers")
    split = json.loads(gzip.decompress((walk.folder / "frozen" / "split.json.gz").read_bytes()))
    (walk.folder / "planner.json").write_text(json.dumps(planned(split)))
    walk.run(submit, **system.environment(token))

    def is_ranked() -> bool:
        entries = system.get("/leaderboard?phase=made")["entries"]
        return any(e["method"] == "my planner" and e["rank"] == 1 for e in entries)

    wait_until(is_ranked, "the planner's rank", WATCH_S)
    page = system.read("/splits/made-2027")
    assert f"{len(split['samples'])}" in page
    told = re.sub(r"[\s,]+", " ", page)  # one number alone may be an icon's, too
    corners = [corner for sample in split["samples"] for corner in sample["region"]]
    assert [(x_m, y_m) for x_m, y_m in corners if f"{x_m} {y_m}" in told] == []


def planned(split: dict[str, Any]) -> dict[str, Any]:
    """A planner that follows the recorded path, and brakes to a third of it for the hazard."""
    predictions = [
        {
            "sample_id": sample["sample_id"],
            "source": sample["recorded"],
            "edited": [[x * 0.4, y * 0.4] for x, y in sample["recorded"]],
        }
        for sample in split["samples"]
    ]
    return {
        "schema": "exceptiondrive.planning/1",
        "split": split["name"],
        "predictions": predictions,
    }
