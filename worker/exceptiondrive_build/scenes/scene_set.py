"""A set of keyframes and the folder of their pictures."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.measure import UnreadablePictureError, read_picture
from exceptiondrive_build.scenes.keyframe import Camera, Keyframe
from exceptiondrive_endpoints.images import ImageDataError, clean_image


@dataclass(frozen=True)
class SceneSet:
    """Keyframes ordered by scene and time, with pictures relative to a folder."""

    folder: Path
    keyframes: tuple[Keyframe, ...]

    def spread(self, per_scene: int) -> "SceneSet":
        """Return `per_scene` keyframes of each scene, spread evenly; a single one is the middle."""
        of_scene: dict[str, list[Keyframe]] = defaultdict(list)
        for keyframe in self.keyframes:
            of_scene[keyframe.scene_id].append(keyframe)
        chosen: list[Keyframe] = []
        for keyframes in of_scene.values():
            count = min(per_scene, len(keyframes))
            places = [(2 * i + 1) * len(keyframes) // (2 * count) for i in range(count)]
            chosen += [keyframes[place] for place in places]
        return SceneSet(self.folder, tuple(chosen))

    def path(self, camera: Camera) -> Path:
        """Return the path of a camera's picture."""
        return self.folder / camera.image

    def place(self, keyframe: Keyframe, camera: Camera) -> str:
        """Name file, camera, keyframe and scene in words."""
        return (
            f"{self.path(camera)} ({camera.view} of keyframe {keyframe.keyframe_id}, "
            f"scene {keyframe.scene or keyframe.scene_id})"
        )

    def picture(self, keyframe: Keyframe, camera: Camera) -> tuple[bytes, str]:
        """Return the bytes and the extension of a source view, after checking that it can be shown.

        Raises:
            BuildError: It is missing, neither JPEG nor PNG, or of another size than calibrated.
        """
        where = self.place(keyframe, camera)
        try:
            data = self.path(camera).read_bytes()
            size = read_picture(data).size
            extension = clean_image(data).extension
        except FileNotFoundError:
            raise BuildError(f"Missing picture: {where}.") from None
        except ImageDataError as error:
            advice = "Models and people are shown JPEG and PNG."
            raise BuildError(f"Picture of another form: {where}: {error}.", advice) from None
        except (OSError, UnreadablePictureError) as error:
            raise BuildError(f"Unreadable picture: {where}: {error}.") from None
        if size != (camera.width_px, camera.height_px):
            raise BuildError(
                f"Picture of {size[0]} x {size[1]} pixels where the calibration is for "
                f"{camera.width_px} x {camera.height_px}: {where}."
            )
        return data, extension
