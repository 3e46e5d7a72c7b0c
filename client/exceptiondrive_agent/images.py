"""Find, load and clean the images of a sample: IMAGES/<sample_id>/*.jpg|png, or a JSON of paths.

Of a JPEG or PNG only what is needed to draw it is kept: no Exif, text, thumbnail or trailer.
Lossless: the coded pixels are copied byte for byte (ITU T.81 B.1; PNG specification 5 and 11).
An Exif orientation is lost with the rest, so images must be stored upright.
"""

import base64
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_agent.errors import AgentError, NoAnswerError, Reason

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_KEPT = frozenset(
    {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"sBIT"}
)
_JPEG_START, _JPEG_END, _JPEG_SCAN = 0xD8, 0xD9, 0xDA
_JPEG_KEPT = frozenset({*range(0xC0, 0xD0), 0xDA, 0xDB, 0xDC, 0xDD} - {0xC8})
_END_OF_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
MAX_IMAGE_BYTES = 20 * 1024 * 1024
_SUFFIXES = frozenset({".jpg", ".jpeg", ".png"})
ImagePaths = Mapping[str, tuple[Path, ...]]


class ImageDataError(ValueError):
    """These bytes are not a whole JPEG or PNG image."""


@dataclass(frozen=True)
class CleanImage:
    """An image without metadata."""

    media_type: str
    data: bytes

    @property
    def data_url(self) -> str:
        """The image as a `data:` address."""
        return f"data:{self.media_type};base64,{base64.b64encode(self.data).decode('ascii')}"


def clean_image(data: bytes) -> CleanImage:
    """Return the image in `data` without its metadata.

    Raises:
        ImageDataError: Not a whole JPEG or PNG image.
    """
    if data.startswith(_PNG_SIGNATURE):
        return CleanImage("image/png", _clean_png(data))
    if data.startswith(b"\xff\xd8\xff"):
        return CleanImage("image/jpeg", _clean_jpeg(data))
    raise ImageDataError("neither JPEG nor PNG")


def _clean_png(data: bytes) -> bytes:
    kept = [_PNG_SIGNATURE]
    position = len(_PNG_SIGNATURE)
    while position + 12 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        end = position + 12 + length
        name = data[position + 4 : position + 8]
        if end > len(data):
            break
        checksum = int.from_bytes(data[end - 4 : end], "big")
        if zlib.crc32(data[position + 4 : end - 4]) != checksum:
            raise ImageDataError("damaged PNG: a checksum does not match")
        if name in _PNG_KEPT:
            kept.append(data[position:end])
        if name == b"IEND":
            return b"".join(kept)
        position = end
    raise ImageDataError("truncated PNG")


def _clean_jpeg(data: bytes) -> bytes:
    kept = [data[:2]]
    position = 2
    while position + 2 <= len(data):
        marker = data[position + 1]
        if data[position] != 0xFF or marker in (0x00, _JPEG_START):
            raise ImageDataError("damaged JPEG: no marker where one must stand")
        if marker == 0xFF:
            position += 1
            continue
        if marker == _JPEG_END:
            return b"".join((*kept, data[position : position + 2]))
        end = position + 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if end < position + 4 or end > len(data):
            break
        if marker == _JPEG_SCAN:
            end = _end_of_scan(data, end)
        if _is_kept(marker, data[position + 4 : end]):
            kept.append(data[position:end])
        position = end
    raise ImageDataError("truncated JPEG")


def _end_of_scan(data: bytes, start: int) -> int:
    found = _END_OF_SCAN.search(data, start)
    if found is None:
        raise ImageDataError("truncated JPEG")
    return found.start()


def _is_kept(marker: int, payload: bytes) -> bool:
    if marker == 0xE0:  # JFIF says how to read the colours; longer than this holds a thumbnail
        return payload.startswith(b"JFIF\x00") and len(payload) == 14
    if marker == 0xEE:
        return payload.startswith(b"Adobe") and len(payload) == 12
    return marker in _JPEG_KEPT


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
        sample.name: tuple(
            sorted(path for path in sample.iterdir() if path.suffix.lower() in _SUFFIXES)
        )
        for sample in sorted(folder.iterdir())
        if sample.is_dir() and not sample.name.startswith(".")
    }


def _images_of_json(file: Path) -> dict[str, tuple[Path, ...]]:
    wanted = f"{file}: expected JSON of the form {{sample_id: [path, ...]}}"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
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


def load_images(paths: tuple[Path, ...]) -> tuple[CleanImage, ...]:
    """Read the images of one sample and strip their metadata.

    Raises:
        NoAnswerError: No image, or one that is missing, too large, damaged, no JPEG and no PNG.
    """
    if not paths:
        raise NoAnswerError(Reason.NO_IMAGES, "the sample has no images")
    return tuple(_load(path) for path in paths)


def _load(path: Path) -> CleanImage:
    try:
        if path.stat().st_size > MAX_IMAGE_BYTES:
            raise ImageDataError(f"larger than {MAX_IMAGE_BYTES} bytes")
        return clean_image(path.read_bytes())
    except OSError as error:
        detail = error.strerror or type(error).__name__
        raise NoAnswerError(Reason.UNREADABLE_IMAGE, f"{path.name}: {detail}") from None
    except ImageDataError as error:
        raise NoAnswerError(Reason.UNREADABLE_IMAGE, f"{path.name}: {error}") from None
