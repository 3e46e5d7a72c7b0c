"""Load and clean images before they leave this machine.

Of a JPEG or PNG only what is needed to draw it is kept: no Exif, text, thumbnail or trailer.
Lossless: the coded pixels are copied byte for byte (ITU T.81 B.1; PNG specification 5 and 11).
An Exif orientation is lost with the rest, so images must be stored upright.
"""

import base64
import re
import zlib
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_endpoints.errors import NoAnswerError, Reason

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_KEPT = frozenset(
    {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"sBIT"}
)
_JPEG_START, _JPEG_END, _JPEG_SCAN = 0xD8, 0xD9, 0xDA
_JPEG_KEPT = frozenset({*range(0xC0, 0xD0), 0xDA, 0xDB, 0xDC, 0xDD} - {0xC8})
_END_OF_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
MAX_IMAGE_BYTES = 20 * 1024 * 1024


class ImageDataError(ValueError):
    """These bytes are not a whole JPEG or PNG image."""


@dataclass(frozen=True)
class CleanImage:
    """An image without metadata."""

    media_type: str
    data: bytes

    @property
    def extension(self) -> str:
        """The ending of a file that holds it."""
        return "png" if self.media_type == "image/png" else "jpg"

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
            found = _END_OF_SCAN.search(data, end)
            if found is None:
                break
            end = found.start()
        if _is_kept(marker, data[position + 4 : end]):
            kept.append(data[position:end])
        position = end
    raise ImageDataError("truncated JPEG")


def _is_kept(marker: int, payload: bytes) -> bool:
    if marker == 0xE0:  # JFIF says how to read the colours; longer than this holds a thumbnail
        return payload.startswith(b"JFIF\x00") and len(payload) == 14
    if marker == 0xEE:
        return payload.startswith(b"Adobe") and len(payload) == 12
    return marker in _JPEG_KEPT


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
