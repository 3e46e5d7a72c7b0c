"""One sample as SVG markup, and the words below it.

The markup carries class names alone: a picture file brings its own style, a page has its own.
"""

from collections.abc import Iterator
from xml.sax.saxutils import escape

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.drawing.documents import Outline, SampleDrawing
from exceptiondrive_schemas.drawing.view import View

CAPTION_KEYS = ("hcc", "hpr", "cts")
TICK_ROOM_PX = 36
MINUS = "\u2212"


def shapes(sample: SampleDrawing, width: float, height: float) -> str:
    """Return the shapes of one sample for a box of this size, from back to front."""
    view = View.of(sample, width, height)
    parts = [
        *_grid(view),
        *_hazard(sample, view),
        *_source(sample, view),
        *_edited(sample, view),
        *_clearance(sample, view),
    ]
    return "".join(parts)


def caption(sample: SampleDrawing) -> tuple[str, str]:
    """Return two lines: which sample, and what it scores."""
    values = []
    for key in CAPTION_KEYS:
        metric, value = PLANNING.metric(key), sample.metrics[key]
        text = "undefined" if value is None else _with_unit(value, metric.unit)
        values.append(f"{metric.label} {text}")
    return f"{sample.task} · {sample.hazard}", f"{outcome(sample)} · {' · '.join(values)}"


def outcome(sample: SampleDrawing) -> str:
    """Say how near the tube comes, in a few words."""
    if sample.clearance_m is None:
        return "no edited trajectory: counts as intrusion"
    if sample.is_intrusion:
        return f"intrusion; {sample.d_safe_m:g} m asked for"
    return f"clearance {sample.clearance_m:.2f} m of {sample.d_safe_m:g} m"


def _with_unit(value: float, unit: str) -> str:
    return f"{value * 100:.2f} %" if unit == "fraction" else f"{value:.2f} m"


def _grid(view: View) -> Iterator[str]:
    along, across = view.grid_m()
    for x in along:
        at = view.at((x, 0))[0]
        yield f'<path class="grid" d="M{at:.1f} 0V{view.height:g}"/>'
        if at + TICK_ROOM_PX < view.width:
            text = f"{x} m".replace("-", MINUS)
            yield f'<text class="tick" x="{at:.1f}" y="{view.height - 5:g}" dx="3">{text}</text>'
    for y in across:
        yield f'<path class="grid" d="M0 {view.at((0, y))[1]:.1f}H{view.width:g}"/>'


def _hazard(sample: SampleDrawing, view: View) -> Iterator[str]:
    """The region, and the band of required clearance around it: a stroke twice as wide."""
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
    text = escape(f"{sample.clearance_m:.2f} m")
    yield f'<text class="gap-text" x="{x:.1f}" y="{y:.1f}">{text}</text>'


def _dots(kind: str, positions: Outline, view: View, radius: float) -> Iterator[str]:
    for position in positions:
        x, y = view.at(position)
        yield f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>'
