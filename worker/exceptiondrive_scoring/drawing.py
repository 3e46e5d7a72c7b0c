"""What a picture of one sample shows, taken from the code that scores it.

A drawing holds a hazard region. It may leave the worker for samples of a public split alone; that
is for the caller to know (`exceptiondrive_worker.drawing`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exceptiondrive_schemas.drawing import DrawnSample, EntryDrawings, Outline, SampleDrawing
from exceptiondrive_schemas.drawing.documents import Position
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.collision_tube import tube_pieces_m
from exceptiondrive_scoring.footprint import footprints_m
from exceptiondrive_scoring.grade import SampleScores, grade
from exceptiondrive_scoring.measure import Measurements
from exceptiondrive_scoring.nearest_points import clearance_segment_m

DECIMALS = 4
"""Of positions: a tenth of a millimetre, far below a pixel."""


@dataclass(frozen=True)
class Drawer:
    """Draws the samples of one planning entry on one split under one protocol.

    Attributes:
        sample_ids: N keys, in the canonical order of all arrays.
        pairs: What was submitted.
        measured: What geometry gave.
        split: Regions and tasks.
        protocol: Geometry, required clearances, names of tasks.
    """

    sample_ids: Sequence[str]
    pairs: TrajectoryPairs
    measured: Measurements
    split: SplitArrays
    protocol: Protocol

    @cached_property
    def scores(self) -> SampleScores:
        """Metric values of each sample."""
        return grade(self.measured, self.split, self.protocol)

    def from_worst_to_best(self) -> list[int]:
        """Samples by HCC, then clearance, then id, the least first; without an answer: left out."""
        hcc = self.scores.values[:, self.scores.metric_keys.index("hcc")]
        near, given = self.measured.clearance_m, np.flatnonzero(self.measured.edited_given)
        return sorted(given.tolist(), key=lambda i: (hcc[i], near[i], self.sample_ids[i]))

    def worst_and_middle(self) -> EntryDrawings:
        """Draw the worst sample of each family, and the one in the middle of the same order."""
        family_index, best_last = self.split.family_index, self.from_worst_to_best()
        drawn = []
        for family in range(len(self.protocol.families)):
            ordered = [i for i in best_last if family_index[i] == family]
            if ordered:
                drawn.append(DrawnSample(chosen_as="worst", drawing=self.drawing(ordered[0])))
            if len(ordered) > 2:
                middle = ordered[len(ordered) // 2]
                drawn.append(DrawnSample(chosen_as="middle", drawing=self.drawing(middle)))
        return EntryDrawings(samples=tuple(drawn))

    def drawing(self, index: int) -> SampleDrawing:
        """Draw the sample at this place."""
        geometry = self.protocol.geometry
        task = self.protocol.tasks[int(self.split.task_index[index])]
        edited, source = _path(self.pairs.edited[index]), _path(self.pairs.source[index])
        is_given = bool(self.measured.edited_given[index])
        return SampleDrawing(
            sample_id=self.sample_ids[index],
            family=task.family,
            task=task.id,
            hazard=task.hazard,
            region=_outline(self.split.regions_m[index]),
            source=_outline(source) if self.measured.source_given[index] else (),
            edited=_outline(edited) if is_given else (),
            footprints=_outlines(footprints_m(edited[None], geometry)[0]) if is_given else (),
            tube=_outlines(tube_pieces_m(edited, geometry)) if is_given else (),
            segment=self._segment(index, edited),
            clearance_m=float(self.measured.clearance_m[index]) if is_given else None,
            d_safe_m=float(self.split.d_safe_m[index]) * self.protocol.grading.d_safe_scale,
            metrics=self._metrics(index),
        )

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
    """Put the origin in front: (T, 2) -> (T + 1, 2)."""
    return np.concatenate([np.zeros((1, 2)), waypoints])


def _position(point: FloatArray) -> Position:
    x, y = (round(float(value), DECIMALS) + 0.0 for value in point)  # never minus zero
    return x, y


def _outline(points: Iterable[FloatArray]) -> Outline:
    return tuple(_position(point) for point in points)


def _outlines(pieces: Iterable[Iterable[FloatArray]]) -> tuple[Outline, ...]:
    return tuple(_outline(piece) for piece in pieces)
