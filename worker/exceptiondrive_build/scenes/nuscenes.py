"""Keyframes from the tables of nuScenes v1.0, read with pandas.

The meaning of the tables is taken from the page "nuScenes schema" of nutonomy/nuscenes-devkit:

- Rotations are quaternions (w, x, y, z), lengths metres, times microseconds. `calibrated_sensor`
  is in the ego vehicle's frame, `ego_pose` in the map's; the pictures are undistorted.
- Each `sample_data` has its own ego pose, because a camera's shutter opens when the lidar sweeps
  across it. A point of the keyframe goes from its ego frame to the map, from there to the ego frame
  at the shutter time, then to the camera (`map_pointcloud_to_image` of the devkit, and the thread
  about it there).
- The ego pose of a keyframe is that of `LIDAR_TOP`, whose time is the sample's, as for planners
  trained on nuScenes. The recorded path consists of the positions at the next six samples.
"""

import json
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import infer_dtype
from pydantic import ValidationError

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.scenes.keyframe import FARTHEST, MAX_ROTATION_ERROR, Camera, Keyframe
from exceptiondrive_build.scenes.scene_set import SceneSet
from exceptiondrive_schemas.base import faults_in
from exceptiondrive_scoring.aliases import FloatArray

CAMERAS = (
    "CAM_FRONT_LEFT",
    "CAM_FRONT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK_LEFT",
    "CAM_BACK",
    "CAM_BACK_RIGHT",
)
"""Cameras by position: in front, then behind, from the left."""
LIDAR = "LIDAR_TOP"
N_WAYPOINTS = 6
TIME_STEP_S = 0.5
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "scene": ("token", "name", "description", "log_token"),
    "sample": ("token", "timestamp", "scene_token"),
    "sample_data": (
        *("token", "sample_token", "ego_pose_token", "calibrated_sensor_token"),
        *("filename", "width", "height", "is_key_frame"),
    ),
    "calibrated_sensor": ("token", "sensor_token", "translation", "rotation", "camera_intrinsic"),
    "ego_pose": ("token", "translation", "rotation"),
    "sensor": ("token", "channel"),
    "log": ("token", "location"),
}
TEXTS = ("name", "description", "filename", "channel", "location")
LARGE = ("sample_data", "ego_pose")
"""Tables of millions of rows, of which few are needed: they are read one after the other."""
MAX_TIME_ERROR_S = 0.2
"""Tolerance of the 0.5 s between samples; a keyframe before a longer gap has no recorded path."""
Row = Mapping[Hashable, Any]
Table = Mapping[str, Row]


def read_nuscenes(folder: Path, version: str | None = None) -> SceneSet:
    """Read every keyframe that has a recorded path of 3 s.

    `version` names the folder of tables beside `samples/`; None takes the only one.

    Raises:
        BuildError: There are no tables, or of another version; a row, camera or picture is missing.
    """
    tables = folder / (version or _only_version(folder))
    frames = {name: _read_table(tables, name) for name in COLUMNS if name not in LARGE}
    data = _read_table(tables, "sample_data")
    data = data[data["is_key_frame"].astype(bool)]
    data = data.assign(channel=data["calibrated_sensor_token"].map(_channels(frames)))
    if data["channel"].isna().any():
        token = data.loc[data["channel"].isna(), "calibrated_sensor_token"].iloc[0]
        raise BuildError(f"{tables / 'calibrated_sensor.json'} has no row {token}")
    data = data[data["channel"].isin([*CAMERAS, LIDAR])]
    poses = _read_table(tables, "ego_pose")
    poses = poses[poses["token"].isin(data["ego_pose_token"])]
    reader = _Reader(
        tables,
        {
            "scene": _by_token(frames["scene"]),
            "calibrated_sensor": _by_token(frames["calibrated_sensor"]),
            "ego_pose": _by_token(poses),
            "log": _by_token(frames["log"]),
        },
    )
    readings: dict[str, dict[str, Row]] = defaultdict(dict)
    for row in data.to_dict("records"):
        readings[row["sample_token"]][row["channel"]] = row
    samples = frames["sample"].sort_values(["scene_token", "timestamp"])
    keyframes = [
        keyframe
        for scene_token, of_scene in samples.groupby("scene_token", sort=False)
        for keyframe in reader.keyframes(str(scene_token), of_scene.to_dict("records"), readings)
    ]
    return SceneSet(folder, tuple(sorted(keyframes, key=lambda k: (k.scene, k.timestamp_us))))


