"""A keyframe: six pictures, how each camera sees the ground, and the path that was driven.

The ego frame is that of every trajectory (docs/protocol.md section 1): x forward, y left, metres,
the origin on the ground below the centre of the rear axle, at the time of the keyframe.
"""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated

import numpy as np
from PIL import Image
from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.submission_files import Waypoint
from exceptiondrive_scoring.aliases import FloatArray

CAMERAS = (
    "CAM_FRONT_LEFT",
    "CAM_FRONT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK_LEFT",
    "CAM_BACK",
    "CAM_BACK_RIGHT",
)
"""The six cameras of nuScenes, as they stand around the car: in front, then behind, from the left."""
N_WAYPOINTS = 6
TIME_STEP_S = 0.5

Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


class ScenesError(ValueError):
    """Scenes that cannot be read; the message says what is wrong, and where."""


class Camera(Document):
    """One picture of a keyframe, undistorted, with its calibration.

    Attributes:
        channel: Name of the camera.
        picture: File of the picture, relative to the folder of the scenes.
        width: Of the picture, in pixels.
        height: Of the picture, in pixels.
        intrinsic: Camera matrix; pixel (0, 0) is the centre of the first one.
        camera_from_ego: Takes (x, y, z, 1) of the keyframe's ego frame to the camera's frame at its
            shutter time, x right, y down, z ahead: what the car drives in between is in it.
    """

    channel: str
    picture: Annotated[str, Field(min_length=1)]
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    intrinsic: tuple[Row3, Row3, Row3]
    camera_from_ego: tuple[Row4, Row4, Row4]

    @property
    def projection(self) -> FloatArray:
        """(3, 4): (x, y, z, 1) of the ego frame -> (u depth, v depth, depth)."""
        projection: FloatArray = np.array(self.intrinsic) @ np.array(self.camera_from_ego)
        return projection

    def project(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels of points, as `view_points` of the nuScenes devkit has them.

        Args:
            points_m: (n, 2) on the ground, or (n, 3), in the ego frame.

        Returns:
            (n, 2) pixels, and (n,) depths in metres; where a depth is not above 0, the point lies
            behind the camera and its pixel means nothing.
        """
        n_points, n_axes = points_m.shape
        ground = np.zeros((n_points, 3 - n_axes))
        homogeneous = np.hstack([points_m, ground, np.ones((n_points, 1))])
        seen = homogeneous @ self.projection.T
        depth = seen[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            return seen[:, :2] / depth[:, None], depth


class EgoPose(Document):
    """Where the ego frame lies in the map: metres, and a unit quaternion (w, x, y, z)."""

    translation: Row3
    rotation: Row4


class Keyframe(Document):
    """What one candidate is made of: a moment of a scene.

    Attributes:
        keyframe_id: Key of the moment; of nuScenes, the token of its sample.
        scene_id: Key of the scene.
        scene: Its name, for people.
        description: The scene in words.
        location: Where it was recorded.
        timestamp_us: Unix time.
        ego_pose: Of the keyframe.
        cameras: In the order of `CAMERAS`.
        recorded: The path that was driven, at 0.5 s ... 3 s.
    """

    keyframe_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene: str
    description: str = ""
    location: str = ""
    timestamp_us: int
    ego_pose: EgoPose
    cameras: Annotated[tuple[Camera, ...], Field(min_length=6, max_length=6)]
    recorded: Annotated[tuple[Waypoint, ...], Field(min_length=N_WAYPOINTS, max_length=N_WAYPOINTS)]

    def camera(self, channel: str) -> Camera:
        """Return one camera.

        Raises:
            KeyError: It has no such camera.
        """
        for camera in self.cameras:
            if camera.channel == channel:
                return camera
        raise KeyError(channel)


@dataclass(frozen=True)
class Scenes:
    """Keyframes in the order of scene and time, and the folder that their pictures stand in."""

    folder: Path
    keyframes: tuple[Keyframe, ...]

    def spread(self, per_scene: int) -> "Scenes":
        """Return as many keyframes of each scene, spread evenly; of one, that in the middle."""
        of_scene: dict[str, list[Keyframe]] = defaultdict(list)
        for keyframe in self.keyframes:
            of_scene[keyframe.scene_id].append(keyframe)
        return Scenes(
            self.folder,
            tuple(one for keyframes in of_scene.values() for one in _spread(keyframes, per_scene)),
        )

    def path(self, camera: Camera) -> Path:
        """Return where the picture of a camera stands."""
        return self.folder / camera.picture

    def place(self, keyframe: Keyframe, camera: Camera) -> str:
        """Return file, camera, keyframe and scene in words."""
        return (
            f"{self.path(camera)} ({camera.channel} of keyframe {keyframe.keyframe_id}, "
            f"scene {keyframe.scene})"
        )

    def picture(self, keyframe: Keyframe, channel: str) -> bytes:
        """Return the file of a source view, once it is sure that it can be shown.

        Raises:
            ScenesError: It is missing, no picture, or of another size than the calibration's.
        """
        camera = keyframe.camera(channel)
        where = self.place(keyframe, camera)
        try:
            data = self.path(camera).read_bytes()
            with Image.open(BytesIO(data)) as picture:
                picture.load()
                size = picture.size
        except FileNotFoundError:
            raise ScenesError(f"missing picture: {where}") from None
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ScenesError(f"unreadable picture: {where}: {error}") from error
        if size != (camera.width, camera.height):
            raise ScenesError(
                f"picture of {size[0]} x {size[1]} pixels where the tables say "
                f"{camera.width} x {camera.height}: {where}"
            )
        return data


def _spread(keyframes: list[Keyframe], count: int) -> Iterable[Keyframe]:
    if count >= len(keyframes):
        return keyframes
    return [keyframes[(2 * place + 1) * len(keyframes) // (2 * count)] for place in range(count)]
