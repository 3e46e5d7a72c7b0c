"""How much an edit changed a view, inside the target area and outside it.

Change is 1 - structural similarity (Wang et al. 2004), as in scikit-image: per colour channel, with
a window of 7 pixels, mean over channels and pixels of the area. Large pictures are halved.
"""

import warnings
from io import BytesIO

import numpy as np
import shapely
from PIL import Image, ImageDraw, UnidentifiedImageError
from skimage.metrics import structural_similarity

from exceptiondrive_build.scenes.cameras import project
from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_build.values import Change
from exceptiondrive_schemas.submission_files import Waypoint
from exceptiondrive_scoring.aliases import BoolArray

AREA_MARGIN = 0.25
"""Margin around the hazard's space, as a share of its size, for shadows and contact."""
MAX_WIDTH_PX = 1000
_STEPS = 5


class UnreadablePictureError(ValueError):
    """The data are no complete picture."""


def read_picture(data: bytes) -> Image.Image:
    """Decode a picture completely.

    Raises:
        UnreadablePictureError: It is none, damaged, or larger than any camera's.
    """
    try:
        with warnings.catch_warnings():  # the size is checked below
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(BytesIO(data))
        if image.width * image.height > 50_000_000:
            raise UnreadablePictureError(f"{image.width} x {image.height} pixels are too many")
        image.load()
    except UnidentifiedImageError:
        raise UnreadablePictureError("no picture of a known form") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise UnreadablePictureError(str(error)) from None
    return image


def target_area(
    camera: Camera, target_m: Waypoint, size_m: tuple[float, float, float]
) -> BoolArray | None:
    """Return the area of a hazard's space in a view.

    Args:
        camera: The view.
        target_m: Centre of its base, ahead and left of the rear axle.
        size_m: Length, width and height.

    Returns:
        (height, width) mask, or None if none of it is in the picture.
    """
    length_m, width_m, height_m = (size * (1 + AREA_MARGIN) for size in size_m)
    steps = np.linspace(-0.5, 0.5, _STEPS)
    x, y, z = np.meshgrid(
        target_m[0] + steps * length_m,
        target_m[1] + steps * width_m,
        np.linspace(0, height_m, _STEPS),
    )
    pixels = project(camera, np.column_stack([x.ravel(), y.ravel(), z.ravel()]))
    pixels = pixels[~np.isnan(pixels).any(axis=1)]
    hull = shapely.MultiPoint(pixels).convex_hull
    if not isinstance(hull, shapely.Polygon):
        return None
    mask = Image.new("1", (camera.width_px, camera.height_px))
    ImageDraw.Draw(mask).polygon([(u, v) for u, v in hull.exterior.coords], fill=1)
    found: BoolArray = np.array(mask, dtype=bool)
    return found if found.any() else None


def change(source: Image.Image, edited: Image.Image, area: BoolArray | None) -> Change:
    """Measure how much an edit changed a view.

    Args:
        source: The original view.
        edited: The same view, of the same size.
        area: (height, width) mask of the target area, or None if it is not in view.
    """
    step = -(-source.width // MAX_WIDTH_PX)
    before, after = (np.asarray(image.convert("RGB").reduce(step)) for image in (source, edited))
    _, similar = structural_similarity(before, after, channel_axis=2, data_range=255, full=True)  # type: ignore[no-untyped-call]
    changed = 1 - similar.mean(axis=2)
    if area is None:
        return Change(inside=None, outside=_mean(changed))
    height, width = changed.shape
    mask = np.asarray(Image.fromarray(area).resize((width, height), Image.Resampling.NEAREST))
    inside = _mean(changed[mask]) if mask.any() else None
    outside = _mean(changed[~mask]) if not mask.all() else 0.0
    return Change(inside=inside, outside=outside)


def _mean(values: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> float:
    return round(min(max(float(values.mean()), 0.0), 2.0), 6)
