"""A made-up sample that shows what a protocol measures: a swerve past a hazard in the lane.

The region is pushed aside until the tube passes it at a share of the required clearance, so that
HCC, HPR and the clearance can all be seen. Geometry and grades are those of every other sample.
"""

import numpy as np

from exceptiondrive_schemas.drawing import ProtocolDrawing, pictured_digest, pictured_task
from exceptiondrive_schemas.protocol import GeometrySection, Protocol
from exceptiondrive_schemas.split import SplitSample
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_scoring.clearance import clearance_m
from exceptiondrive_scoring.drawing import Drawer
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.region import prepare_regions
from exceptiondrive_scoring.split_arrays import split_arrays

SAMPLE_ID = "made-up"
REACH_M = 16.2
SWERVE_M = 3.3
SHARE_OF_REQUIRED = 0.6
REGION_M = ((10.6, 0.75), (13.9, 1.15), (14.3, -0.85), (10.9, -1.2))
FURTHEST_ASIDE_M = 30.0
N_HALVINGS = 40


def protocol_drawing(protocol: Protocol) -> ProtocolDrawing:
    """Draw the made-up sample under a protocol."""
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
    """Move the region to the right until the clearance is what is wanted."""
    shape, path = np.array(REGION_M), np.concatenate([np.zeros((1, 2)), edited])[None]
    low, high = -FURTHEST_ASIDE_M, SWERVE_M
    for _ in range(N_HALVINGS):
        middle = (low + high) / 2
        moved = prepare_regions((shape + _aside(middle))[None])
        is_close = clearance_m(path, moved, geometry)[0] < wanted_m
        low, high = (low, middle) if is_close else (middle, high)
    return tuple((float(x), float(y)) for x, y in shape + _aside(low))


def _aside(y_m: float) -> FloatArray:
    return np.array([0.0, y_m])
