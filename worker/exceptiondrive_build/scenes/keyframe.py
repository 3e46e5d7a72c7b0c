"""One keyframe: its camera views with calibration, and the path that was actually driven.

The ego frame is that of every trajectory (docs/protocol.md section 1): x forward, y left, metres,
the origin on the ground below the centre of the rear axle, at the time of the keyframe.
"""

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationError

from exceptiondrive_build.errors import BuildError
from exceptiondrive_schemas.base import Document, faults_in
from exceptiondrive_schemas.submission_files import Waypoint

FARTHEST = 1e9
"""Bound in pixels or metres: beyond any picture and any map."""
MAX_ROTATION_ERROR = 1e-3
Number = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Row = tuple[Number, Number, Number]
Row4 = tuple[Number, Number, Number, Number]


def _intrinsic(rows: tuple[Row, Row, Row]) -> tuple[Row, Row, Row]:
    if rows[0][0] <= 0 or rows[1][1] <= 0 or rows[1][0] != 0 or rows[2] != (0, 0, 1):
        raise ValueError("no camera matrix: rows [fx, s, cx], [0, fy, cy], [0, 0, 1] in pixels")
    return rows


def _rigid(rows: tuple[Row4, Row4, Row4]) -> tuple[Row4, Row4, Row4]:
    rotation = np.array(rows)[:, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > MAX_ROTATION_ERROR or np.linalg.det(rotation) < 0:
        raise ValueError("its first three columns are no rotation")
    return rows


def _unit(quaternion: Row4) -> Row4:
    if abs(np.linalg.norm(quaternion) - 1) > MAX_ROTATION_ERROR:
        raise ValueError("no unit quaternion")
    return quaternion


def _each_view_once(cameras: "tuple[Camera, ...]") -> "tuple[Camera, ...]":
    view, count = Counter(camera.view for camera in cameras).most_common(1)[0]
    if count > 1:
        raise ValueError(f"{view} stands there twice")
    return cameras


class Camera(Document):
    """One view, undistorted, and its calibration.

    Attributes:
        view: Its name, such as `CAM_FRONT`.
        image: Name of the picture in the workshop's `images` folder: `<sha256>.<ext>`; in a set to
            be imported, its path relative to the folder of the set.
        width_px: Width of the picture.
        height_px: Height of the picture.
        intrinsic: 3 x 3 matrix, pixels; (0, 0) is the centre of the first one.
        camera_from_ego: 3 x 4 matrix, metres. Maps (x, y, z, 1) of the keyframe's ego frame to the
            frame of the camera at its shutter time: x right, y down, z ahead. It includes the car's
            motion between the two.
    """

    view: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    image: Annotated[str, Field(min_length=1)]
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    intrinsic: Annotated[tuple[Row, Row, Row], AfterValidator(_intrinsic)]
    camera_from_ego: Annotated[tuple[Row4, Row4, Row4], AfterValidator(_rigid)]


class Keyframe(Document):
    """One moment of a scene.

    Attributes:
        keyframe_id: Its id in the data set, such as a nuScenes sample token.
        scene_id: The scene that it belongs to.
        scene: Name of the scene, for people.
        location: Where it was recorded.
        timestamp_us: Unix time, microseconds.
        description: Text about the scene, for the screening model.
        cameras: Views in the order in which a model sees them.
        ego_translation_m: Place of the ego frame in the data set's global frame.
        ego_rotation: Unit quaternion (w, x, y, z) that turns ego into global axes.
        recorded: The path driven from here, T waypoints in the ego frame, if known.
    """

    keyframe_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene: str = ""
    location: str = ""
    timestamp_us: int = 0
    description: str = ""
    cameras: Annotated[tuple[Camera, ...], Field(min_length=1), AfterValidator(_each_view_once)]
    ego_translation_m: Row = (0.0, 0.0, 0.0)
    ego_rotation: Annotated[Row4, AfterValidator(_unit)] = (1.0, 0.0, 0.0, 0.0)
    recorded: tuple[Waypoint, ...] | None = None

    def camera(self, view: str) -> Camera:
        """Return a view by name.

        Raises:
            KeyError: The keyframe has no such view.
        """
        for camera in self.cameras:
            if camera.view == view:
                return camera
        raise KeyError(view)


def read_keyframes(path: Path, lines: bytes, advice: str = "") -> dict[str, Keyframe]:
    """Return the keyframes of JSON lines by id, in order; `advice` says how to repair a bad file.

    Raises:
        BuildError: A line is no keyframe, or an id occurs twice.
    """
    found: dict[str, Keyframe] = {}
    for number, line in enumerate(lines.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            keyframe = Keyframe.model_validate_json(line)
        except ValidationError as error:
            faults = "; ".join(faults_in(error))
            raise BuildError(f"{path}, line {number}: {faults}.", advice) from None
        if keyframe.keyframe_id in found:
            raise BuildError(f"{path}, line {number}: {keyframe.keyframe_id} stands twice.", advice)
        found[keyframe.keyframe_id] = keyframe
    return found