def _only_version(folder: Path) -> str:
    found = sorted(path.name for path in folder.glob("v*") if path.is_dir())
    fitting = [name for name in found if name.startswith("v1.0")]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise BuildError(f"{folder} holds tables {' and '.join(fitting)}: say which")
    if found:
        raise BuildError(f"{folder} holds tables {', '.join(found)}; v1.0 of nuScenes is read")
    raise BuildError(f"{folder} holds no tables: a folder such as v1.0-trainval is missing")


def _read_table(tables: Path, name: str) -> pd.DataFrame:
    path = tables / f"{name}.json"
    try:
        rows = json.loads(path.read_bytes())
        frame = pd.DataFrame.from_records(rows)
    except FileNotFoundError:
        raise BuildError(f"missing table: {path}") from None
    except OSError as error:
        raise BuildError(f"{path}: {error.strerror}.") from None
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
        raise BuildError(f"{path} is no table of nuScenes: {error}") from error
    lacking = [column for column in COLUMNS[name] if column not in frame]
    if lacking:
        raise BuildError(f"{path} is of another version than v1.0: it lacks {', '.join(lacking)}")
    frame = frame[list(COLUMNS[name])]
    for column in COLUMNS[name]:
        if column in TEXTS or column.endswith("token"):
            _refuse_other(frame, column, path, "string", "no text")
        elif column == "timestamp":
            _refuse_other(frame, column, path, "integer", "no whole number")
    twice = frame["token"][frame["token"].duplicated()]
    if len(twice):
        raise BuildError(f"{path}: row {twice.iloc[0]} stands there twice")
    return frame


def _refuse_other(frame: pd.DataFrame, column: str, path: Path, kind: str, words: str) -> None:
    """Refuse a table in which a value of a column has the wrong type."""
    if frame[column].isna().any() or infer_dtype(frame[column], skipna=False) != kind:
        is_kind = [infer_dtype([value], skipna=False) == kind for value in frame[column]]
        number = is_kind.index(False)
        raise BuildError(
            f"{path}, row {number + 1} ({frame['token'].iloc[number]}): {column} is {words}"
        )


def _by_token(frame: pd.DataFrame) -> Table:
    return {str(row["token"]): row for row in frame.to_dict("records")}


def _channels(frames: Mapping[str, pd.DataFrame]) -> "pd.Series[str]":
    """Return the channel of each calibrated sensor, by its token."""
    names = frames["sensor"].set_index("token")["channel"]
    sensors = frames["calibrated_sensor"].set_index("token")["sensor_token"]
    return sensors.map(names)


