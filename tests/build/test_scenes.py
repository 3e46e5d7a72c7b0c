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
from tests.build.shop import ground_polygon, make_shop
from tests.support.made_pictures import png_that_says
from typer.testing import CliRunner

from exceptiondrive_build.cli import app
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.scenes.cameras import project
from exceptiondrive_build.scenes.generated import MARK, MARK_RADIUS_M, VERSION, make_scenes
from exceptiondrive_build.scenes.keyframe import Keyframe
from exceptiondrive_build.scenes.nuscenes import CAMERAS, rigid
from exceptiondrive_build.scenes.read_in import read_in, read_scenes, write_scenes
from exceptiondrive_build.scenes.scene_set import SceneSet
from exceptiondrive_build.workshop import Workshop, new_workshop

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
        map_from_ego = pose_of(keyframe)
        on_map = np.array([[x, y, 0.0, 1.0] for x, y in marks[keyframe.scene]])
        in_ego = (on_map @ np.linalg.inv(map_from_ego).T)[:, :2]
        for camera in keyframe.cameras:
            picture = Image.open(BytesIO(scenes.picture(keyframe, camera)[0]))
            inside = shapely.box(8, 8, camera.width_px - 8, camera.height_px - 8)
            for mark_m in in_ego[np.hypot(*in_ego.T) < 14]:
                drawn = shapely.Polygon(ground_polygon(camera, mark_m + MARK_RADIUS_M * CIRCLE))
                if inside.contains(drawn):
                    u, v = centre_of_mark(np.asarray(picture, dtype=float), drawn.bounds)
                    middle = drawn.centroid  # not the projected middle: nearer halves are larger
                    miss = np.hypot(u - middle.x, v - middle.y)
                    seen[camera.view].append(float(miss))
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
    on_map = pose_of(keyframe) @ point
    for row in tables["sample_data"].values():
        sensor = tables["calibrated_sensor"][row["calibrated_sensor_token"]]
        channel = tables["sensor"][sensor["sensor_token"]]["channel"]
        if row["sample_token"] != keyframe.keyframe_id or channel != "CAM_FRONT":
            continue
        at_shutter = tables["ego_pose"][row["ego_pose_token"]]
        ego = np.linalg.inv(matrix(at_shutter)) @ on_map
        pixel = np.array(sensor["camera_intrinsic"]) @ (np.linalg.inv(matrix(sensor)) @ ego)[:3]
        without = np.array(sensor["camera_intrinsic"]) @ (np.linalg.inv(matrix(sensor)) @ point)[:3]
        ours = project(keyframe.camera(channel), point[None, :2])
        assert ours[0] == pytest.approx(pixel[:2] / pixel[2], abs=1e-6)
        apart_px[channel] = np.abs(without[:2] / without[2] - ours[0]).max()
    assert apart_px["CAM_FRONT"] > 1


def pose_of(keyframe: Keyframe) -> Any:
    return rigid(np.array(keyframe.ego_rotation), np.array(keyframe.ego_translation_m))


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
    front, back = keyframe.camera("CAM_FRONT"), keyframe.camera("CAM_BACK")
    assert abs(project(front, ahead)[0, 0] - front.width_px / 2) < 5
    assert np.isnan(project(back, ahead)).all()
    left = np.array([[12.0, 10.0]])
    assert project(front, left)[0, 0] < front.width_px / 2


