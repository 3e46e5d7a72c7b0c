"""The drawing of one sample: footprints, collision tube, hazard region, clearance.

Every number in it comes from the protocol document: change the document and the drawing changes.
"""

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

from exceptiondrive_schemas.protocol import GeometrySection, Protocol
from exceptiondrive_schemas.taxonomy import Strategy, Task
from exceptiondrive_server.pages.scales import px
from exceptiondrive_server.pages.scene_geometry import (
    Outline,
    Position,
    convex_hull,
    footprint,
    headings_rad,
    nearest_positions,
)

WIDTH, HEIGHT = 600, 330
MARGIN_TOP = 48
LANE_M = 3.5
LOW_X_M, HIGH_X_M = -2.2, 20.6
SPEED_MPS = 5.4
SWERVE_M = 3.3
CAR_INSET_M = 0.15


@dataclass(frozen=True)
class SceneDrawing:
    """SVG coordinates of the drawing, and the values that it shows."""

    width: int
    height: int
    road_top: str
    road_bottom: str
    lane_y: str
    tube: tuple[str, ...]
    footprints: tuple[str, ...]
    edited: str
    source: str
    waypoints: tuple[tuple[str, str], ...]
    region: str
    halo_width: str
    region_label: tuple[str, str]
    clearance: tuple[str, str, str, str]
    clearance_label: tuple[str, str]
    car: str
    cabin: tuple[str, ...]
    axis_origin: tuple[str, str]
    length_line: tuple[str, str, str, str]
    width_line: tuple[str, str, str, str]
    halo_label: tuple[str, str]
    source_label: tuple[str, str]
    length_m: float
    width_m: float
    clearance_m: float
    d_safe_m: float
    shift_m: float
    hcc: float
    hpr: float
    task: Task


@dataclass(frozen=True)
class _View:
    """From metres to SVG coordinates: x to the right, y (left) upwards."""

    scale: float
    middle_y: float

    def at(self, position: Position) -> tuple[str, str]:
        return (
            px((position[0] - LOW_X_M) * self.scale),
            px(self.middle_y - position[1] * self.scale),
        )

    def outline(self, outline: Outline) -> str:
        return " ".join(",".join(self.at(position)) for position in outline)


def scene_drawing(protocol: Protocol) -> SceneDrawing:
    """Draw one edited scene under a protocol."""
    task = _pictured_task(protocol)
    return _drawing(protocol.geometry, task, task.d_safe_m * protocol.grading.d_safe_scale)


@lru_cache(maxsize=16)
def _drawing(geometry: GeometrySection, task: Task, d_safe_m: float) -> SceneDrawing:
    edited, source = _trajectories(geometry)
    boxes = _footprints(edited, geometry)
    tube = _tube(boxes, geometry)
    region = _region(tube, d_safe_m)
    near = _nearest(tube, region)
    clearance_m = math.dist(*near)
    view = _View(WIDTH / (HIGH_X_M - LOW_X_M), MARGIN_TOP + (1.5 * LANE_M) * _px_per_m())
    middle = ((near[0][0] + near[1][0]) / 2, (near[0][1] + near[1][1]) / 2)
    return SceneDrawing(
        width=WIDTH,
        height=HEIGHT,
        road_top=view.at((0, LANE_M * 1.5))[1],
        road_bottom=view.at((0, -LANE_M * 0.5 - 1.6))[1],
        lane_y=view.at((0, LANE_M * 0.5))[1],
        tube=tuple(view.outline(part) for part in tube),
        footprints=tuple(view.outline(box) for box in boxes),
        edited=_path(view, edited),
        source=_path(view, source),
        waypoints=tuple(view.at(position) for position in edited[1:]),
        region=view.outline(region),
        halo_width=px(2 * d_safe_m * view.scale),
        region_label=view.at(_centre(region)),
        clearance=(*view.at(near[0]), *view.at(near[1])),
        clearance_label=view.at(middle),
        car=view.outline(_car_part(geometry, (0.0, 1.0), 0.5)),
        cabin=(
            view.outline(_car_part(geometry, (0.55, 0.7), 0.34)),
            view.outline(_car_part(geometry, (0.1, 0.15), 0.3)),
        ),
        axis_origin=view.at((0.0, 0.0)),
        length_line=_dimension(view, boxes[0][2], boxes[0][3], (0.0, -0.35)),
        width_line=_dimension(view, boxes[0][1], boxes[0][2], (-0.35, 0.0)),
        halo_label=view.at((_centre(region)[0], min(y for _, y in region) - d_safe_m)),
        source_label=view.at((source[2][0], source[2][1])),
        length_m=geometry.footprint_length_m,
        width_m=geometry.footprint_width_m,
        clearance_m=clearance_m,
        d_safe_m=d_safe_m,
        shift_m=_shift(edited, source),
        hcc=min(clearance_m / d_safe_m, 1.0),
        hpr=d_safe_m / (abs(clearance_m - d_safe_m) + d_safe_m),
        task=task,
    )


def _px_per_m() -> float:
    return WIDTH / (HIGH_X_M - LOW_X_M)


