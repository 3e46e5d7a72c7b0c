"""The main job with every real part: files of real planners, the client, the API, the worker."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive_worker.private_store import PrivateStore, Shelf

if TYPE_CHECKING:
    from tests.end_to_end.conftest import System

pytestmark = [pytest.mark.slow]
SHARED = Path(__file__).parents[3] / "shared"
REALDATA = SHARED / "realdata"
PLANNERS = {
    "nuscenes-real": (
        "gpt-4.1",
        "gpt-4o",
        "claude-3.7-sonnet",
        "llama-3.2-11b",
        "qwen-2.5-7b",
        "recorded-human",
    ),
    "carla-pairs": ("cosmos", "ditto", "ppd"),
}
EVERY_FILE = [(phase, method) for phase, methods in PLANNERS.items() for method in methods]
WRONG_FRAME = REALDATA / "wrong-frame" / "agent-driver-x-right-y-forward.json.gz"


def _file(phase: str, method: str) -> Path:
    return REALDATA / phase / f"{method}.json.gz"


def _submit(system: System, token: str, phase: str, method: str) -> dict[str, Any]:
    options = ("--phase", phase, "--method", method, "--wait", "--json")
    done = system.client("submit", _file(phase, method), *options, token=token)
    assert done.returncode == 0, done.stderr
    submission: dict[str, Any] = json.loads(done.stdout)
    return submission


def _evaluate(system: System, phase: str, method: str) -> dict[str, Any]:
    split = REALDATA / phase / "split.json.gz"
    done = system.client("evaluate", _file(phase, method), "--split", split, "--json")
    assert done.returncode == 0, done.stderr
    sheet: dict[str, Any] = json.loads(done.stdout)
    return sheet


def _exact_sheets(system: System) -> list[dict[str, Any]]:
    """What the worker keeps for itself: the unrounded sheets."""
    store = PrivateStore(system.data / "private")
    keys = [path.name for path in (store.root / Shelf.SHEETS).iterdir()]
    return [json.loads(store.read(Shelf.SHEETS, key) or b"null") for key in keys]


def _numbers(sheet: dict[str, Any]) -> dict[str, Any]:
    return {key: sheet[key] for key in ("n", "micro", "macro_family", "families", "tasks")}


@pytest.mark.parametrize(("phase", "method"), EVERY_FILE)
def test_a_real_file_is_scored(phases: System, token: str, phase: str, method: str) -> None:
    submission = _submit(phases, token, phase, method)
    assert submission["status"] == "scored"
    assert submission["sheet"]["n"] == {"nuscenes-real": 3181, "carla-pairs": 1257}[phase]


@pytest.mark.parametrize(("phase", "method"), EVERY_FILE)
def test_the_workers_exact_sheet_is_what_evaluate_computes_at_home(
    phases: System, phase: str, method: str
) -> None:
    at_home = _numbers(_evaluate(phases, phase, method))
    assert at_home in [_numbers(sheet) for sheet in _exact_sheets(phases)]


@pytest.mark.parametrize(
    ("phase", "method"), [("nuscenes-real", "gpt-4.1"), ("carla-pairs", "cosmos")]
)
def test_evaluate_reproduces_the_reference_scores(phases: System, phase: str, method: str) -> None:
    golden = json.loads((SHARED / "golden" / f"{phase}.{method}.json").read_text("utf-8"))
    computed = _evaluate(phases, phase, method)
    for key in ("micro", "macro_family"):
        assert computed[key] == pytest.approx(golden[key], abs=1e-9)
    for part in ("families", "tasks"):
        assert set(computed[part]) == set(golden[part])
        for name, row in golden[part].items():
            assert computed[part][name] == pytest.approx(row, abs=1e-9)


def test_the_board_ranks_by_hcc_then_ur_and_leaves_low_coverage_unranked(phases: System) -> None:
    board = phases.get("/leaderboard?phase=nuscenes-real")
    scored = [entry for entry in board["entries"] if entry["source"] == "scored"]
    assert {entry["method"] for entry in scored} == set(PLANNERS["nuscenes-real"])
    ranked = [entry for entry in scored if entry["rank"] is not None]
    places = [(-entry["metrics"]["hcc"], entry["metrics"]["ur"]) for entry in ranked]
    assert places == sorted(places)
    assert [entry["rank"] for entry in ranked] == list(range(1, len(ranked) + 1))
    unranked = {entry["method"]: entry["unranked_because"] for entry in scored if not entry["rank"]}
    assert "gpt-4.1" in unranked  # leaves a quarter of the samples without an answer
    assert "cover 66.96% and" in unranked["gpt-4.1"]


def test_the_papers_rows_stand_apart_and_are_never_ranked(phases: System) -> None:
    board = phases.get("/leaderboard?phase=nuscenes-real")
    sources = [entry["source"] for entry in board["entries"]]
    reported = [entry for entry in board["entries"] if entry["source"] == "reported"]
    assert len(reported) == 7
    assert all(entry["rank"] is None for entry in reported)
    assert sources == sorted(sources, key=("scored", "reference", "reported").index)


def test_the_same_bytes_again_are_the_first_submission(phases: System, token: str) -> None:
    first = _submit(phases, token, "carla-pairs", "ppd")
    again = _submit(phases, token, "carla-pairs", "ppd")
    assert again["id"] == first["id"]
    assert again["is_duplicate"]


def test_the_wrong_frame_is_refused_by_the_client_before_anything_is_sent(
    phases: System, token: str
) -> None:
    renamed = _in_split(phases, "nuscenes-real")
    options = ("--phase", "nuscenes-real", "--method", "Wrong frame", "--json")
    done = phases.client("submit", renamed, *options, token=token)
    assert done.returncode == 2
    assert "looks like x right / y forward: swap to (y, -x)" in done.stdout + done.stderr


def test_the_server_refuses_the_wrong_frame_with_the_same_words(phases: System, token: str) -> None:
    """Sent past the client's own check, as a script might."""
    renamed = _in_split(phases, "nuscenes-real")
    at_home = phases.client("check", renamed, "--phase", "nuscenes-real", "--json", token=token)
    assert at_home.returncode == 2
    submission = _post(phases, token, renamed, "nuscenes-real", "Wrong frame")
    phases.wait_until(lambda: _status(phases, token, submission["id"])["status"] == "rejected")
    there = _status(phases, token, submission["id"])["report"]
    assert there["faults"] == json.loads(at_home.stdout)["faults"]