def test_of_a_polygon_around_the_car_each_camera_gets_what_is_in_front_of_it(made: Path) -> None:
    keyframe = read_scenes(made).keyframes[0]
    around = np.array([[20.0, -9.0], [20.0, 9.0], [-20.0, 9.0], [-20.0, -9.0]])
    for camera in keyframe.cameras:
        drawn = shapely.Polygon(ground_polygon(camera, around))
        below_car = shapely.Point(camera.width_px / 2, camera.height_px - 2)
        assert drawn.is_valid
        assert drawn.contains(below_car)
    ahead_alone = np.array([[9.0, -1.0], [9.0, 1.0], [12.0, 1.0], [12.0, -1.0]])
    assert len(ground_polygon(keyframe.camera("CAM_BACK"), ahead_alone)) == 0
    whole = ground_polygon(keyframe.camera("CAM_FRONT"), ahead_alone)
    assert whole == pytest.approx(project(keyframe.camera("CAM_FRONT"), ahead_alone))


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

    scenes = SceneSet(Path(), tuple(keyframe(s, i) for s in "ab" for i in range(10)))
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


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


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
    "depth": (
        lambda folder: (folder / VERSION / "log.json").write_text("[" * 100_000),
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
    "folder": (
        lambda folder: as_folder(folder / VERSION / "scene.json"),
        r"scene.json: Is a directory",
    ),
    "no rows": (
        lambda folder: (folder / VERSION / "log.json").write_text("null"),
        r"log.json",
    ),
    "sensor twice": (
        edit("sensor", lambda rows: rows.append(rows[0])),
        r"sensor.json: row [0-9a-f]{32} stands there twice",
    ),
    "calibrated twice": (
        edit("calibrated_sensor", lambda rows: rows.append(rows[0])),
        r"calibrated_sensor.json: row [0-9a-f]{32} stands there twice",
    ),
    "translation": (
        edit("ego_pose", lambda rows: rows[0].update(translation=["a", "b", "c"])),
        r"ego_pose.json, row [0-9a-f]{32}: no translation of three metres",
    ),
    "far translation": (
        edit("ego_pose", lambda rows: rows[0].update(translation=[1e300, 0, 0])),
        r"ego_pose.json, row [0-9a-f]{32}: no translation of three metres",
    ),
    "intrinsic of words": (
        edit("calibrated_sensor", lambda rows: rows[1].update(camera_intrinsic=[["a"] * 3] * 3)),
        r"the camera_intrinsic of CAM_FRONT is no 3 x 3 matrix",
    ),
    "intrinsic of nothing": (
        edit("calibrated_sensor", lambda rows: rows[1].update(camera_intrinsic=[[0] * 3] * 3)),
        r"sample_data.json, row [0-9a-f]{32}: CAM_FRONT: intrinsic: no camera matrix",
    ),
    "timestamp": (
        edit("sample", lambda rows: rows[1].update(timestamp="x")),
        r"sample.json, row 2 \([0-9a-f]{32}\): timestamp is no whole number",
    ),
    "token": (
        edit("sample", lambda rows: rows[1].update(scene_token=["x"])),
        r"sample.json, row 2 \([0-9a-f]{32}\): scene_token is no text",
    ),
    "description": (
        edit("scene", lambda rows: rows[0].pop("description")),
        r"scene.json, row 1 \([0-9a-f]{32}\): description is no text",
    ),
    "no width": (
        edit("sample_data", lambda rows: rows[0].update(width=None)),
        r"sample_data.json, row [0-9a-f]{32}: width and height of CAM_FRONT_LEFT are no numbers",
    ),
    "lacking width": (
        edit("sample_data", lambda rows: rows[0].pop("width")),
        r"sample_data.json, row [0-9a-f]{32}: width and height of CAM_FRONT_LEFT are no numbers",
    ),
    "width of words": (
        edit("sample_data", lambda rows: rows[0].update(width="wide")),
        r"sample_data.json, row [0-9a-f]{32}: width and height of CAM_FRONT_LEFT are no numbers",
    ),
    "picture": (
        lambda folder: first_picture(folder).unlink(),
        r"Missing picture: .*CAM_FRONT__000.jpg \(CAM_FRONT of keyframe .*, scene scene-0001\)",
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
    with pytest.raises(BuildError, match=words) as refused:
        read_scenes(set_)
    assert "pydantic" not in refused.value.sentence


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
    with pytest.raises(BuildError, match=r"Unreadable picture: .*CAM_FRONT__000.jpg \(CAM_FRONT"):
        scenes.picture(scenes.keyframes[0], scenes.keyframes[0].camera("CAM_FRONT"))


def test_a_picture_is_refused_in_words_alone_none_and_one_larger_than_any_cameras(
    set_: Path, recwarn: pytest.WarningsRecorder
) -> None:
    path = first_picture(set_)
    path.write_bytes(b"<html>no")
    scenes = read_scenes(set_)
    read = (scenes.keyframes[0], scenes.keyframes[0].camera("CAM_FRONT"))
    with pytest.raises(BuildError, match=r"scene scene-0001\): no picture of a known form\.$"):
        scenes.picture(*read)
    for side_px, said in ((10_000, "10000 x 10000 pixels are too many"), (14_000, "exceeds limit")):
        path.write_bytes(png_that_says(side_px, side_px))
        with pytest.raises(BuildError, match=said):
            scenes.picture(*read)
    assert not recwarn.list


def test_a_picture_of_another_size_is_named(set_: Path) -> None:
    Image.new("RGB", (64, 36)).save(first_picture(set_))
    scenes = read_scenes(set_)
    with pytest.raises(
        BuildError, match=r"Picture of 64 x 36 pixels where the calibration is for 480 x 270"
    ):
        scenes.picture(scenes.keyframes[0], scenes.keyframes[0].camera("CAM_FRONT"))


def set_camera(name: str, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda line: line["cameras"][0].update({name: value})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda line: line["cameras"].pop(3), r"keyframe [0-9a-f]{32} has no CAM_BACK_LEFT"),
        (lambda line: line["cameras"][0].pop("intrinsic"), r"line 2: cameras.0.intrinsic"),
        (lambda line: line.update(speed=3), r"line 2: speed: Extra inputs"),
        (lambda line: line["cameras"][2].update(image="no.jpg"), r"Missing picture: .*no.jpg"),
        (lambda line: line.update(recorded=[[1.0]]), r"line 2: recorded.0"),
        (lambda line: line["cameras"].append(line["cameras"][0]), r"line 2: cameras: .* twice"),
        (lambda line: line["cameras"].clear(), r"line 2: cameras: Tuple should have at least 1"),
        (set_camera("intrinsic", [[0, 0, 0]] * 3), r"line 2: cameras.0.intrinsic: no camera"),
        (set_camera("camera_from_ego", [[0, 0, 0, 0]] * 3), r"camera_from_ego: .* no rotation"),
        (set_camera("camera_from_ego", [[1e300] * 4] * 3), r"line 2: .*camera_from_ego.0.0: "),
        (set_camera("intrinsic", [[1e300] * 3] * 3), r"line 2: cameras.0.intrinsic.0.0: "),
        (lambda line: line.update(ego_rotation=[0, 0, 0, 0]), r"line 2: ego_rotation: no unit"),
        (lambda line: line.update(ego_translation_m=[1e300, 0, 0]), r"line 2: ego_translation_m.0"),
    ],
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
    with pytest.raises(BuildError, match=words):
        read_scenes(set_ / "scenes.jsonl")


def test_lines_of_other_rigs_and_without_a_recorded_path_are_taken(set_: Path) -> None:
    scenes = read_scenes(set_)
    bare = [
        keyframe.model_copy(update={"cameras": keyframe.cameras[1:3], "recorded": None})
        for keyframe in scenes.keyframes
    ]
    write_scenes(SceneSet(set_, tuple(bare)), set_ / "scenes.jsonl")
    assert list(read_scenes(set_ / "scenes.jsonl").keyframes) == bare


def test_a_keyframe_given_twice_is_named(set_: Path) -> None:
    scenes = read_scenes(set_)
    write_scenes(SceneSet(set_, scenes.keyframes * 2), set_ / "scenes.jsonl")
    with pytest.raises(
        BuildError, match=f"line [0-9]+: {scenes.keyframes[0].keyframe_id} stands twice"
    ):
        read_scenes(set_ / "scenes.jsonl")


def test_no_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=r"No scenes at .*none.jsonl: No such file"):
        read_scenes(tmp_path / "none.jsonl")


