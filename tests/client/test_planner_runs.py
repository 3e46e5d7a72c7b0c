"""A trajectory known by hand comes out the same from the files of every planner."""

import io
import itertools
import json
import math
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exceptiondrive.conversion import ConversionPlan, Waypoints, convert
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.planner_runs import FORMS, planner_form, read_runs
from exceptiondrive_schemas.protocol import packaged_protocol

GEOMETRY = packaged_protocol().geometry
SPEED_MPS, CURVATURE = 4.0, 0.05
TOKEN = "0f1e"
DOCS = Path(__file__).parents[2] / "docs/client.md"


def known() -> Waypoints:
    """A left turn of radius 20 m at 4 m/s: 2 m every half second, each turned by 0.1 rad."""
    x = y = 0.0
    points = []
    for step in range(6):
        x, y = x + 2.0 * math.cos(0.1 * step), y + 2.0 * math.sin(0.1 * step)
        points.append((x, y))
    return tuple(points)


def x_to_the_right() -> list[list[float]]:
    return [[-y, x] for x, y in known()]


def increments(points: list[list[float]]) -> list[list[float]]:
    return [[x - x0, y - y0] for (x0, y0), (x, y) in itertools.pairwise([[0.0, 0.0], *points])]


def finer(n_between: int, n_beyond: int) -> list[list[float]]:
    """The same drive with waypoints between, and going on straight."""
    (x0, y0), (x1, y1) = known()[-2:]
    beyond = [(x1 + k * (x1 - x0), y1 + k * (y1 - y0)) for k in range(1, n_beyond + 1)]
    corners = [(0.0, 0.0), *known(), *beyond]
    return [
        [xa + share / n_between * (xb - xa), ya + share / n_between * (yb - ya)]
        for (xa, ya), (xb, yb) in itertools.pairwise(corners)
        for share in range(1, n_between + 1)
    ]


def heading(points: list[list[float]]) -> list[list[float]]:
    return [[*point, 0.1] for point in points]


def as_json(folder: Path, document: Any, name: str = "run.json") -> Path:
    path = folder / name
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def npz(folder: Path) -> Path:
    path = folder / "run.npz"
    np.savez(path, token=np.array([TOKEN.encode()]), trajectory=np.array([known()]))
    return path


def vad(folder: Path) -> Path:
    """Three modes of increments, of which the command chooses the second."""
    other = [[9.0, 9.0]] * 6
    modes = [other, increments(x_to_the_right()), other]
    command = [[[[0.0, 1.0, 0.0]]]]
    return as_json(folder, {TOKEN: {"ego_fut_preds": modes, "ego_fut_cmd": command}})


def bench2drive(folder: Path) -> Path:
    """`pid_metadata` of an agent, in a folder of frames."""
    metadata = {"agent": "only_traj", "steer": 0.0, "plan": x_to_the_right(), "command": 3}
    return as_json(folder, metadata, f"{TOKEN}.json").parent


def lightemma(folder: Path) -> Path:
    frame = {
        "frame_index": 0,
        "sample_token": TOKEN,
        "image_name": "n008__CAM_FRONT__1.jpg",
        "inference": {"pred_actions_str": str([(SPEED_MPS, CURVATURE)] * 6), "actions": "-"},
    }
    scene = {"scene_info": {"name": "scene-0077"}, "frames": [frame], "metadata": {}}
    return as_json(folder, scene, "scene-0077.json").parent


def waymo(folder: Path) -> Path:
    points = finer(2, 4)
    assert len(points) == 20, "5 s at 4 Hz"
    trajectory = {"posX": [x for x, _ in points], "posY": [y for _, y in points]}
    frames = [{"frameName": TOKEN, "trajectory": trajectory}]
    return as_json(folder, {"predictions": frames, "accountName": "a@example.org"})


RUNS: dict[str, tuple[str, Callable[[Path], Path], float | None]] = {
    "JSON": ("trajectories", lambda folder: as_json(folder, {TOKEN: known()}), None),
    "arrays": ("trajectories", npz, None),
    "UniAD": ("uniad", lambda folder: as_json(folder, {TOKEN: [x_to_the_right()]}), None),
    "ST-P3": ("st-p3", lambda folder: as_json(folder, {TOKEN: heading(x_to_the_right())}), None),
    "Agent-Driver": ("agent-driver", lambda f: as_json(f, {TOKEN: x_to_the_right()}), None),
    "VAD": ("vad", vad, None),
    "Bench2Drive": ("bench2drive", bench2drive, None),
    "LightEMMA": ("lightemma", lightemma, None),
    "NAVSIM": ("navsim", lambda f: as_json(f, {TOKEN: {"poses": heading(finer(1, 2))}}), 0.5),
    "nuPlan": ("navsim", lambda f: as_json(f, {TOKEN: {"poses": heading(finer(5, 10))}}), 0.1),
    "Waymo": ("waymo", waymo, None),
}


