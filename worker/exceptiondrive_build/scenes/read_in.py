"""Imports scenes (nuScenes, or `scenes.jsonl`, one line a keyframe) into a workshop."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exceptiondrive_build.candidates import picture_digests, walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.scenes.keyframe import Keyframe, read_keyframes
from exceptiondrive_build.scenes.nuscenes import read_nuscenes
from exceptiondrive_build.scenes.scene_set import SceneSet
from exceptiondrive_build.workshop import SCENES, Workshop
from exceptiondrive_schemas.check.drives import drives_fault
from exceptiondrive_schemas.printable import counted


def read_in(
    workshop: Workshop,
    source: Path,
    *,
    per_scene: int = 1,
    version: str | None = None,
    replace: bool = False,
) -> tuple[tuple[Keyframe, ...], int, int]:
    """Read scenes into a workshop, replacing those in it.

    Decisions about a keyframe stay valid as long as its pictures are the same. No keyframe of the
    workshop changes unless every picture can be read. Keyframes with decisions are removed only
    with `replace`.

    Returns:
        The keyframes in the workshop now; how many more the source has; and how many former ones
        are gone or have other pictures now (0 with `replace`).

    Raises:
        BuildError: What is wrong with the scenes, and where; or keyframes with decisions would go.
    """
    given = read_scenes(source, version)
    scenes = given.spread(per_scene)
    if not scenes.keyframes:
        raise BuildError(f"{source}: no keyframe has a recorded path of 3 s.")
    kept = tuple(_keep_keyframe(workshop, scenes, keyframe) for keyframe in scenes.keyframes)
    fault = drives_fault([it.recorded for it in kept if it.recorded], workshop.protocol)
    if fault is not None:
        raise BuildError(f"{source}: {fault}", "Mend the recorded paths; nothing is read in.")
    n_gone = 0 if replace else _count_gone(workshop.folder, kept)
    part = workshop.folder / f"{SCENES}.part"
    write_scenes(SceneSet(workshop.folder, kept), part)
    part.replace(workshop.folder / SCENES)
    return kept, len(given.keyframes) - len(kept), n_gone


def _count_gone(folder: Path, kept: Sequence[Keyframe]) -> int:
    """Return how many keyframes of a workshop are removed.

    Raises:
        BuildError: One of them has decisions.
    """
    with Workshop(folder) as workshop:
        stays = {(keyframe.keyframe_id, _pictures(keyframe)) for keyframe in kept}
        gone = {
            keyframe_id
            for keyframe_id, keyframe in workshop.keyframes.items()
            if (keyframe_id, _pictures(keyframe)) not in stays
        }
        if not gone:
            return 0
        with_decisions = {record.candidate for record in workshop.records.read()}
        candidates = [it for it in walk(workshop).values() if it.keyframe.keyframe_id in gone]
    decided = {it.keyframe.keyframe_id for it in candidates if it.sample_id in with_decisions}
    if decided:
        raise BuildError(
            f"{counted(len(decided), 'keyframe')} of which something was decided would go or get other "
            f"pictures, and with them {counted(sum(it.is_accepted for it in candidates), 'accepted edit')}: "
            f"{', '.join(sorted(decided)[:10])}.",
            "Scenes that are read in replace those of the workshop. Name a source that holds these, "
            "too, and --per-scene as before; or say --replace: the decisions are kept, and count "
            "again once the same pictures are read in.",
        )
    return len(gone)


def _pictures(keyframe: Keyframe) -> tuple[str, ...]:
    return picture_digests(camera.image for camera in keyframe.cameras)


def _keep_keyframe(workshop: Workshop, scenes: SceneSet, keyframe: Keyframe) -> Keyframe:
    geometry, path_m = workshop.protocol.geometry, keyframe.recorded
    if path_m is not None and len(path_m) != geometry.waypoints:
        raise BuildError(
            f"Keyframe {keyframe.keyframe_id} has a recorded path of {len(path_m)} "
            f"points; the protocol asks for {geometry.waypoints}."
        )
    if path_m is not None and np.abs(path_m).max() > geometry.max_coordinate_m:
        raise BuildError(
            f"Keyframe {keyframe.keyframe_id} has a recorded path that leads over "
            f"{geometry.max_coordinate_m:g} m away.",
            "Its points are metres of the ego frame of the keyframe.",
        )
    cameras = tuple(
        camera.model_copy(update={"image": workshop.keep_image(*scenes.picture(keyframe, camera))})
        for camera in keyframe.cameras
    )
    return keyframe.model_copy(update={"cameras": cameras})


def read_scenes(source: Path, version: str | None = None) -> SceneSet:
    """Read keyframes from a folder in nuScenes form, or from lines of JSON, each a `Keyframe`.

    Raises:
        BuildError: What is wrong, and where.
    """
    scenes = read_nuscenes(source, version) if source.is_dir() else _read_lines(source)
    for keyframe in scenes.keyframes:
        for camera in keyframe.cameras:
            if not scenes.path(camera).is_file():
                raise BuildError(f"Missing picture: {scenes.place(keyframe, camera)}.")
    return scenes


def _read_lines(source: Path) -> SceneSet:
    try:
        keyframes = read_keyframes(source, source.read_bytes())
    except OSError as error:
        raise BuildError(f"No scenes at {source}: {error.strerror}.") from None
    views = {camera.view for keyframe in keyframes.values() for camera in keyframe.cameras}
    for keyframe_id, keyframe in keyframes.items():
        lacking = sorted(views - {camera.view for camera in keyframe.cameras})
        if lacking:
            raise BuildError(
                f"{source}: keyframe {keyframe_id} has no {', '.join(lacking)}.",
                "Every keyframe has the same views.",
            )
    return SceneSet(source.parent, tuple(keyframes.values()))


def write_scenes(scenes: SceneSet, path: Path) -> None:
    """Write `scenes.jsonl` into the folder of the pictures, which it names by relative path."""
    text = "".join(f"{keyframe.model_dump_json()}\n" for keyframe in scenes.keyframes)
    path.write_text(text, encoding="utf-8")
