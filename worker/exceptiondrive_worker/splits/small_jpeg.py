"""Pictures for readers: small JPEGs re-encoded from the pixels."""

import io

from PIL import Image, ImageOps

PICTURES = "pictures"
"""Name of the folder of pictures beside a split."""
FORMATS = ("JPEG", "PNG", "WEBP")
LONGEST_SIDE_PX = 1280
MAX_PIXELS = 40_000_000
MAX_FILE_BYTES = 32 * 2**20


class PictureUnreadableError(ValueError):
    """The data are no picture of a supported type."""


def small_jpeg(data: bytes, longest_side_px: int) -> tuple[bytes, int, int]:
    """Scale a JPEG, PNG or WebP picture down, turn it upright and strip its metadata.

    Returns:
        A JPEG, its width and its height in pixels.

    Raises:
        PictureUnreadableError: It is not such a picture, or too large.
    """
    if len(data) > MAX_FILE_BYTES:
        raise PictureUnreadableError(f"the picture is larger than {MAX_FILE_BYTES} bytes")
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise PictureUnreadableError(f"the picture has more than {MAX_PIXELS} pixels")
            small = ImageOps.exif_transpose(picture).convert("RGB")
    except PictureUnreadableError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise PictureUnreadableError("it is no JPEG, PNG or WebP picture") from None
    small.thumbnail((longest_side_px, longest_side_px))
    small.info.clear()  # comments would be written to the file
    kept = io.BytesIO()
    small.save(kept, "JPEG", quality=85)
    return kept.getvalue(), small.width, small.height