def plan_of(name: str, time_step_s: float | None) -> ConversionPlan:
    form = FORMS[name]
    step_s = form.time_step_s if time_step_s is None else time_step_s
    return ConversionPlan(GEOMETRY, rotate_deg=form.rotate_deg, time_step_s=step_s, truncate=True)


@pytest.mark.parametrize("planner", RUNS)
def test_a_known_trajectory_comes_out_the_same(planner: str, tmp_path: Path) -> None:
    name, write, time_step_s = RUNS[planner]
    path = write(tmp_path)
    pairs = read_runs(planner_form(name), [path], [path], None)
    result = convert(pairs, plan_of(name, time_step_s))
    (found,) = result.pairs
    assert found.sample_id == TOKEN
    for points in (found.source, found.edited):
        assert points is not None
        assert [list(point) for point in points] == [
            pytest.approx(list(point), abs=1e-9) for point in known()
        ]


def pickles() -> dict[str, tuple[str, float | None, Any]]:
    """By file: the form, its time step, and what the planner's own code puts into that pickle."""
    right = np.array(x_to_the_right())
    modes = np.array([right * 9, increments(right.tolist()), right * 9])
    poses = np.array(heading(finer(1, 2)))
    return {
        "pred_trajs_dict.pkl": ("agent-driver", None, {TOKEN: right}),
        "results.pkl": (
            "uniad",
            None,
            {"bbox_results": [{"token": TOKEN, "planning_traj": right[np.newaxis]}]},
        ),
        "results_nusc.pkl": (
            "vad",
            None,
            {"plan_results": {TOKEN: [modes, np.array([[[[0.0, 1.0, 0.0]]]])]}},
        ),
        "submission.pkl": (
            "navsim",
            0.5,
            {"first_stage_predictions": [{TOKEN: SimpleNamespace(poses=poses)}]},
        ),
    }


@pytest.mark.parametrize("name", pickles())
def test_the_lines_of_the_docs_dump_each_pickle(name: str, tmp_path: Path) -> None:
    form, time_step_s, document = pickles()[name]
    (tmp_path / name).write_bytes(pickle.dumps(document))
    lines = re.findall(r'^python -c "(.*)"$', DOCS.read_text("utf-8"), re.MULTILINE)
    (line,) = (each for each in lines if f"'{name}'" in each)
    subprocess.run([sys.executable, "-c", line], cwd=tmp_path, check=True)
    path = tmp_path / "run.json"
    result = convert(read_runs(FORMS[form], [path], [path], None), plan_of(form, time_step_s))
    assert result.pairs[0].source is not None
    assert [list(point) for point in result.pairs[0].source] == [
        pytest.approx(list(point), abs=1e-9) for point in known()
    ]


def test_every_line_of_the_docs_is_tried() -> None:
    names = re.findall(
        r'^python -c ".*?open\(\'([\w.]+\.pkl)\'', DOCS.read_text("utf-8"), re.MULTILINE
    )
    assert sorted(names) == sorted(pickles())


@pytest.mark.parametrize("name", FORMS)
def test_every_reader_cites_the_code_that_writes_its_files(name: str) -> None:
    """Repository, commit and lines; of Waymo the line of the format."""
    words = " ".join((FORMS[name].read.__doc__ or "").split())
    assert re.search(r"[\w.-]+(/[\w.-]+| of Waymo) @ [0-9a-f]{7}", words)
    assert re.search(r"\.(py|md|proto),? lines? \d+", words)


def test_every_form_is_tried_and_told() -> None:
    assert {name for name, _, _ in RUNS.values()} == set(FORMS)
    _, _, table = DOCS.read_text(encoding="utf-8").partition("| `--from` |")
    rows = re.findall(r"^\| (`.+?) \|", table.partition("\n\n")[0], re.MULTILINE)
    assert [name for row in rows for name in re.findall("`(.+?)`", row)] == list(FORMS)


@pytest.mark.parametrize(
    "said",
    [
        "I cannot see the road.",
        "[(1, 0)]",
        "[(1, 0)] * 6",
        "__import__('os').mkdir('made')",
        "[(1, 'a')] ",
        None,
        "(" * 10_000,
        str([(1e308, 1e308)] * 6),
        str([(10**400, 0)] * 6),
        [[1.0, 0.0]] * 5,
    ],
    ids=range(10),
)
def test_an_answer_of_lightemma_that_is_no_six_pairs_is_missing(said: Any, tmp_path: Path) -> None:
    scene = {"frames": [{"sample_token": TOKEN, "inference": {"pred_actions_str": said}}]}
    path = as_json(tmp_path, scene)
    forms: list[str] = []
    (pair,) = read_runs(FORMS["lightemma"], [path], [], None, forms.append)
    assert (pair.source, pair.edited) == (None, None)
    assert forms == ["answers that are no 6 pairs of speed and curvature as null"]
    assert not Path("made").exists()


