"""The footprint: the oriented vehicle rectangle at one time step (PROTOCOL.md section 2)."""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.heading import heading_vectors

CORNER_AHEAD = np.array([1.0, -1.0, -1.0, 1.0])
CORNER_LEFT = np.array([1.0, 1.0, -1.0, -1.0])
"""Signs of the corners, counter-clockwise: front left, rear left, rear right, front right."""


@dataclass(frozen=True)
class Footprints:
    """Rectangles of one size: centres and heading unit vectors, arrays of any one shape."""

    x_m: FloatArray
    y_m: FloatArray
    cos: FloatArray
    sin: FloatArray
    half_length_m: float
    half_width_m: float

    def corners_m(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates x and y of the corners, each (4, *shape), counter-clockwise."""
        shape = (4,) + (1,) * self.x_m.ndim
        ahead = (self.half_length_m * CORNER_AHEAD).reshape(shape)
        left = (self.half_width_m * CORNER_LEFT).reshape(shape)
        x = self.x_m + ahead * self.cos - left * self.sin
        y = self.y_m + ahead * self.sin + left * self.cos
        return x, y


def footprints(x_m: FloatArray, y_m: FloatArray, geometry: GeometrySection) -> Footprints:
    """Footprints of reference points, time-major: (T + 1, N) positions in metres."""
    cos, sin = heading_vectors(x_m, y_m, geometry)
    ahead = geometry.footprint_centre_ahead_m
    return Footprints(
        x_m=x_m + ahead * cos,
        y_m=y_m + ahead * sin,
        cos=cos,
        sin=sin,
        half_length_m=geometry.footprint_length_m / 2,
        half_width_m=geometry.footprint_width_m / 2,
    )


def footprints_m(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Corners of the footprint at every time step, counter-clockwise from the front left.

    Args:
        points_m: (N, T + 1, 2) positions, the origin first.
        geometry: Size and place of the rectangle, heading rule.

    Returns:
        (N, T + 1, 4, 2).
    """
    x, y = footprints(points_m[..., 0].T, points_m[..., 1].T, geometry).corners_m()
    return np.stack([x, y], axis=-1).transpose(2, 1, 0, 3)
