"""One keyframe: its camera views with calibration, and the path that was really driven."""

from typing import Annotated

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.submission_files import Waypoint

Row = tuple[float, float, float]


class Camera(Document):
    """One view. The calibration is from camera to ego frame, as in nuScenes.

    Attributes:
        view: Its name, such as `CAM_FRONT`.
        image: Name of the picture in the workshop's `images` folder: `<sha256>.<ext>`.
        width_px: Width of the picture.
        height_px: Height of the picture.
        intrinsic: 3 x 3 matrix, pixels.
        rotation: Unit quaternion (w, x, y, z) that turns camera into ego axes.
        translation_m: Place of the camera in the ego frame.
    """

    view: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    image: str
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    intrinsic: tuple[Row, Row, Row]
    rotation: tuple[float, float, float, float]
    translation_m: Row


class Keyframe(Document):
    """One moment of a scene.

    Attributes:
        keyframe_id: Its id in the data set, such as a nuScenes sample token.
        scene_id: The scene that it is of.
        description: Words about the scene, for the screening model.
        cameras: Views in the order in which a model sees them.
        ego_translation_m: Place of the ego frame in the data set's global frame.
        ego_rotation: Unit quaternion (w, x, y, z) that turns ego into global axes.
        recorded: The path driven from here, T waypoints in the ego frame, where it is known.
    """

    keyframe_id: Annotated[str, Field(min_length=1, max_length=128)]
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    description: str = ""
    cameras: Annotated[tuple[Camera, ...], Field(min_length=1)]
    ego_translation_m: Row = (0.0, 0.0, 0.0)
    ego_rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
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
