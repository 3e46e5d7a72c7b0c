"""Proposals for regions: detectors' files in both forms, in the right frame, and by hand."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.build.test_stages import report, walked
from typer.testing import CliRunner, Result

from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.cli import app
from exceptiondrive_build.scenes.nuscenes import rigid
from exceptiondrive_build.values import Screened

BOX = np.array([[2.0, 1.0], [-2.0, 1.0], [-2.0, -1.0], [2.0, -1.0]])


@pytest.fixture(scope="module")
def once_reviewed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first workshop of this file is kept, to copy."""
    return tmp_path_factory.mktemp("reviewed") / "shop"


@pytest.fixture
def reviewed(request: pytest.FixtureRequest, once_reviewed: Path, tmp_path: Path) -> Path:
    """A workshop whose candidates are all reviewed."""
    if not once_reviewed.exists():
        shop: Path = request.getfixturevalue("shop")
        for stage in ("screen", "edit", "review"):
            report(shop, stage)
        shutil.move(shop, once_reviewed)
    return Path(shutil.copytree(once_reviewed, tmp_path / "shop"))


def accepted(shop: Path) -> list[Candidate]:
    return [candidate for candidate in walked(shop).values() if candidate.is_accepted]


def target(candidate: Candidate) -> tuple[float, float]:
    assert isinstance(candidate.screened, Screened)
    assert candidate.screened.target_m
    return candidate.screened.target_m


def localize(shop: Path, document: Any) -> Result:
    path = shop / "detections.json"
    path.write_text(json.dumps(document) if not isinstance(document, str) else document)
    return CliRunner().invoke(
        app, ["localize", "-w", str(shop), "--detections", str(path), "--json"]
    )


def corners(shop: Path) -> dict[str, Any]:
    return {c.sample_id: c.localized and c.localized.corners for c in accepted(shop)}


def test_the_box_nearest_to_the_target_is_proposed_once(reviewed: Path) -> None:
    boxes = {
        c.sample_id: [
            {"corners": (BOX + target(c) + np.array([6.0, 0.0])).tolist(), "score": 0.9},
            {"corners": (BOX + target(c) + np.array([0.5, 0.25])).tolist(), "score": 0.4},
        ]
        for c in accepted(reviewed)
    }
    done = json.loads(localize(reviewed, boxes).stdout)
    assert done == {"proposed": len(boxes), "unchanged": 0, "without": {}}
    for candidate in accepted(reviewed):
        assert candidate.localized is not None
        assert candidate.localized.score == 0.4
        expected = BOX + target(candidate) + np.array([0.5, 0.25])
        np.testing.assert_allclose(candidate.localized.corners, expected, atol=6e-4)
    again = json.loads(localize(reviewed, boxes).stdout)
    assert (again["proposed"], again["unchanged"]) == (0, len(boxes))


def test_plain_corners_in_any_order_and_by_keyframe_are_taken(reviewed: Path) -> None:
    crossed = BOX[[0, 2, 1, 3]]
    one = accepted(reviewed)[0]
    boxes = {one.keyframe.keyframe_id: (crossed + target(one)).tolist()}
    done = json.loads(localize(reviewed, boxes).stdout)
    assert done["proposed"] >= 1
    assert done["proposed"] + sum(done["without"].values()) == len(accepted(reviewed))
    found = corners(reviewed)[one.sample_id]
    assert found is not None
    assert {tuple(c) for c in np.round(np.array(found) - target(one), 2)} == {tuple(c) for c in BOX}


def test_boxes_of_nuscenes_results_come_into_the_ego_frame(reviewed: Path) -> None:
    results: dict[str, list[dict[str, Any]]] = {}
    for candidate in accepted(reviewed):
        keyframe = candidate.keyframe
        rotation = np.array(keyframe.ego_rotation)
        pose = rigid(rotation, np.array(keyframe.ego_translation_m))
        translation = pose @ np.array([*target(candidate), 0.8, 1.0])
        results[candidate.sample_id] = [
            {
                "sample_token": candidate.sample_id,
                "translation": translation[:3].tolist(),
                "size": [2.0, 4.0, 1.6],
                "rotation": rotation.tolist(),
                "velocity": [0.0, 0.0],
                "detection_name": "barrier",
                "detection_score": 0.7,
                "attribute_name": "",
            }
        ]
    done = json.loads(localize(reviewed, {"meta": {"use_camera": True}, "results": results}).stdout)
    assert done["proposed"] == len(results)
    for candidate in accepted(reviewed):
        assert candidate.localized is not None
        expected = BOX + target(candidate)
        np.testing.assert_allclose(candidate.localized.corners, expected, atol=2e-3)


