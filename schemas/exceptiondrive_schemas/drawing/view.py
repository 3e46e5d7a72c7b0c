"""From metres to the pixels of one drawing: x forward points right, y left points up."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.drawing.documents import Outline, Position, SampleDrawing

MARGIN_M = 2.0
MIN_SPAN_M = 14.0
MAX_REACH_M = 60.0
"""How far from the vehicle a region is followed; beyond, the panel shows where it begins."""
GRID_STEPS_M = (1, 2, 5, 10, 20, 50)
MIN_GRID_PX = 46


@dataclass(frozen=True)
class View:
    """One scale for both axes, so that shapes keep their angles."""

    scale: float
    left_m: float
    top_m: float
    width: float
    height: float

    @classmethod
    def of(cls, sample: SampleDrawing, width: float, height: float) -> "View":
        """Return the view that holds everything that moves, and the region near it."""
        points = [(0.0, 0.0), *sample.source, *sample.edited, *_corners(sample.footprints)]
        points += [point for point in sample.region if math.hypot(*point) <= MAX_REACH_M]
        points += [] if sample.segment is None else [sample.segment[1]]
        low_x, high_x = _span(point[0] for point in points)
        low_y, high_y = _span(point[1] for point in points)
        scale = min(width / max(high_x - low_x, MIN_SPAN_M), height / (high_y - low_y))
        middle_x, middle_y = (low_x + high_x) / 2, (low_y + high_y) / 2
        return cls(
            scale, middle_x - width / scale / 2, middle_y + height / scale / 2, width, height
        )

    def at(self, point: Position) -> Position:
        """Return the pixel of a position."""
        return (point[0] - self.left_m) * self.scale, (self.top_m - point[1]) * self.scale

    def points(self, outline: Outline) -> str:
        """Return positions as SVG writes them."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, outline))

    def grid_m(self) -> tuple[Sequence[int], Sequence[int]]:
        """Return the lines of the grid along x and y, in metres."""
        wide_enough = (step for step in GRID_STEPS_M if step * self.scale >= MIN_GRID_PX)
        step = next(wide_enough, GRID_STEPS_M[-1])
        along = _multiples(step, self.left_m, self.left_m + self.width / self.scale)
        across = _multiples(step, self.top_m - self.height / self.scale, self.top_m)
        return along, across


def _multiples(step: int, low: float, high: float) -> range:
    return range(math.ceil(low / step) * step, math.floor(high / step) * step + 1, step)


def _corners(outlines: Iterable[Outline]) -> list[Position]:
    return [corner for outline in outlines for corner in outline]


def _span(values: Iterable[float]) -> tuple[float, float]:
    known = list(values)
    return min(known) - MARGIN_M, max(known) + MARGIN_M
