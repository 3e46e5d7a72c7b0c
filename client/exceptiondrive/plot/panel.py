"""One sample as SVG markup: the group of shapes inside its panel, and the words below."""

from collections.abc import Iterator
from xml.sax.saxutils import escape

from exceptiondrive.cli.numbers import metric_text
from exceptiondrive.plot.scenes import Outline, Scene
from exceptiondrive.plot.view import View
from exceptiondrive_schemas.challenges import PLANNING

CAPTION_KEYS = ("hcc", "hpr", "cts")


def drawing(scene: Scene, width: float, height: float) -> str:
    """Return the shapes of one sample for a box of this size, from back to front."""
    view = View.of(scene, width, height)
    parts = [
        *_grid(view),
        *_hazard(scene, view),
        *_source(scene, view),
        *_edited(scene, view),
        *_clearance(scene, view),
    ]
    return "".join(parts)


def caption(scene: Scene) -> tuple[str, str]:
    """Return two lines: which sample, and what it scores."""
    values = []
    for key in CAPTION_KEYS:
        metric = PLANNING.metric(key)
        unit = " %" if metric.unit == "fraction" else " m"
        value = scene.metrics[key]
        text = "undefined" if value is None else metric_text(metric, value) + unit
        values.append(f"{metric.label} {text}")
    return f"{scene.task} · {scene.hazard}", f"{outcome(scene)} · {' · '.join(values)}"


def outcome(scene: Scene) -> str:
    """Say how near the tube comes, in a few words."""
    if scene.clearance_m is None:
        return "no edited trajectory: counts as intrusion"
    if scene.is_intrusion:
        return f"intrusion; {scene.d_safe_m:g} m asked for"
    return f"clearance {scene.clearance_m:.2f} m of {scene.d_safe_m:g} m"


def _grid(view: View) -> Iterator[str]:
    along, across = view.grid_m()
    for x in along:
        px = f"{view.at((x, 0))[0]:.1f}"
        yield f'<path class="grid" d="M{px} 0V{view.height:g}"/>'
        yield f'<text class="tick" x="{px}" y="{view.height - 5:g}" dx="3">{x} m</text>'
    for y in across:
        yield f'<path class="grid" d="M0 {view.at((0, y))[1]:.1f}H{view.width:g}"/>'


def _hazard(scene: Scene, view: View) -> Iterator[str]:
    """The region, and the band of required clearance around it: a stroke twice as wide."""
    points, width = view.points(scene.region), 2 * scene.d_safe_m * view.scale
    yield f'<polygon class="safe" points="{points}" stroke-width="{width:.1f}"/>'
    yield f'<polygon class="region" points="{points}"/>'


def _source(scene: Scene, view: View) -> Iterator[str]:
    if scene.source:
        yield f'<polyline class="source" points="{view.points(scene.source)}"/>'
        yield from _dots("source-dot", scene.source[1:], view, 2.6)


def _edited(scene: Scene, view: View) -> Iterator[str]:
    if not scene.edited:
        return
    pieces = "".join(f'<polygon points="{view.points(piece)}"/>' for piece in scene.tube)
    yield f'<g class="tube">{pieces}</g>'
    for footprint in scene.footprints:
        yield f'<polygon class="box" points="{view.points(footprint)}"/>'
    yield f'<polyline class="edited" points="{view.points(scene.edited)}"/>'
    yield from _dots("edited-dot", scene.edited[1:], view, 3)
    x, y = view.at((0.0, 0.0))
    yield f'<circle class="origin" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'


def _clearance(scene: Scene, view: View) -> Iterator[str]:
    if scene.segment is None or scene.clearance_m is None:
        return
    (x1, y1), (x2, y2) = (view.at(end) for end in scene.segment)
    yield f'<path class="gap" d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}"/>'
    for x, y in ((x1, y1), (x2, y2)):
        yield f'<circle class="gap-end" cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>'
    x = min(max((x1 + x2) / 2, 30.0), view.width - 30.0)
    y = min(max((y1 + y2) / 2 - 9, 14.0), view.height - 20.0)
    text = escape(f"{scene.clearance_m:.2f} m")
    yield f'<text class="gap-text" x="{x:.1f}" y="{y:.1f}">{text}</text>'


def _dots(kind: str, positions: Outline, view: View, radius: float) -> Iterator[str]:
    for position in positions:
        x, y = view.at(position)
        yield f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>'