def test_scenes_are_read_into_a_workshop_one_keyframe_of_each(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "shop"
    new_workshop(folder, "made-2027", "0" * 64)
    said = CliRunner().invoke(app, ["scenes", "read", str(made), "-w", str(folder)])
    assert said.output.splitlines() == [
        "3 keyframes of 3 scenes; with 21 tasks 63 combinations",
        "left out of these scenes: 9 further keyframes; --per-scene N takes N of each",
    ]
    given = read_scenes(made).spread(1)
    with Workshop(folder) as workshop:
        assert [*workshop.keyframes] == [keyframe.keyframe_id for keyframe in given.keyframes]
        for keyframe in given.keyframes:
            kept = workshop.keyframes[keyframe.keyframe_id]
            assert kept.recorded == keyframe.recorded
            for camera in keyframe.cameras:
                image = workshop.image(kept.camera(camera.view).image)
                assert image == given.path(camera).read_bytes()


def test_pictures_that_stand_in_several_keyframes_are_counted(set_: Path, tmp_path: Path) -> None:
    """One keyframe under two names is asked about twice, and counts twice."""
    first, *rest = read_scenes(set_).spread(1).keyframes
    copy = first.model_copy(update={"keyframe_id": "copy", "scene_id": "another"})
    folder = tmp_path / "shop"
    new_workshop(folder, "made-2027", "0" * 64)
    for keyframes, n_repeated in ((first, *rest), 0), ((first, *rest, copy), len(first.cameras)):
        write_scenes(SceneSet(set_, keyframes), set_ / "scenes.jsonl")
        command = ["scenes", "read", str(set_ / "scenes.jsonl"), "-w", str(folder)]
        said = CliRunner().invoke(app, command)
        assert said.exit_code == 0, said.output
        told = f"{n_repeated} of the pictures stand in several keyframes" in said.output
        assert told == (n_repeated > 0)


def test_signs_that_end_lines_elsewhere_are_words_of_a_description(
    set_: Path, tmp_path: Path
) -> None:
    words = "a\u2028b\u2029c\x85d\x0be\x0cf\x1cg\rh\ni"
    scenes = read_scenes(set_)
    told = scenes.keyframes[0].model_copy(update={"description": words})
    write_scenes(SceneSet(set_, (told, *scenes.keyframes[1:])), set_ / "scenes.jsonl")
    new_workshop(tmp_path / "shop", "made-2027", "0" * 64)
    with Workshop(tmp_path / "shop") as workshop:
        read_in(workshop, set_ / "scenes.jsonl", per_scene=99)
        assert len(workshop.keyframes) == len(scenes.keyframes)
        assert workshop.keyframes[told.keyframe_id].description == words


@pytest.mark.parametrize("form", ["WEBP", "GIF", "PPM"])
def test_a_picture_that_no_stage_can_show_is_refused(form: str, set_: Path) -> None:
    with Image.open(first_picture(set_)) as picture:
        picture.save(first_picture(set_), form)
    scenes = read_scenes(set_)
    with pytest.raises(BuildError, match=r"CAM_FRONT__000.jpg .*: neither JPEG nor PNG"):
        scenes.picture(scenes.keyframes[0], scenes.keyframes[0].camera("CAM_FRONT"))


def test_a_picture_is_kept_by_its_form_whatever_its_name(set_: Path, tmp_path: Path) -> None:
    scenes = read_scenes(set_)
    (set_ / "bare").write_bytes(first_picture(set_).read_bytes())
    write_scenes(scenes, set_ / "scenes.jsonl")
    lines = set_ / "scenes.jsonl"
    named = scenes.keyframes[0].camera("CAM_FRONT").image
    lines.write_text(lines.read_text().replace(named, "bare"))
    new_workshop(tmp_path / "shop", "made-2027", "0" * 64)
    with Workshop(tmp_path / "shop") as workshop:
        read_in(workshop, lines, per_scene=99)
        kept = workshop.keyframes[scenes.keyframes[0].keyframe_id].camera("CAM_FRONT").image
        assert kept.endswith(".jpg")
        assert workshop.image(kept) == first_picture(set_).read_bytes()


def test_reading_replaces_and_says_how_many_keyframes_are_gone(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "shop"
    new_workshop(folder, "made-2027", "0" * 64)
    command = ["scenes", "read", str(made), "-w", str(folder)]
    assert "gone" not in CliRunner().invoke(app, command).output
    said = CliRunner().invoke(app, [*command, "--per-scene", "2"])
    assert said.exit_code == 0
    assert "6 keyframes of 3 scenes" in said.output
    assert "gone, or with other pictures: 3 keyframes that stood here" in said.output
    all_of_them = CliRunner().invoke(app, [*command, "--per-scene", "4"])
    assert "gone" not in all_of_them.output
    assert "left out" not in all_of_them.output


@pytest.mark.parametrize("what", ["another set", "other pictures"])
def test_decided_keyframes_do_not_go_without_a_word(what: str, set_: Path, tmp_path: Path) -> None:
    shop = make_shop(tmp_path / "made", width_px=64)
    source = tmp_path / "made" / "set" if what == "other pictures" else set_
    if what == "other pictures":
        for path in (source / "samples" / "CAM_FRONT").iterdir():
            path.write_bytes(path.read_bytes() + b"\0")
    before = (shop / "scenes.jsonl").read_bytes()
    command = ["scenes", "read", str(source), "-w", str(shop)]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 2
    assert "1 keyframe of which something was decided would go" in said.output
    assert "and with them 21 accepted edits" in said.output
    assert "--replace" in said.output
    assert (shop / "scenes.jsonl").read_bytes() == before
    assert CliRunner().invoke(app, [*command, "--replace"]).exit_code == 0
    assert (shop / "scenes.jsonl").read_bytes() != before


Points = tuple[tuple[float, float], ...]
WRONG_PATHS: dict[str, Callable[[Points], Points]] = {
    "x and y exchanged": lambda path: tuple((y, x) for x, y in path),
    "backwards": lambda path: tuple((-x, -y) for x, y in path),
    "the last point first": lambda path: path[::-1],
}


@pytest.mark.parametrize("how", WRONG_PATHS)
def test_recorded_paths_that_no_car_makes_are_not_read_in(
    how: str, set_: Path, tmp_path: Path
) -> None:
    scenes = read_scenes(set_)
    wrong = tuple(
        keyframe.model_copy(update={"recorded": WRONG_PATHS[how](keyframe.recorded or ())})
        for keyframe in scenes.keyframes
    )
    write_scenes(SceneSet(set_, wrong), set_ / "scenes.jsonl")
    new_workshop(tmp_path / "shop", "made-2027", "0" * 64)
    command = ["scenes", "read", str(set_ / "scenes.jsonl"), "-w", str(tmp_path / "shop")]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 2
    assert "No car makes 3 of 3 recorded drives that move" in said.output
    assert "metres, x ahead and y left of the rear axle at t = 0, 0.5 s apart?" in said.output
    with Workshop(tmp_path / "shop") as workshop:
        assert workshop.keyframes == {}


@pytest.mark.parametrize("what", ["picture", "path", "far"])
def test_nothing_of_a_wrong_set_reaches_the_workshop(what: str, set_: Path, tmp_path: Path) -> None:
    new_workshop(tmp_path / "shop", "made-2027", "0" * 64)
    scenes = read_scenes(set_)
    if what == "picture":
        first_picture(set_).write_bytes(b"no picture")
    path = {"path": ((1.0, 0.0),), "far": ((1e300, 0.0),) * 6}.get(what, ())
    short = scenes.keyframes[0].model_copy(update={"recorded": path})
    keyframes = scenes.keyframes if what == "picture" else (short,)
    write_scenes(SceneSet(set_, keyframes), set_ / "scenes.jsonl")
    command = ["scenes", "read", str(set_ / "scenes.jsonl"), "-w", str(tmp_path / "shop")]
    said = CliRunner().invoke(app, [*command, "--per-scene", "99"])
    words = {
        "picture": "Unreadable picture",
        "path": "a recorded path of 1 points; the protocol asks for 6",
        "far": "a recorded path that leads over",
    }
    assert said.exit_code == 2
    assert words[what] in said.output
    with Workshop(tmp_path / "shop") as workshop:
        assert workshop.keyframes == {}


def test_the_made_up_set_comes_from_the_command(tmp_path: Path) -> None:
    command = ["scenes", "make", str(tmp_path / "set"), "--scenes", "1", "--width", "64"]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert len(read_scenes(tmp_path / "set").keyframes) == 2