@pytest.mark.parametrize(
    ("move", "said"),
    [
        (lambda box: box[:, ::-1], "with x and y exchanged it would be 0.0 m"),
        (lambda box: box * (-1, 1), "with x backwards it would be 0.0 m"),
        (lambda box: box + np.array([1000.0, 600.0]), "lie over 11"),
    ],
)
def test_corners_in_another_frame_are_refused_whole(reviewed: Path, move: Any, said: str) -> None:
    boxes = {c.sample_id: move(BOX + target(c)).tolist() for c in accepted(reviewed)}
    result = localize(reviewed, boxes)
    assert result.exit_code == 2
    assert said in result.stderr
    assert "nothing is recorded" in result.stderr
    assert set(corners(reviewed).values()) == {None}


def box(**changed: list[float]) -> dict[str, list[float]]:
    return {"translation": [0, 0, 0], "size": [2, 4, 2], "rotation": [1, 0, 0, 0], **changed}


@pytest.mark.parametrize(
    "document",
    [
        "{",
        "[" * 100_000,
        "[1, 2]",
        {"a": [{"corners": [[0, 0]]}]},
        {"results": {"a": [{"size": 1}]}},
        {"a": 3},
        {"a": [{"corners": [[1e308, 0], [1e308, 1], [-1e308, 1], [-1e308, 0]]}]},
        {"results": {"a": [box(rotation=[0, 0, 0, 0])]}},
        {"results": {"a": [box(size=[1e308, 1e308, 1])]}},
        {"results": {"a": [box(translation=[1e308, 0, 0])]}},
    ],
    ids=range(10),
)
def test_a_file_that_is_no_detectors_is_refused(reviewed: Path, document: Any) -> None:
    result = localize(reviewed, document)
    assert result.exit_code == 2
    assert "no detector's file" in result.stderr
    assert "Its forms: exceptiondrive-build localize --help" in result.stderr


def test_a_file_about_other_scenes_is_refused(reviewed: Path) -> None:
    documents: list[Any] = [{"other": BOX.tolist()}, {"results": {"other": []}}, {}]
    for document in documents:
        result = localize(reviewed, document)
        assert result.exit_code == 2
        assert "none of its ids is that of a sample or a keyframe of this workshop" in result.stderr


def test_the_help_shows_the_forms_of_a_detectors_file() -> None:
    said = CliRunner().invoke(app, ["localize", "--help"]).stdout
    assert '  {"ID": [{"corners": [[x, y], [x, y], [x, y], [x, y]], "score": 0.9}]}\n' in said
    assert '  {"results": {"ID": [{"translation": [x, y, z], "size": [' in said


def test_what_has_no_box_near_is_counted_and_can_be_laid_by_hand(reviewed: Path) -> None:
    first, second, *rest = accepted(reviewed)
    boxes = {c.sample_id: (BOX + target(c)).tolist() for c in rest}
    boxes[first.sample_id] = (BOX + target(first) + np.array([30.0, 0.0])).tolist()
    done = json.loads(localize(reviewed, boxes).stdout)
    assert done["without"] == {"no box near the target": 1, "no box in the file": 1}
    command = ["localize", "-w", str(reviewed), "--by-hand", "--json"]
    assert json.loads(CliRunner().invoke(app, command).stdout)["proposed"] == 2
    by_hand = {c.sample_id: c.localized for c in accepted(reviewed)}[second.sample_id]
    assert by_hand is not None
    assert by_hand.source == "by_hand"
    np.testing.assert_allclose(np.mean(by_hand.corners, axis=0), target(second), atol=1e-3)
