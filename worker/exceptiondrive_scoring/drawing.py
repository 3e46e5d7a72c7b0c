"""What a picture of one sample shows, taken from the code that scores it.

A drawing holds a hazard region. It may leave the worker for samples of a public split alone, which
the caller must ensure (`exceptiondrive_worker.drawing`). Scoring never builds the polygons of a
tube (see `clearance`). The example of a protocol is a swerve past a hazard in the lane, whose
region is moved aside until the tube passes it at a share of the required clearance, so that HCC,
HPR and the clearance can all be seen; it is measured and graded like every other sample.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from exceptiondrive_schemas.drawing import (
    DrawnSample,
    EntryDrawings,
    Outline,
    Position,
    ProtocolDrawing,
    SampleDrawing,
    pictured_digest,
    pictured_task,
)
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.split import SplitSample
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs, split_arrays
from exceptiondrive_scoring.clearance import clearance_m, clearance_so_far_m
from exceptiondrive_scoring.footprint import footprints_m
from exceptiondrive_scoring.grade import SampleScores, grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.region import prepare_regions

DECIMALS = 4
"""Decimals of positions: a tenth of a millimetre, far below a pixel."""


@dataclass(frozen=True)
class Drawer:
    """Draws the samples of one planning entry on one split under one protocol.

    All arrays are in the order of the N sample ids.
    """

    sample_ids: Sequence[str]
    pairs: TrajectoryPairs
    measured: Measurements
    split: SplitArrays
    protocol: ProtocolDocument

    @cached_property
    def scores(self) -> SampleScores:
        """Metric values of each sample."""
        return grade(self.measured, self.split, self.protocol)

    def from_worst_to_best(self) -> list[int]:
        """Return answered samples by HCC, then clearance, then id, ascending."""
        hcc = self.scores.values[:, self.scores.metric_keys.index("hcc")]
        near, given = self.measured.clearance_m, np.flatnonzero(self.measured.edited_given)
        return sorted(given.tolist(), key=lambda i: (hcc[i], near[i], self.sample_ids[i]))

    def chosen(self) -> EntryDrawings:
        """Draw the scene of each family, and the entry's worst and median sample in it.

        The scene is the same for every entry: its region has the median distance from the vehicle
        at t = 0 among those of its family; ties go by sample id.
        """
        family_index, best_last = self.split.family_index, self.from_worst_to_best()
        by_distance = self._from_near_to_far()
        drawn = []
        for family in range(len(self.protocol.families)):
            far = [i for i in by_distance if family_index[i] == family]
            ordered = [i for i in best_last if family_index[i] == family]
            if far:
                scene = far[len(far) // 2]
                drawn.append(DrawnSample(chosen_as="scene", drawing=self.drawing(scene)))
            if ordered:
                drawn.append(DrawnSample(chosen_as="worst", drawing=self.drawing(ordered[0])))
            if len(ordered) > 2:
                middle = ordered[len(ordered) // 2]
                drawn.append(DrawnSample(chosen_as="middle", drawing=self.drawing(middle)))
        return EntryDrawings(samples=tuple(drawn))

    def _from_near_to_far(self) -> list[int]:
        """Samples by the distance of their region from the footprint at t = 0, then by id."""
        at_start = np.zeros((self.split.n_samples, 1, 2))
        away = clearance_m(at_start, self.split.prepared_regions, self.protocol.geometry)
        return sorted(range(self.split.n_samples), key=lambda i: (away[i], self.sample_ids[i]))

    def drawing(self, index: int) -> SampleDrawing:
        """Draw the sample at this place."""
        geometry = self.protocol.geometry
        task = self.protocol.tasks[int(self.split.task_index[index])]
        edited, source = _path(self.pairs.edited[index]), _path(self.pairs.source[index])
        is_given = bool(self.measured.edited_given[index])
        has_source = bool(self.measured.source_given[index])
        return SampleDrawing(
            sample_id=self.sample_ids[index],
            family=task.family,
            task=task.id,
            hazard=task.hazard,
            region=_outline(self.split.regions_m[index]),
            source=_outline(source) if has_source else (),
            edited=_outline(edited) if is_given else (),
            source_footprints=_boxes(source, geometry) if has_source else (),
            footprints=_boxes(edited, geometry) if is_given else (),
            tube=_outlines(tube_pieces_m(edited, geometry)) if is_given else (),
            segment=self._segment(index, edited),
            clearance_m=float(self.measured.clearance_m[index]) if is_given else None,
            clearances_m=self._clearances_m(index, edited) if is_given else (),
            d_safe_m=float(self.split.d_safe_m[index]) * self.protocol.grading.d_safe_scale,
            metrics=self._metrics(index),
        )

    def _clearances_m(self, index: int, edited: FloatArray) -> tuple[float, ...]:
        """Return the remaining clearance at each time step; 0 from contact on."""
        region = prepare_regions(self.split.regions_m[index : index + 1])
        so_far = clearance_so_far_m(edited[None], region, self.protocol.geometry)[0]
        is_contact = so_far <= self.protocol.geometry.contact_tolerance_m
        return tuple(np.where(is_contact, 0.0, so_far).tolist())

    def _segment(self, index: int, edited: FloatArray) -> tuple[Position, Position] | None:
        if self.measured.intrusion[index]:
            return None
        found = clearance_segment_m(edited, self.split.regions_m[index], self.protocol.geometry)
        return _position(found.on_tube_m), _position(found.on_region_m)

    def _metrics(self, index: int) -> dict[str, float | None]:
        row = self.scores.values[index].tolist()
        pairs = zip(self.scores.metric_keys, row, strict=True)
        return {key: None if value != value else value for key, value in pairs}  # noqa: PLR0124


def _path(waypoints: FloatArray) -> FloatArray:
    """Prepend the origin: (T, 2) -> (T + 1, 2)."""
    return np.concatenate([np.zeros((1, 2)), waypoints])


def _position(point: FloatArray) -> Position:
    x, y = (round(float(value), DECIMALS) + 0.0 for value in point)  # never minus zero
    return x, y


def _outline(points: Iterable[FloatArray]) -> Outline:
    return tuple(_position(point) for point in points)


def _outlines(pieces: Iterable[Iterable[FloatArray]]) -> tuple[Outline, ...]:
    return tuple(_outline(piece) for piece in pieces)


def _boxes(points_m: FloatArray, geometry: GeometrySection) -> tuple[Outline, ...]:
    return _outlines(footprints_m(points_m[None], geometry)[0])


Corner = tuple[float, float]


def tube_pieces_m(points_m: FloatArray, geometry: GeometrySection) -> list[FloatArray]:
    """Convex pieces whose union is the collision tube of (T + 1, 2) positions, the origin first.

    Returns:
        T hulls of consecutive footprints (or the T + 1 footprints), each (k, 2) corners in metres,
        counter-clockwise.
    """
    boxes = footprints_m(points_m[None], geometry)[0]
    if geometry.collision_tube == "footprints":
        return list(boxes)
    return [convex_hull(np.concatenate(pair)) for pair in pairwise(boxes)]


def convex_hull(points: FloatArray) -> FloatArray:
    """Corners of the convex hull, counter-clockwise: (n, 2) -> (k, 2) (monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    lower, upper = _hull_chain(ordered), _hull_chain(ordered[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _hull_chain(points: list[Corner]) -> list[Corner]:
    """Return the part of the hull that turns left from the first point to the last."""
    chain: list[Corner] = []
    for point in points:
        while len(chain) >= 2 and _turn_of(chain[-2], chain[-1], point) <= 1e-12:
            chain.pop()
        chain.append(point)
    return chain


def _turn_of(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


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

    The tube is that of (T + 1, 2) positions, the origin first; the region has (4, 2) corners, in
    either orientation. Disjoint polygons are nearest at a corner of one and an edge of the other.
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
    """Return the corner and the point on the outline that are nearest to each other."""
    along = np.roll(outline_m, -1, axis=0) - outline_m
    from_start = corners_m[:, None] - outline_m
    square = np.maximum((along**2).sum(axis=-1), np.finfo(np.float64).tiny)
    share = np.clip((from_start * along).sum(axis=-1) / square, 0.0, 1.0)
    feet = outline_m + share[..., None] * along
    gaps = np.hypot(*np.moveaxis(corners_m[:, None] - feet, -1, 0))
    corner, edge = np.unravel_index(gaps.argmin(), gaps.shape)
    return corners_m[corner], feet[corner, edge]


SAMPLE_ID = "made-up"
REACH_M = 16.2
SWERVE_M = 3.3
SHARE_OF_REQUIRED = 0.6
REGION_M = ((10.6, 0.75), (13.9, 1.15), (14.3, -0.85), (10.9, -1.2))
FURTHEST_ASIDE_M = 30.0
N_HALVINGS = 40


def protocol_drawing(protocol: ProtocolDocument) -> ProtocolDrawing:
    """Draw the example sample of a protocol."""
    task, geometry = pictured_task(protocol), protocol.geometry
    edited, source = _waypoints(geometry)
    required_m = task.d_safe_m * protocol.grading.d_safe_scale
    region = _pushed_aside(edited, SHARE_OF_REQUIRED * required_m, geometry)
    sample = SplitSample(sample_id=SAMPLE_ID, scene_id=SAMPLE_ID, task=task.id, region=region)
    split = split_arrays([sample], protocol.taxonomy)
    columns = {"source": source[None], "edited": edited[None]}
    pairs = TrajectoryPairs.from_columns(columns)
    measured = measure(pairs, split.prepared_regions, geometry)
    drawing = Drawer([SAMPLE_ID], pairs, measured, split, protocol).drawing(0)
    return ProtocolDrawing(pictured=pictured_digest(protocol), sample=drawing)


def _waypoints(geometry: GeometrySection) -> tuple[FloatArray, FloatArray]:
    """A swerve into the next lane, and straight on; each (T, 2)."""
    share = np.arange(1, geometry.waypoints + 1) / geometry.waypoints
    x_m = REACH_M * share
    rise = np.clip((share - 0.08) / 0.6, 0.0, 1.0)
    swerve = np.column_stack([x_m * 0.985, SWERVE_M * rise * rise * (3 - 2 * rise)])
    return swerve, np.column_stack([x_m, np.zeros_like(x_m)])


def _pushed_aside(
    edited: FloatArray, wanted_m: float, geometry: GeometrySection
) -> tuple[tuple[float, float], ...]:
    """Move the region to the right until the clearance is `wanted_m`."""
    shape, path = np.array(REGION_M), _path(edited)[None]
    low, high = -FURTHEST_ASIDE_M, SWERVE_M
    for _ in range(N_HALVINGS):
        middle = (low + high) / 2
        moved = prepare_regions((shape + np.array([0.0, middle]))[None])
        is_close = clearance_m(path, moved, geometry)[0] < wanted_m
        low, high = (low, middle) if is_close else (middle, high)
    return tuple((float(x), float(y)) for x, y in shape + np.array([0.0, low]))
