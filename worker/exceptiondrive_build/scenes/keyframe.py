"""One keyframe: its camera views with calibration, and the path that was really driven.

The ego frame is that of every trajectory (docs/protocol.md section 1): x forward, y left, metres,
the origin on the ground below the centre of the rear axle, at the time of the keyframe.
"""

from typing import Annotated

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.submission_files import Waypoint

Row = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


class Camera(Document):
    """One view, undistorted, and its calibration.

    Attributes:
        view: Its name, such as `CAM_FRONT`.
        image: Name of the picture in the workshop's `images` folder: `<sha256>.<ext>`; in a set that
            is to be read in, its path from the folder of the set.
        width_px: Width of the picture.
        height_px: Height of the picture.
        intrinsic: 3 x 3 matrix, pixels; (0, 0) is the centre of the first one.
        camera_from_ego: 3 x 4 matrix, metres. Takes (x, y, z, 1) of the keyframe's ego frame to the
            frame of the camera at its shutter time: x right, y down, z ahead. What the car drives
            between the two is in it.
    """

    view: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    image: Annotated[str, Field(min_length=1)]
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    intrinsic: tuple[Row, Row, Row]
    camera_from_ego: tuple[Row4, Row4, Row4]


class Keyframe(Document):
    """One moment of a scene.

    Attributes:
        keyframe_id: Its id in the data set, such as a nuScenes sample token.
        scene_id: The scene that it is of.
        scene: Name of the scene, for people.
        location: Where it was recorded.
        timestamp_us: Unix time, microseconds.
        description: Words about the scene, for the screening model.
        cameras: Views in the order in which a model sees them.
        ego_translation_m: Place of the ego frame in the data set's global frame.
        ego_rotation: Unit quaternion (w, x, y, z) that turns ego into global axes.
        recorded: The path driven from here, T waypoints in the ego frame, where it is known.
    """

    keyframe_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene: str = ""
    location: str = ""
    timestamp_us: int = 0
    description: str = ""
    cameras: Annotated[tuple[Camera, ...], Field(min_length=1)]
    ego_translation_m: Row = (0.0, 0.0, 0.0)
    ego_rotation: Row4 = (1.0, 0.0, 0.0, 0.0)
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