class _Reader:
    """Looks rows up, and reports which table lacks one."""

    def __init__(self, folder: Path, tables: Mapping[str, Table]) -> None:
        self.folder = folder
        self.tables = tables

    def row(self, table: str, token: str) -> Row:
        try:
            return self.tables[table][token]
        except KeyError:
            raise BuildError(f"{self.folder / table}.json has no row {token}") from None

    def keyframes(
        self,
        scene_token: str,
        samples: Sequence[Row],
        readings: Mapping[str, Mapping[str, Row]],
    ) -> list[Keyframe]:
        """Return the keyframes of one scene that have a complete recorded path."""
        scene = self.row("scene", scene_token)
        for sample in samples:
            for channel in (*CAMERAS, LIDAR):
                if channel not in readings[sample["token"]]:
                    raise BuildError(
                        f"sample {sample['token']} of scene {scene['name']} has no {channel}"
                    )
        times_s = np.array([sample["timestamp"] for sample in samples]) / 1e6
        lidar = [readings[sample["token"]][LIDAR] for sample in samples]
        poses = np.array([self.pose("ego_pose", row["ego_pose_token"]) for row in lidar])
        due_s = TIME_STEP_S * np.arange(1, N_WAYPOINTS + 1)
        made = []
        for index, sample in enumerate(samples[:-N_WAYPOINTS]):
            ahead = slice(index + 1, index + 1 + N_WAYPOINTS)
            if np.abs(times_s[ahead] - times_s[index] - due_s).max() > MAX_TIME_ERROR_S:
                continue
            path = poses[ahead, :, 3] @ np.linalg.inv(poses[index]).T
            made.append(self.keyframe(scene, sample, readings[sample["token"]], path[:, :2]))
        return made

    def keyframe(
        self,
        scene: Row,
        sample: Row,
        readings: Mapping[str, Row],
        path_m: FloatArray,
    ) -> Keyframe:
        pose_token = readings[LIDAR]["ego_pose_token"]
        pose, map_from_ego = self.row("ego_pose", pose_token), self.pose("ego_pose", pose_token)
        try:
            return Keyframe(
                keyframe_id=sample["token"],
                scene_id=sample["scene_token"],
                scene=scene["name"],
                description=scene["description"],
                location=self.row("log", scene["log_token"])["location"],
                timestamp_us=int(sample["timestamp"]),
                ego_translation_m=_float_tuple(pose["translation"]),
                ego_rotation=_float_tuple(pose["rotation"]),
                cameras=tuple(
                    self.camera(channel, readings[channel], map_from_ego) for channel in CAMERAS
                ),
                recorded=_float_rows(path_m),
            )
        except ValidationError as error:
            faults = "; ".join(faults_in(error))
            raise BuildError(f"sample {sample['token']} in {self.folder}: {faults}") from None

    def camera(self, channel: str, reading: Row, map_from_ego: FloatArray) -> Camera:
        """Return calibration relative to the ego frame of the keyframe, not of the shutter time."""
        sensor_token = reading["calibrated_sensor_token"]
        map_from_camera = self.pose("ego_pose", reading["ego_pose_token"]) @ self.pose(
            "calibrated_sensor", sensor_token
        )
        camera_from_ego = np.linalg.inv(map_from_camera) @ map_from_ego
        intrinsic = _numbers(
            self.row("calibrated_sensor", sensor_token)["camera_intrinsic"], (3, 3)
        )
        if intrinsic is None:
            raise BuildError(
                f"{self.folder / 'calibrated_sensor'}.json, row {sensor_token}: "
                f"the camera_intrinsic of {channel} is no 3 x 3 matrix"
            )
        size_px = _numbers([reading["width"], reading["height"]], (2,))
        where = f"{self.folder / 'sample_data'}.json, row {reading['token']}"
        if size_px is None:
            raise BuildError(f"{where}: width and height of {channel} are no numbers of pixels")
        try:
            return Camera(
                view=channel,
                image=reading["filename"],
                width_px=int(size_px[0]),
                height_px=int(size_px[1]),
                intrinsic=_float_rows(intrinsic),
                camera_from_ego=_float_rows(camera_from_ego[:3]),
            )
        except ValidationError as error:
            raise BuildError(f"{where}: {channel}: {'; '.join(faults_in(error))}") from None

    def pose(self, table: str, token: str) -> FloatArray:
        """Return the (4, 4) matrix from the frame of a row to the frame that it is given in."""
        row = self.row(table, token)
        quaternion = _numbers(row["rotation"], (4,))
        translation = _numbers(row["translation"], (3,))
        if (
            quaternion is None
            or translation is None
            or abs(np.linalg.norm(quaternion) - 1) >= MAX_ROTATION_ERROR
        ):
            raise BuildError(
                f"{self.folder / table}.json, row {token}: no translation of three metres and "
                "unit quaternion"
            )
        return rigid(quaternion, translation)


def rigid(rotation_wxyz: FloatArray, translation_m: FloatArray) -> FloatArray:
    """Return the (4, 4) matrix of a rotation, then a translation."""
    w, x, y, z = rotation_wxyz / np.linalg.norm(rotation_wxyz)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation_m
    return matrix


def _numbers(value: Any, shape: tuple[int, ...]) -> FloatArray | None:
    """Return finite numbers of this shape; None if the value is anything else."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return found if found.shape == shape and np.all(np.abs(found) <= FARTHEST) else None


def _float_tuple(values: Any) -> Any:
    return tuple(float(value) for value in values)


def _float_rows(matrix: Any) -> Any:
    return tuple(_float_tuple(row) for row in matrix)