def test_actions_of_lightemma_are_a_text_or_the_list_itself(tmp_path: Path) -> None:
    actions = [(SPEED_MPS, CURVATURE)] * 6
    said = {"text": str(actions), "list": actions}
    frames = [
        {"sample_token": name, "inference": {"pred_actions_str": each}}
        for name, each in said.items()
    ]
    forms: list[str] = []
    path = as_json(tmp_path, {"frames": frames})
    text, listed = read_runs(FORMS["lightemma"], [path], [], None, forms.append)
    assert text.source is not None
    assert listed.source == text.source
    assert forms == []


def test_a_token_of_one_run_alone_has_no_other_trajectory(tmp_path: Path) -> None:
    first = as_json(tmp_path, {"a": known(), "b": known()}, "a.json")
    second = as_json(tmp_path, {"b": known(), "c": None}, "b.json")
    pairs = read_runs(FORMS["trajectories"], [first], [second], None)
    assert [(p.sample_id, p.source is None, p.edited is None) for p in pairs] == [
        ("a", False, True),
        ("b", False, False),
        ("c", True, True),
    ]


@pytest.mark.parametrize(
    ("name", "document", "message"),
    [
        ("vad", {TOKEN: [[1, 2]]}, "needs ego_fut_preds and ego_fut_cmd"),
        ("vad", {TOKEN: {"ego_fut_preds": [[[1, 2]] * 6] * 3, "ego_fut_cmd": [0] * 3}}, "one flag"),
        ("vad", {TOKEN: {"ego_fut_preds": [[[1, 2]] * 6], "ego_fut_cmd": [0, 1]}}, "for each flag"),
        ("lightemma", {"frames": [{}]}, "needs frames with a token"),
        ("lightemma", {"frames": [{"sample_token": "a", "inference": {}}]}, "pred_actions_str"),
        ("waymo", {"predictions": [{"frameName": "a"}]}, "needs predictions with frameName"),
        (
            "waymo",
            {"predictions": [{"frameName": "a", "trajectory": {"posX": [1, 2], "posY": [1]}}]},
            "as many posX as posY",
        ),
        ("lightemma", {"frames": 3}, "frames must be a list"),
        ("waymo", {"predictions": 3}, "predictions must be a list"),
        ("uniad", [1], "must be a JSON object by token"),
        ("uniad", {TOKEN: "x"}, "must be a list of"),
    ],
)
def test_a_file_of_another_form_is_refused(
    name: str, document: Any, message: str, tmp_path: Path
) -> None:
    path = as_json(tmp_path, document)
    with pytest.raises(InvalidArgumentError, match=message):
        read_runs(FORMS[name], [path], [], None)


def test_increments_that_are_no_points_are_left_to_be_refused(tmp_path: Path) -> None:
    result = {"ego_fut_preds": [[[1.0]] * 6] * 3, "ego_fut_cmd": [1, 0, 0]}
    path = as_json(tmp_path, {TOKEN: result})
    (pair,) = read_runs(FORMS["vad"], [path], [path], None)
    assert pair.source == pair.edited == ((1.0,),) * 6


def test_a_file_that_is_nested_too_deeply_is_no_json(tmp_path: Path) -> None:
    path = as_json(tmp_path, None)
    path.write_text("[" * 100_000)
    with pytest.raises(InvalidArgumentError, match="is not JSON: nested too deeply"):
        read_runs(FORMS["vad"], [path], [], None)


def test_an_unknown_planner_is_told_which_are_known() -> None:
    with pytest.raises(InvalidArgumentError, match="one of trajectories, uniad"):
        planner_form("unidad")


def test_a_run_may_come_from_stdin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = json.dumps({TOKEN: known()})
    (run := tmp_path / "run.json").write_text(text, encoding="utf-8")
    stdin = SimpleNamespace(buffer=io.BytesIO(text.encode()))
    monkeypatch.setattr("exceptiondrive.pair_files.sys.stdin", stdin)
    (pair,) = read_runs(planner_form("trajectories"), [Path("-")], [run], None)
    assert pair.source == pair.edited == tuple(map(tuple, known()))


def test_a_token_that_stands_twice_in_a_run_is_refused(tmp_path: Path) -> None:
    run = tmp_path / "run.json"
    run.write_text(f'{{"{TOKEN}": {json.dumps(known())}, "{TOKEN}": null}}', encoding="utf-8")
    with pytest.raises(InvalidArgumentError, match=f"{TOKEN} occurs twice"):
        read_runs(planner_form("trajectories"), [run], [run], None)
