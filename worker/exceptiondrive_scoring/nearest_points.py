"""Where the clearance of one trajectory is taken, for drawing. Scoring knows only its length."""

from typing import NamedTuple

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.collision_tube import tube_pieces_m


class ClearanceSegment(NamedTuple):
    """The shortest segment from the collision tube to the hazard region; ends (2,), metres."""

    on_tube_m: FloatArray
    on_region_m: FloatArray

    @property
    def length_m(self) -> float:
        """Its length: the clearance, where the two do not meet."""
        return float(np.hypot(*(self.on_region_m - self.on_tube_m)))


def clearance_segment_m(
    points_m: FloatArray, region_m: FloatArray, geometry: GeometrySection
) -> ClearanceSegment:
    """Nearest points of one collision tube and one hazard region that do not meet.

    Two polygons that do not meet are nearest at a corner of one and an edge of the other.

    Args:
        points_m: (T + 1, 2) positions, the origin first.
        region_m: (4, 2) corners, in either rotation.
        geometry: Footprint, heading rule, kind of tube.
    """
    segments = (_nearest_m(piece, region_m) for piece in tube_pieces_m(points_m, geometry))
    return min(segments, key=lambda segment: segment.length_m)


def _nearest_m(piece_m: FloatArray, region_m: FloatArray) -> ClearanceSegment:
    corner, foot = _corner_to_edge_m(piece_m, region_m)
    other_corner, other_foot = _corner_to_edge_m(region_m, piece_m)
    pair = ClearanceSegment(corner, foot), ClearanceSegment(other_foot, other_corner)
    return min(pair, key=lambda segment: segment.length_m)


def _corner_to_edge_m(
    corners_m: FloatArray, outline_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Corner, and point on the edges of the outline, that are nearest to each other."""
    along = np.roll(outline_m, -1, axis=0) - outline_m
    from_start = corners_m[:, None] - outline_m
    square = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
    share = np.clip((from_start * along).sum(axis=-1) / square, 0.0, 1.0)
    feet = outline_m + share[..., None] * along
    gaps = np.hypot(*np.moveaxis(corners_m[:, None] - feet, -1, 0))
    corner, edge = np.unravel_index(gaps.argmin(), gaps.shape)
    return corners_m[corner], feet[corner, edge]
