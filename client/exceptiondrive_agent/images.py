"""Find the images of every sample: IMAGES/<sample_id>/*.jpg|png, or a JSON of paths."""

import json
from collections.abc import Mapping
from pathlib import Path

from exceptiondrive_agent.errors import AgentError

_SUFFIXES = frozenset({".jpg", ".jpeg", ".png"})
ImagePaths = Mapping[str, tuple[Path, ...]]


def find_images(source: Path) -> ImagePaths:
    """Return the image paths of every sample, in the order in which they are sent.

    Args:
        source: A folder with one folder per sample, named by the sample id (images in order of
            file name), or a JSON file `{sample_id: [path, ...]}` with paths relative to itself.

    Raises:
        AgentError: There is no such folder or file, it holds no sample, or it is not that JSON.
    """
    if source.is_dir():
        found = _images_of_folder(source)
    elif source.is_file():
        found = _images_of_json(source)
    else:
        raise AgentError(f"{source}: no such folder or file")
    if not found:
        raise AgentError(f"{source}: no sample in it; expected {source}/<sample_id>/*.jpg or *.png")
    return found


def _images_of_folder(folder: Path) -> dict[str, tuple[Path, ...]]:
    return {
        sample.name: tuple(path for path in _shown(sample) if path.suffix.lower() in _SUFFIXES)
        for sample in _shown(folder)
        if sample.is_dir()
    }


def _shown(folder: Path) -> list[Path]:
    """What a folder holds, by name, but the files that systems hide there, such as `._1.jpg`."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _images_of_json(file: Path) -> dict[str, tuple[Path, ...]]:
    wanted = f"{file}: expected JSON of the form {{sample_id: [path, ...]}}"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise AgentError(f"{wanted}: {error}") from None
    if not isinstance(document, dict):
        raise AgentError(wanted)
    for sample_id, paths in document.items():
        if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
            raise AgentError(f"{wanted}; sample {sample_id!r} has no list of paths")
    return {
        sample_id: tuple(file.parent / path for path in paths)
        for sample_id, paths in document.items()
    }
