"""Drawings of samples: data in metres, and the only code that paints their shapes.

The worker and `exceptiondrive plot` make the data with the scoring code's own geometry, x forward
and y left in the ego frame. Pages and picture files paint it: the markup has only class names; a
picture file and a page each have their own style. A drawing shows a hazard region, so it may only
be made of a public split.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.printable import MINUS
from exceptiondrive_schemas.protocol import PACKAGED_PROTOCOLS, ProtocolDocument
from exceptiondrive_schemas.score_sheet import MetricRow, text_with_unit
from exceptiondrive_schemas.taxonomy import Strategy, Task

Position = tuple[float, float]
Outline = tuple[Position, ...]


class SampleDrawing(Document):
    """One sample of one entry, as the scoring code sees it.

    Attributes:
        sample_id: Key of the sample.
        family: Its family id.
        task: Its task id.
        hazard: The task in words.
        region: Corners of the hazard region.
        source: Waypoints with the origin in front; empty where missing.
        edited: The same of the edited scene.
        source_footprints: Vehicle rectangles along `source`.
        footprints: The same along `edited`.
        tube: Convex pieces of the collision tube.
        segment: Ends of the clearance, on the tube and on the region; None on intrusion.
        clearance_m: Distance of tube and region; None where edited is missing.
        clearances_m: The same of the tube until each time step, t = 0 first: it never grows, is 0
            from contact on, and ends at `clearance_m`.
        d_safe_m: Required clearance.
        metrics: Of this sample alone, by key; None where undefined.
    """

    sample_id: str
    family: str
    task: str
    hazard: str
    region: Outline
    source: Outline
    edited: Outline
    source_footprints: tuple[Outline, ...]
    footprints: tuple[Outline, ...]
    tube: tuple[Outline, ...]
    segment: tuple[Position, Position] | None
    clearance_m: float | None
    clearances_m: tuple[float, ...]
    d_safe_m: float
    metrics: MetricRow

    @property
    def is_intrusion(self) -> bool:
        """Whether the tube meets the region, or there is no edited trajectory."""
        return self.segment is None


class DrawnSample(Document):
    """A sample that stands for its family.

    `scene` is the same for every entry of a split: the one whose region stands at the middle
    distance. `worst` and `middle` are the entry's own, by HCC, then clearance.
    """

    chosen_as: Literal["scene", "worst", "middle"]
    drawing: SampleDrawing


class EntryDrawings(Document):
    """What is drawn of one entry on a public split."""

    schema_: Literal["exceptiondrive.drawings/1"] = Field(
        default="exceptiondrive.drawings/1", alias="schema"
    )
    samples: tuple[DrawnSample, ...]


class ProtocolDrawing(Document):
    """A made-up sample under one protocol: what footprint, tube, region and clearance are.

    Attributes:
        pictured: Digest of what the drawing depends on (`pictured_digest`).
        sample: The made-up sample.
    """

    schema_: Literal["exceptiondrive.protocol-drawing/1"] = Field(
        default="exceptiondrive.protocol-drawing/1", alias="schema"
    )
    pictured: str
    sample: SampleDrawing


PACKAGED_DRAWING = PACKAGED_PROTOCOLS / "1.0.drawing.json"


def pictured_task(protocol: ProtocolDocument) -> Task:
    """Return the first task in which a bypass is acceptable; else the first task."""
    fitting = (task for task in protocol.tasks if Strategy.E in task.acceptable)
    return next(fitting, protocol.tasks[0])


def pictured_digest(protocol: ProtocolDocument) -> str:
    """Return the digest of everything that the drawing of a protocol depends on."""
    task = pictured_task(protocol)
    return content_digest(
        {
            "geometry": protocol.geometry_digest,
            "task": task.model_dump(mode="json"),
            "d_safe_scale": protocol.grading.d_safe_scale,
        }
    )


@cache
def packaged_drawing() -> ProtocolDrawing:
    """Return the drawing of protocol 1.0, written by `python -m exceptiondrive_worker.drawing`."""
    return ProtocolDrawing.model_validate_json(PACKAGED_DRAWING.read_bytes())


MARGIN_M = 2.0
MIN_SPAN_M = 14.0
MAX_REACH_M = 60.0
"""Distance from the vehicle up to which a region is drawn; beyond, only its beginning is shown."""
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
    def of(cls, samples: Sequence[SampleDrawing], width: float, height: float) -> "View":
        """Return the view, in pixels, that contains everything that moves, and the region near it.

        `samples` are the same sample of one or more entries.
        """
        points = [(0.0, 0.0)]
        for sample in samples:
            points += [*sample.source, *sample.edited, *chain(*sample.footprints)]
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
        """Return positions in the syntax of SVG."""
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


def _span(values: Iterable[float]) -> tuple[float, float]:
    known = list(values)
    return min(known) - MARGIN_M, max(known) + MARGIN_M


CAPTION_KEYS = ("hcc", "hpr", "cts")
TICK_ROOM_PX = 46


def shapes(sample: SampleDrawing, width: float, height: float) -> str:
    """Return the shapes of one sample for a box of this size, from back to front."""
    view = View.of([sample], width, height)
    parts = [
        *grid(view),
        *hazard(sample, view),
        *_source(sample, view),
        *_edited(sample, view),
        *_clearance(sample, view),
    ]
    return "".join(parts)


def caption(sample: SampleDrawing) -> tuple[str, str]:
    """Return two lines: the sample, and its scores."""
    values = []
    for key in CAPTION_KEYS:
        metric, value = PLANNING.metric(key), sample.metrics[key]
        text = "undefined" if value is None else text_with_unit(metric, value)
        values.append(f"{metric.label} {text}")
    return f"{sample.task} · {sample.hazard}", f"{outcome(sample)} · {' · '.join(values)}"


def outcome(sample: SampleDrawing) -> str:
    """Return, in a few words, how close the tube comes."""
    if sample.clearance_m is None:
        return "no path with the hazard: counts as a hit"
    if sample.is_intrusion:
        return f"hit; {sample.d_safe_m:g} m required"
    return f"clearance {sample.clearance_m:.2f} m of {sample.d_safe_m:g} m required"


def grid(view: View) -> Iterator[str]:
    """Yield the lines of the grid, in metres, with their numbers along x."""
    along, across = view.grid_m()
    for x in along:
        at = view.at((x, 0))[0]
        yield f'<path class="grid" d="M{at:.1f} 0V{view.height:g}"/>'
        if at + TICK_ROOM_PX < view.width:
            text = f"{x} m".replace("-", MINUS)
            yield f'<text class="tick" x="{at:.1f}" y="{view.height - 5:g}" dx="3">{text}</text>'
    for y in across:
        yield f'<path class="grid" d="M0 {view.at((0, y))[1]:.1f}H{view.width:g}"/>'


def hazard(sample: SampleDrawing, view: View) -> Iterator[str]:
    """Yield the region, and the band of required clearance around it: a stroke twice as wide."""
    points, width = view.points(sample.region), 2 * sample.d_safe_m * view.scale
    yield f'<polygon class="safe" points="{points}" stroke-width="{width:.1f}"/>'
    yield f'<polygon class="region" points="{points}"/>'


def _source(sample: SampleDrawing, view: View) -> Iterator[str]:
    if sample.source:
        yield f'<polyline class="source" points="{view.points(sample.source)}"/>'
        yield from _dots("source-dot", sample.source[1:], view, 2.6)


def _edited(sample: SampleDrawing, view: View) -> Iterator[str]:
    if not sample.edited:
        return
    pieces = "".join(f'<polygon points="{view.points(piece)}"/>' for piece in sample.tube)
    yield f'<g class="tube">{pieces}</g>'
    for footprint in sample.footprints:
        yield f'<polygon class="box" points="{view.points(footprint)}"/>'
    yield f'<polyline class="edited" points="{view.points(sample.edited)}"/>'
    yield from _dots("edited-dot", sample.edited[1:], view, 3)
    x, y = view.at((0.0, 0.0))
    yield f'<circle class="origin" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'


def _clearance(sample: SampleDrawing, view: View) -> Iterator[str]:
    if sample.segment is None or sample.clearance_m is None:
        return
    (x1, y1), (x2, y2) = (view.at(end) for end in sample.segment)
    yield f'<path class="gap" d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}"/>'
    for x, y in ((x1, y1), (x2, y2)):
        yield f'<circle class="gap-end" cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>'
    x = min(max((x1 + x2) / 2, 30.0), view.width - 30.0)
    y = min(max((y1 + y2) / 2 - 9, 14.0), view.height - 20.0)
    text = f"{sample.clearance_m:.2f} m"
    yield f'<text class="gap-text" x="{x:.1f}" y="{y:.1f}">{text}</text>'


def _dots(kind: str, positions: Outline, view: View, radius: float) -> Iterator[str]:
    for position in positions:
        x, y = view.at(position)
        yield f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>'