def test_a_planners_file_of_another_split_is_refused_too(phases: System, token: str) -> None:
    done = phases.client("check", WRONG_FRAME)
    assert done.returncode == 2
    assert "looks like x right / y forward: swap to (y, -x)" in done.stdout + done.stderr


def test_killing_the_worker_and_emptying_the_broker_loses_and_doubles_nothing(
    phases: System, token: str, tmp_path: Path
) -> None:
    ids = []
    for number in range(12):
        variation = _variation(tmp_path, number)
        ids.append(_post(phases, token, variation, "carla-pairs", f"Variation {number}")["id"])
        if number in (3, 7):
            for pid in phases.worker_pids():
                _kill(pid)
        if number == 9:
            _flush_broker(phases)
    phases.wait_until(
        lambda: all(_status(phases, token, each)["status"] == "scored" for each in ids)
    )
    counted = [each["id"] for each in phases.submissions(token)]
    assert sorted(each for each in counted if each in ids) == sorted(ids)
    audit = phases.operate("exceptiondrive-server", "verify-audit")
    assert "whole" in audit or "ok" in audit.lower()


def _status(system: System, token: str, submission_id: str) -> dict[str, Any]:
    done = system.client("status", submission_id, "--json", token=token)
    submission: dict[str, Any] = json.loads(done.stdout)
    return submission


def _post(system: System, token: str, file: Path, phase: str, method: str) -> dict[str, Any]:
    import httpx2

    with file.open("rb") as stream:
        answer = httpx2.post(
            f"{system.url}/api/v1/submissions",
            headers={"Authorization": f"Bearer {token}"},
            data={"phase": phase, "method": method},
            files={"file": ("file.json", stream)},
            timeout=60,
        )
    assert answer.status_code == 202, answer.text
    submission: dict[str, Any] = answer.json()
    return submission


def _in_split(system: System, phase: str) -> Path:
    """The file of the recorded human in a planner's usual wrong frame: x right, y forward."""
    import gzip

    document = json.loads(gzip.decompress(_file(phase, "recorded-human").read_bytes()))
    for prediction in document["predictions"]:
        for key in ("source", "edited"):
            points = prediction[key]
            prediction[key] = points and [[-y, x] for x, y in points]
    target = system.data / "wrong-frame.json"
    target.write_text(json.dumps(document), "utf-8")
    return target


def _variation(folder: Path, number: int) -> Path:
    """The cosmos file, one waypoint moved by a millimetre."""
    import gzip

    document = json.loads(gzip.decompress(_file("carla-pairs", "cosmos").read_bytes()))
    first = next(p for p in document["predictions"] if p["edited"])
    first["edited"][0][1] += 0.001 * (number + 1)
    target = folder / f"variation-{number}.json"
    target.write_text(json.dumps(document), "utf-8")
    return target


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def _flush_broker(system: System) -> None:
    import redis

    sockets = [path for path in (system.data / "broker").rglob("*") if path.is_socket()]
    assert sockets, "the broker listens on a socket of its own"
    redis.Redis(unix_socket_path=str(sockets[0])).flushall()
