"""The drawing of what a protocol measures: footprints, collision tube, hazard region, clearance.

All geometry and grades come from the scoring code, as a `ProtocolDrawing` that a worker made. This
module only lays it out: a road, a car, smooth lines and labels.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from exceptiondrive_schemas.drawing import Outline, Position, ProtocolDrawing, View, pictured_digest
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.taxonomy import Strategy, Task
from exceptiondrive_server.web.numbers import px

WIDTH, HEIGHT = 600, 330
MARGIN_TOP = 48
LANE_M = 3.5
LOW_X_M, HIGH_X_M = -2.2, 20.6
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
    task_id: str
    is_own: bool
    """Whether it is drawn under this very protocol; else under protocol 1.0, until it is made."""


def scene_drawing(drawing: ProtocolDrawing, protocol: ProtocolDocument) -> SceneDrawing:
    """Set the drawing of a protocol."""
    sample, geometry = drawing.sample, protocol.geometry
    assert sample.segment is not None  # made up so that it passes at a distance
    near, boxes = sample.segment, sample.footprints
    scale = WIDTH / (HIGH_X_M - LOW_X_M)
    view = View(scale, LOW_X_M, MARGIN_TOP / scale + 1.5 * LANE_M, WIDTH, HEIGHT)
    middle = ((near[0][0] + near[1][0]) / 2, (near[0][1] + near[1][1]) / 2)
    lowest = min(y for _, y in sample.region)
    return SceneDrawing(
        width=WIDTH,
        height=HEIGHT,
        road_top=_pixel_at(view, (0, LANE_M * 1.5))[1],
        road_bottom=_pixel_at(view, (0, -LANE_M * 0.5 - 1.6))[1],
        lane_y=_pixel_at(view, (0, LANE_M * 0.5))[1],
        tube=tuple(view.points(part) for part in sample.tube),
        footprints=tuple(view.points(box) for box in boxes),
        edited=_path(view, sample.edited),
        source=_path(view, sample.source),
        waypoints=tuple(_pixel_at(view, position) for position in sample.edited[1:]),
        region=view.points(sample.region),
        halo_width=px(2 * sample.d_safe_m * view.scale),
        region_label=_pixel_at(view, _centre(sample.region)),
        clearance=(*_pixel_at(view, near[0]), *_pixel_at(view, near[1])),
        clearance_label=_pixel_at(view, middle),
        car=view.points(_car_part(geometry, (0.0, 1.0), 0.5)),
        cabin=(
            view.points(_car_part(geometry, (0.55, 0.7), 0.34)),
            view.points(_car_part(geometry, (0.1, 0.15), 0.3)),
        ),
        axis_origin=_pixel_at(view, (0.0, 0.0)),
        length_line=_dimension_line(view, boxes[0][2], boxes[0][3], (0.0, -0.35)),
        width_line=_dimension_line(view, boxes[0][1], boxes[0][2], (-0.35, 0.0)),
        halo_label=_pixel_at(view, (_centre(sample.region)[0], lowest - sample.d_safe_m)),
        source_label=_pixel_at(view, sample.source[min(2, len(sample.source) - 1)]),
        length_m=geometry.footprint_length_m,
        width_m=geometry.footprint_width_m,
        clearance_m=sample.clearance_m or 0.0,
        d_safe_m=sample.d_safe_m,
        shift_m=sample.metrics["cts"] or 0.0,
        hcc=sample.metrics["hcc"] or 0.0,
        hpr=sample.metrics["hpr"] or 0.0,
        task_id=sample.task,
        is_own=pictured_digest(protocol) == drawing.pictured,
    )


def _pixel_at(view: View, position: Position) -> tuple[str, str]:
    x, y = view.at(position)
    return px(x), px(y)


def _dimension_line(
    view: View, a: Position, b: Position, away: Position
) -> tuple[str, str, str, str]:
    """A line beside an edge that shows its length."""
    first, second = (a[0] + away[0], a[1] + away[1]), (b[0] + away[0], b[1] + away[1])
    return (*_pixel_at(view, first), *_pixel_at(view, second))


def _car_part(geometry: GeometrySection, along: tuple[float, float], across: float) -> Outline:
    """A rectangle of the car at t = 0: shares of its length from the rear, half share of width."""
    inset = CAR_INSET_M if across == 0.5 else 0.0
    rear = geometry.footprint_centre_ahead_m - geometry.footprint_length_m / 2
    back = rear + along[0] * geometry.footprint_length_m + inset
    front = rear + along[1] * geometry.footprint_length_m - inset
    side = across * geometry.footprint_width_m - inset
    return ((front, side), (back, side), (back, -side), (front, -side))


def _centre(outline: Outline) -> Position:
    return (sum(x for x, _ in outline) / 4, sum(y for _, y in outline) / 4)


def _path(view: View, trajectory: Outline) -> str:
    """A smooth path through the waypoints, running on to the edge of the picture."""
    direction = (
        trajectory[-1][0] - trajectory[-2][0],
        trajectory[-1][1] - trajectory[-2][1],
    )
    beyond = (trajectory[-1][0] + 2.5 * direction[0], trajectory[-1][1] + 2.5 * direction[1])
    points = [*trajectory, beyond]
    parts = ["M" + " ".join(_pixel_at(view, points[0]))]
    for index in range(len(points) - 1):
        before = points[max(index - 1, 0)]
        here, there = points[index], points[index + 1]
        after = points[min(index + 2, len(points) - 1)]
        first = (here[0] + (there[0] - before[0]) / 6, here[1] + (there[1] - before[1]) / 6)
        second = (there[0] - (after[0] - here[0]) / 6, there[1] - (after[1] - here[1]) / 6)
        parts.append("C" + " ".join(" ".join(_pixel_at(view, p)) for p in (first, second, there)))
    return "".join(parts)


class Answer(NamedTuple):
    """A strategy as the answer to one task."""

    letter: str
    action: str
    kind: Literal["right", "careless", "other"]

    @property
    def verdict(self) -> str:
        """What the protocol makes of it, in words."""
        return {"right": "acceptable", "careless": "too careless", "other": "wrong"}[self.kind]


def answers_to(task: Task) -> tuple[Answer, ...]:
    """Return what each strategy is worth as the answer to a task."""

    def kind(strategy: Strategy) -> Literal["right", "careless", "other"]:
        if strategy in task.acceptable:
            return "right"
        return "careless" if strategy in task.under_warning else "other"

    return tuple([Answer(each.value, each.action, kind(each)) for each in Strategy])
