"""Scenes in: nuScenes tables and lines, the made-up set, and what is said of a wrong one."""

import json
import shutil
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import Image

from exceptiondrive_build.scenes.generated import MARK, MARK_RADIUS_M, VERSION, make_scenes
from exceptiondrive_build.scenes.keyframes import CAMERAS, Keyframe, Scenes, ScenesError
from exceptiondrive_build.scenes.nuscenes import rigid
from exceptiondrive_build.scenes.source import read_scenes, write_scenes

ROUND = np.linspace(0, 2 * np.pi, 64, endpoint=False)
CIRCLE = np.stack([np.cos(ROUND), np.sin(ROUND)], axis=1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    make_scenes(folder, n_scenes=3, n_samples=10, seed=3)
    return folder


@pytest.fixture
def set_(made: Path, tmp_path: Path) -> Path:
    """A copy to break."""
    return shutil.copytree(made, tmp_path / "set")


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name, seed in (("one", 5), ("same", 5), ("other", 6)):
        make_scenes(tmp_path / name, n_scenes=1, n_samples=7, seed=seed, width_px=160)
    one, same, other = (files_of(tmp_path / name) for name in ("one", "same", "other"))
    assert len(one) == 7 + 1 + 7 * 6
    assert one == same
    assert all(other.get(name) != data for name, data in one.items() if name.endswith(".jpg"))


def test_every_painted_mark_is_found_where_it_projects_within_a_pixel(made: Path) -> None:
    scenes = read_scenes(made)
    marks = json.loads((made / "marks.json").read_text())
    seen: dict[str, list[float]] = {channel: [] for channel in CAMERAS}
    for keyframe in scenes.keyframes:
        pose = keyframe.ego_pose
        map_from_ego = rigid(np.array(pose.rotation), np.array(pose.translation))
        on_map = np.array([[x, y, 0.0, 1.0] for x, y in marks[keyframe.scene]])
        in_ego = (on_map @ np.linalg.inv(map_from_ego).T)[:, :2]
        for camera in keyframe.cameras:
            picture = Image.open(BytesIO(scenes.picture(keyframe, camera.channel)))
            _, depth = camera.project(in_ego)
            inside = shapely.box(8, 8, camera.width - 8, camera.height - 8)
            for mark_m in in_ego[(depth > 2.5) & (depth < 14)]:
                drawn = shapely.Polygon(camera.project(mark_m + MARK_RADIUS_M * CIRCLE)[0])
                if inside.contains(drawn):
                    u, v = centre_of_mark(np.asarray(picture, dtype=float), drawn.bounds)
                    middle = drawn.centroid  # not the projected middle: nearer halves are larger
                    miss = np.hypot(u - middle.x, v - middle.y)
                    seen[camera.channel].append(float(miss))
    assert all(len(misses) > 1 for misses in seen.values())
    assert max(max(misses) for misses in seen.values()) < 1.0
    assert np.mean([miss for misses in seen.values() for miss in misses]) < 0.3


def centre_of_mark(
    pixels: np.ndarray[Any, Any], bounds: tuple[float, float, float, float]
) -> tuple[float, float]:
    """Middle of what is painted within 4 pixels of where it has to be."""
    left, top, right, bottom = (round(value) for value in bounds)
    left, top = left - 4, top - 4
    part = pixels[top : bottom + 5, left : right + 5]
    hue = part - part.mean(axis=2, keepdims=True)
    wanted = np.array(MARK, dtype=float)
    wanted -= wanted.mean()
    is_mark = (hue @ wanted) > 0.5 * (wanted @ wanted) * np.exp(-0.15)
    rows, columns = np.nonzero(is_mark)
    assert len(rows), "nothing is painted here"
    return float(columns.mean()) + left, float(rows.mean()) + top


def test_what_the_car_drives_until_the_shutter_opens_is_in_the_calibration(made: Path) -> None:
    """Against the four steps of the devkit, one after the other, for a point 9 m ahead."""
    tables = {
        name: {
            row["token"]: row for row in json.loads((made / VERSION / f"{name}.json").read_text())
        }
        for name in ("sample_data", "ego_pose", "calibrated_sensor", "sensor")
    }
    keyframe = read_scenes(made).keyframes[0]
    point, apart_px = np.array([9.0, 0.8, 0.0, 1.0]), {}
    pose = keyframe.ego_pose
    on_map = rigid(np.array(pose.rotation), np.array(pose.translation)) @ point
    for row in tables["sample_data"].values():
        sensor = tables["calibrated_sensor"][row["calibrated_sensor_token"]]
        channel = tables["sensor"][sensor["sensor_token"]]["channel"]
        if row["sample_token"] != keyframe.keyframe_id or channel != "CAM_FRONT":
            continue
        at_shutter = tables["ego_pose"][row["ego_pose_token"]]
        ego = np.linalg.inv(matrix(at_shutter)) @ on_map
        pixel = np.array(sensor["camera_intrinsic"]) @ (np.linalg.inv(matrix(sensor)) @ ego)[:3]
        without = np.array(sensor["camera_intrinsic"]) @ (np.linalg.inv(matrix(sensor)) @ point)[:3]
        ours, _ = keyframe.camera(channel).project(point[None, :2])
        assert ours[0] == pytest.approx(pixel[:2] / pixel[2], abs=1e-6)
        apart_px[channel] = np.abs(without[:2] / without[2] - ours[0]).max()
    assert apart_px["CAM_FRONT"] > 1


def matrix(row: dict[str, Any]) -> Any:
    return rigid(np.array(row["rotation"]), np.array(row["translation"]))


def test_the_recorded_path_is_where_the_next_six_samples_stand(made: Path) -> None:
    keyframe = read_scenes(made).keyframes[0]
    path = np.array(keyframe.recorded)
    steps_m = np.hypot(*np.diff(np.vstack([[0, 0], path]), axis=0).T)
    assert path.shape == (6, 2)
    assert (path[:, 0] > 0).all()
    assert (steps_m > 0.5).all()
    assert (steps_m < 7).all()


def test_a_point_ahead_is_in_the_picture_ahead_and_behind_the_camera_behind(made: Path) -> None:
    keyframe = read_scenes(made).keyframes[0]
    ahead = np.array([[15.0, 0.0]])
    pixel, depth = keyframe.camera("CAM_FRONT").project(ahead)
    width = keyframe.camera("CAM_FRONT").width
    assert depth[0] > 0
    assert abs(pixel[0, 0] - width / 2) < 5
    assert keyframe.camera("CAM_BACK").project(ahead)[1][0] < 0
    left = np.array([[12.0, 10.0]])
    assert keyframe.camera("CAM_FRONT").project(left)[0][0, 0] < width / 2


def test_lines_say_the_same_as_tables(made: Path) -> None:
    scenes = read_scenes(made)
    write_scenes(scenes, made / "scenes.jsonl")
    again = read_scenes(made / "scenes.jsonl")
    assert again == scenes
    assert len(again.keyframes) == 12


def test_keyframes_are_spread_over_each_scene() -> None:
    def keyframe(scene: str, index: int) -> Keyframe:
        fields: dict[str, Any] = {"keyframe_id": f"{scene}{index}", "scene_id": scene}
        return Keyframe.model_construct(**fields)

    scenes = Scenes(Path(), tuple(keyframe(s, i) for s in "ab" for i in range(10)))
    ids = [[k.keyframe_id for k in scenes.spread(n).keyframes] for n in (1, 2, 99)]
    assert ids[0] == ["a5", "b5"]
    assert ids[1] == ["a2", "a7", "b2", "b7"]
    assert len(ids[2]) == 20


def edit(table: str, change: Callable[[list[dict[str, Any]]], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / VERSION / f"{table}.json"
        rows = json.loads(path.read_text())
        change(rows)
        path.write_text(json.dumps(rows))

    return apply


def drop_camera(rows: list[dict[str, Any]]) -> None:
    found = next(row for row in rows if "CAM_BACK_LEFT" in row["filename"])
    rows.remove(found)


def first_picture(folder: Path) -> Path:
    return min((folder / "samples" / "CAM_FRONT").iterdir())


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "camera": (edit("sample_data", drop_camera), r"of scene scene-0001 has no CAM_BACK_LEFT"),
    "version": (
        lambda folder: (folder / VERSION).rename(folder / "v2.0-trainval"),
        r"holds tables v2.0-trainval; v1.0 of nuScenes is read",
    ),
    "column": (
        edit("sample", lambda rows: [row.pop("scene_token") for row in rows]),
        r"sample.json is of another version than v1.0: it lacks scene_token",
    ),
    "table": (
        lambda folder: (folder / VERSION / "ego_pose.json").unlink(),
        r"missing table: .*ego_pose.json",
    ),
    "json": (
        lambda folder: (folder / VERSION / "log.json").write_text("<html>"),
        r"log.json is no table of nuScenes",
    ),
    "pose": (
        edit("ego_pose", lambda rows: rows[0].update(rotation=[1, 1, 0, 0])),
        r"ego_pose.json, row [0-9a-f]{32}: no translation of three metres and unit quaternion",
    ),
    "row": (edit("ego_pose", lambda rows: rows.pop(0)), r"ego_pose.json has no row [0-9a-f]{32}"),
    "sensor": (
        edit("calibrated_sensor", lambda rows: rows.pop(0)),
        r"calibrated_sensor.json has no row [0-9a-f]{32}",
    ),
    "intrinsic": (
        edit("calibrated_sensor", lambda rows: rows[1].update(camera_intrinsic=[])),
        r"the camera_intrinsic of CAM_FRONT is no 3 x 3 matrix",
    ),
    "picture": (
        lambda folder: first_picture(folder).unlink(),
        r"missing picture: .*CAM_FRONT__000.jpg \(CAM_FRONT of keyframe .*, scene scene-0001\)",
    ),
    "tables": (lambda folder: shutil.rmtree(folder / VERSION), r"holds no tables"),
    "two": (
        lambda folder: shutil.copytree(folder / VERSION, folder / "v1.0-trainval"),
        r"holds tables v1.0-mini and v1.0-trainval: say which",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_set_is_refused_with_what_and_where(what: str, set_: Path) -> None:
    spoil, words = WRONG[what]
    spoil(set_)
    with pytest.raises(ScenesError, match=words):
        read_scenes(set_)


def test_of_two_versions_the_named_one_is_read(set_: Path) -> None:
    shutil.copytree(set_ / VERSION, set_ / "v1.0-trainval")
    assert len(read_scenes(set_, "v1.0-trainval").keyframes) == 12


def test_a_keyframe_before_a_gap_has_no_recorded_path(set_: Path) -> None:
    def later(rows: list[dict[str, Any]]) -> None:
        for row in rows[5:8]:
            row["timestamp"] += 400_000

    edit("sample", later)(set_)
    assert len(read_scenes(set_).keyframes) == 8


@pytest.mark.parametrize("content", [b"", b"<html>no", None], ids=["empty", "html", "cut"])
def test_an_unreadable_picture_is_named(set_: Path, content: bytes | None) -> None:
    path = first_picture(set_)
    path.write_bytes(path.read_bytes()[:3000] if content is None else content)
    scenes = read_scenes(set_)
    with pytest.raises(ScenesError, match=r"unreadable picture: .*CAM_FRONT__000.jpg \(CAM_FRONT"):
        scenes.picture(scenes.keyframes[0], "CAM_FRONT")


def test_a_picture_of_another_size_is_named(set_: Path) -> None:
    Image.new("RGB", (64, 36)).save(first_picture(set_))
    scenes = read_scenes(set_)
    with pytest.raises(ScenesError, match=r"picture of 64 x 36 pixels where the tables say 480 x"):
        scenes.picture(scenes.keyframes[0], "CAM_FRONT")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda line: line.update(recorded=line["recorded"][:5]), r"line 2: recorded: .*6 items"),
        (lambda line: line["cameras"].reverse(), r"line 2: the cameras are CAM_BACK_RIGHT"),
        (lambda line: line["cameras"][0].pop("intrinsic"), r"line 2: cameras.0.intrinsic"),
        (lambda line: line.update(speed=3), r"line 2: speed: Extra inputs"),
        (lambda line: line["cameras"][2].update(picture="no.jpg"), r"missing picture: .*no.jpg"),
    ],
    ids=["path", "cameras", "intrinsic", "extra", "picture"],
)
def test_a_wrong_line_is_refused_with_its_number(
    set_: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    write_scenes(read_scenes(set_), set_ / "scenes.jsonl")
    lines = (set_ / "scenes.jsonl").read_text().splitlines()
    line = json.loads(lines[1])
    change(line)
    lines[1] = json.dumps(line)
    (set_ / "scenes.jsonl").write_text("\n".join(lines))
    with pytest.raises(ScenesError, match=words):
        read_scenes(set_ / "scenes.jsonl")


def test_a_keyframe_given_twice_is_named(set_: Path) -> None:
    scenes = read_scenes(set_)
    write_scenes(Scenes(set_, scenes.keyframes * 2), set_ / "scenes.jsonl")
    with pytest.raises(ScenesError, match=f"given twice: .*{scenes.keyframes[0].keyframe_id}"):
        read_scenes(set_ / "scenes.jsonl")


def test_no_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenesError, match=r"no scenes at .*none.jsonl: No such file"):
        read_scenes(tmp_path / "none.jsonl")