def _pictured_task(protocol: Protocol) -> Task:
    """The first task in which a bypass is acceptable; else the first task."""
    fitting = (task for task in protocol.tasks if Strategy.E in task.acceptable)
    return next(fitting, protocol.tasks[0])


def _trajectories(geometry: GeometrySection) -> tuple[list[Position], list[Position]]:
    """A swerve into the next lane, and straight on; T + 1 waypoints each."""
    edited, source = [], []
    for index in range(geometry.waypoints + 1):
        share = index / geometry.waypoints
        x = SPEED_MPS * 3.0 * share
        rise = min(max((share - 0.08) / 0.6, 0.0), 1.0)
        edited.append((x * 0.985, SWERVE_M * rise * rise * (3 - 2 * rise)))
        source.append((x, 0.0))
    return edited, source


def _footprints(trajectory: list[Position], geometry: GeometrySection) -> list[Outline]:
    headings = headings_rad(
        trajectory,
        geometry.heading_hold_m + geometry.heading_hold_tolerance_m,
        geometry.reverse_above_deg,
    )
    return [
        footprint(
            position,
            heading,
            geometry.footprint_length_m,
            geometry.footprint_width_m,
            geometry.footprint_centre_ahead_m,
        )
        for position, heading in zip(trajectory, headings, strict=True)
    ]


def _dimension(view: _View, a: Position, b: Position, away: Position) -> tuple[str, str, str, str]:
    """A line beside an edge that shows its length."""
    first, second = (a[0] + away[0], a[1] + away[1]), (b[0] + away[0], b[1] + away[1])
    return (*view.at(first), *view.at(second))


def _car_part(geometry: GeometrySection, along: tuple[float, float], across: float) -> Outline:
    """A rectangle of the car at t = 0: shares of its length from the rear, half share of width."""
    inset = CAR_INSET_M if across == 0.5 else 0.0
    rear = geometry.footprint_centre_ahead_m - geometry.footprint_length_m / 2
    back = rear + along[0] * geometry.footprint_length_m + inset
    front = rear + along[1] * geometry.footprint_length_m - inset
    side = across * geometry.footprint_width_m - inset
    return ((front, side), (back, side), (back, -side), (front, -side))


def _tube(boxes: list[Outline], geometry: GeometrySection) -> list[Outline]:
    if geometry.collision_tube == "footprints":
        return boxes
    return [convex_hull(a + b) for a, b in itertools.pairwise(boxes)]


def _region(tube: list[Outline], d_safe_m: float) -> Outline:
    """A hazard region in the ego lane, pushed aside until the tube passes at 60 % of d_safe."""
    shape: Outline = ((10.6, 0.75), (13.9, 1.15), (14.3, -0.85), (10.9, -1.2))
    low, high = -30.0, 3.0
    for _ in range(40):
        middle = (low + high) / 2
        moved = tuple((x, y + middle) for x, y in shape)
        is_close = _meets(tube, moved) or math.dist(*_nearest(tube, moved)) < 0.6 * d_safe_m
        low, high = (low, middle) if is_close else (middle, high)
    return tuple((x, y + low) for x, y in shape)


def _meets(tube: list[Outline], region: Outline) -> bool:
    """Whether a corner of the region lies in, or left of, a convex part of the tube."""
    return any(_inside(corner, part) for part in tube for corner in region) or any(
        _inside(corner, convex_hull(region)) for part in tube for corner in part
    )


def _inside(p: Position, hull: Outline) -> bool:
    sides = [
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        for a, b in zip(hull, hull[1:] + hull[:1], strict=True)
    ]
    return all(side >= 0 for side in sides) or all(side <= 0 for side in sides)


def _nearest(tube: list[Outline], region: Outline) -> tuple[Position, Position]:
    pairs = [nearest_positions(part, region) for part in tube]
    return min(pairs, key=lambda pair: math.dist(*pair))


def _centre(outline: Outline) -> Position:
    return (sum(x for x, _ in outline) / 4, sum(y for _, y in outline) / 4)


def _shift(edited: list[Position], source: list[Position]) -> float:
    """Mean displacement over T + 1 waypoints (equation CTS)."""
    return sum(math.dist(a, b) for a, b in zip(edited, source, strict=True)) / len(edited)


def _path(view: _View, trajectory: list[Position]) -> str:
    """A smooth path through the waypoints, running on to the edge of the picture."""
    direction = (
        trajectory[-1][0] - trajectory[-2][0],
        trajectory[-1][1] - trajectory[-2][1],
    )
    beyond = (trajectory[-1][0] + 2.5 * direction[0], trajectory[-1][1] + 2.5 * direction[1])
    points = [*trajectory, beyond]
    parts = ["M" + " ".join(view.at(points[0]))]
    for index in range(len(points) - 1):
        before = points[max(index - 1, 0)]
        here, there = points[index], points[index + 1]
        after = points[min(index + 2, len(points) - 1)]
        first = (here[0] + (there[0] - before[0]) / 6, here[1] + (there[1] - before[1]) / 6)
        second = (there[0] - (after[0] - here[0]) / 6, there[1] - (after[1] - here[1]) / 6)
        parts.append("C" + " ".join(" ".join(view.at(p)) for p in (first, second, there)))
    return "".join(parts)
