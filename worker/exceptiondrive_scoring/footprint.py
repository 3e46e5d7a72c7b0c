"""The footprint: the oriented vehicle rectangle at one time step (docs/protocol.md section 2)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.kinematics import Positions, Steps, heading_vectors, positions, steps

CORNER_AHEAD = np.array([1.0, -1.0, -1.0, 1.0])
CORNER_LEFT = np.array([1.0, 1.0, -1.0, -1.0])
"""Signs of the corners, counter-clockwise: front left, rear left, rear right, front right."""


class Extent(NamedTuple):
    """An upright box in the frame of a footprint, metres: `x` ahead of its centre, `y` left."""

    low_x: FloatArray | float
    high_x: FloatArray | float
    low_y: FloatArray | float
    high_y: FloatArray | float


@dataclass(frozen=True)
class Footprints:
    """Rectangles of one size: centres and heading unit vectors, arrays that share a shape."""

    x_m: FloatArray
    y_m: FloatArray
    cos: FloatArray
    sin: FloatArray
    half_length_m: float
    half_width_m: float

    def __getitem__(self, key: "slice | IntArray") -> "Footprints":
        """Footprints of some time steps; of arrays (n,), any of them."""
        return self._with_poses(self.x_m[key], self.y_m[key], self.cos[key], self.sin[key])

    def of_samples(self, sample: IntArray) -> "Footprints":
        """All time steps of some samples: (T + 1, N) -> (T + 1, n)."""
        parts = (self.x_m, self.y_m, self.cos, self.sin)
        return self._with_poses(*(part.take(sample, 1) for part in parts))

    def at(self, step: IntArray, sample: IntArray) -> "Footprints":
        """One time step each of some samples: (T + 1, N) -> (n,)."""
        flat = step * self.x_m.shape[1] + sample
        return self._with_poses(*(p.take(flat) for p in (self.x_m, self.y_m, self.cos, self.sin)))

    def _with_poses(
        self, x: FloatArray, y: FloatArray, cos: FloatArray, sin: FloatArray
    ) -> "Footprints":
        return Footprints(x, y, cos, sin, self.half_length_m, self.half_width_m)

    def corners_m(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates x and y of the corners, each (4, *shape), counter-clockwise."""
        shape = (4,) + (1,) * self.x_m.ndim
        ahead = (self.half_length_m * CORNER_AHEAD).reshape(shape)
        left = (self.half_width_m * CORNER_LEFT).reshape(shape)
        x = self.x_m + ahead * self.cos - left * self.sin
        y = self.y_m + ahead * self.sin + left * self.cos
        return x, y

    def local(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points ahead and left of the centre: (4, n) points -> two (*steps, 4, n) arrays."""
        cos, sin = self.cos[..., None, :], self.sin[..., None, :]
        ahead, left = x_m * cos, y_m * cos
        ahead += y_m * sin
        left -= x_m * sin
        ahead -= (self.x_m * self.cos + self.y_m * self.sin)[..., None, :]
        left -= (self.y_m * self.cos - self.x_m * self.sin)[..., None, :]
        return ahead, left

    def square_outside(self, ahead: FloatArray, left: FloatArray) -> FloatArray:
        """Square distance of points, in the frame of the centre, from the rectangle; 0 inside."""
        beyond_x, beyond_y = np.abs(ahead), np.abs(left)
        for beyond, half_m in ((beyond_x, self.half_length_m), (beyond_y, self.half_width_m)):
            beyond -= half_m
            np.maximum(beyond, 0.0, out=beyond)
            beyond *= beyond
        beyond_x += beyond_y
        return beyond_x

    def extent_of(self, other: "Footprints") -> Extent:
        """Extent of another footprint along the axes of this one, from its centre."""
        length, width = self.half_length_m, self.half_width_m
        to_x, to_y = other.x_m - self.x_m, other.y_m - self.y_m
        ahead, left = to_x * self.cos + to_y * self.sin, to_y * self.cos - to_x * self.sin
        turn_cos = np.abs(self.cos * other.cos + self.sin * other.sin)
        turn_sin = np.abs(self.cos * other.sin - self.sin * other.cos)
        reach_x = length * turn_cos + width * turn_sin
        reach_y = length * turn_sin + width * turn_cos
        return Extent(ahead - reach_x, ahead + reach_x, left - reach_y, left + reach_y)

    def extent_with(self, other: Extent) -> Extent:
        """Extent of the hull of this footprint and a shape with that extent along its axes."""
        length, width = self.half_length_m, self.half_width_m
        return Extent(
            np.minimum(other.low_x, -length),
            np.maximum(other.high_x, length),
            np.minimum(other.low_y, -width),
            np.maximum(other.high_y, width),
        )

    def own_extent(self) -> Extent:
        """Extent of the rectangle itself."""
        length, width = self.half_length_m, self.half_width_m
        return Extent(-length, length, -width, width)


def footprints(at: Positions, moves: Steps, geometry: GeometrySection) -> Footprints:
    """Footprints at every time step, arrays of shape (T + 1, N)."""
    cos, sin = heading_vectors(moves, geometry)
    ahead = geometry.footprint_centre_ahead_m
    return Footprints(
        x_m=at.x_m + ahead * cos,
        y_m=at.y_m + ahead * sin,
        cos=cos,
        sin=sin,
        half_length_m=geometry.footprint_length_m / 2,
        half_width_m=geometry.footprint_width_m / 2,
    )


def footprints_m(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Return the corners of the footprint at every time step, counter-clockwise from front left.

    Positions are (N, T + 1, 2), the origin first; corners are (N, T + 1, 4, 2).
    """
    at = positions(points_m)
    x, y = footprints(at, steps(at), geometry).corners_m()
    return np.stack([x, y], axis=-1).transpose(2, 1, 0, 3)
