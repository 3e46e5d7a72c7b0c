"""Reads scenes into a workshop: its `scenes.jsonl`, and the pictures under their digests."""

from pathlib import Path

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.scenes.keyframe import Keyframe
from exceptiondrive_build.scenes.scene_set import SceneSet
from exceptiondrive_build.scenes.source import read_scenes, write_scenes
from exceptiondrive_build.workshop import SCENES, Workshop


def read_in(
    workshop: Workshop, source: Path, *, per_scene: int = 1, version: str | None = None
) -> tuple[Keyframe, ...]:
    """Read scenes into a workshop and return its keyframes.

    What was decided of a keyframe stands as long as its pictures are the same. Nothing of the
    workshop changes unless every picture can be read.

    Args:
        workshop: Whose scenes these become.
        source: A nuScenes folder, or a file of keyframes, one a line.
        per_scene: How many keyframes of each scene, spread evenly.
        version: Which tables, where a nuScenes folder has several.

    Raises:
        BuildError: What is wrong with the scenes, and where.
    """
    scenes = read_scenes(source, version).spread(per_scene)
    if not scenes.keyframes:
        raise BuildError(f"{source}: no keyframe has a recorded path of 3 s.")
    kept = tuple(_kept(workshop, scenes, keyframe) for keyframe in scenes.keyframes)
    part = workshop.folder / f"{SCENES}.part"
    write_scenes(SceneSet(workshop.folder, kept), part)
    part.replace(workshop.folder / SCENES)
    return kept


def _kept(workshop: Workshop, scenes: SceneSet, keyframe: Keyframe) -> Keyframe:
    n_waypoints = workshop.protocol.geometry.waypoints
    if keyframe.recorded is not None and len(keyframe.recorded) != n_waypoints:
        raise BuildError(
            f"Keyframe {keyframe.keyframe_id} has a recorded path of {len(keyframe.recorded)} "
            f"points; the protocol asks for {n_waypoints}."
        )
    cameras = tuple(
        camera.model_copy(
            update={"image": workshop.keep_image(*scenes.picture(keyframe, camera))}
        )
        for camera in keyframe.cameras
    )
    return keyframe.model_copy(update={"cameras": cameras})
