"""Scenes from whatever an organizer has: nuScenes, or `scenes.jsonl`, one line a keyframe."""

from collections import Counter
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.scenes.keyframe import Keyframe
from exceptiondrive_build.scenes.nuscenes import read_nuscenes
from exceptiondrive_build.scenes.scene_set import SceneSet
from exceptiondrive_schemas.base import faults_in


def read_scenes(source: Path, version: str | None = None) -> SceneSet:
    """Read keyframes.

    Args:
        source: A folder in nuScenes form, or a file of lines, each the JSON of a `Keyframe`.
        version: Which tables, where a nuScenes folder has several.

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
        lines = source.read_bytes().splitlines()
    except OSError as error:
        raise BuildError(f"No scenes at {source}: {error.strerror}.") from None
    keyframes = {
        number: _keyframe(line, f"{source}, line {number}")
        for number, line in enumerate(lines, start=1)
        if line.strip()
    }
    scenes = SceneSet(source.parent, tuple(keyframes.values()))
    views = {camera.view for keyframe in scenes.keyframes for camera in keyframe.cameras}
    for number, keyframe in keyframes.items():
        lacking = sorted(views - {camera.view for camera in keyframe.cameras})
        if lacking:
            raise BuildError(
                f"{source}, line {number}: keyframe {keyframe.keyframe_id} has no "
                f"{', '.join(lacking)}.",
                "Every keyframe has the same views.",
            )
    times_given = Counter(keyframe.keyframe_id for keyframe in scenes.keyframes)
    repeated = sorted(one for one, count in times_given.items() if count > 1)
    if repeated:
        raise BuildError(f"{source}: keyframes given twice: {', '.join(repeated)}.")
    return scenes


def _keyframe(line: bytes, where: str) -> Keyframe:
    try:
        return Keyframe.model_validate_json(line)
    except ValidationError as error:
        raise BuildError(f"{where}: {'; '.join(faults_in(error))}.") from None


def write_scenes(scenes: SceneSet, path: Path) -> None:
    """Write `scenes.jsonl` into the folder of the pictures, whose names are relative to it."""
    text = "".join(f"{keyframe.model_dump_json()}\n" for keyframe in scenes.keyframes)
    path.write_text(text, encoding="utf-8")
