"""Measurements of a region while a reader edits it, by the geometry that scores it."""

from typing import Any

import numpy as np

from exceptiondrive_build.values import Corners
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.submission_files import Waypoint
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.clearance import clearance_m, touches_start
from exceptiondrive_scoring.drawing import tube_pieces_m
from exceptiondrive_scoring.footprint import footprints_m
from exceptiondrive_scoring.region import (
    crosses_itself,
    is_far,
    is_small,
    prepare_regions,
    signed_area_m2,
)


def region_faults(corners: Corners | None, protocol: ProtocolDocument) -> tuple[str, ...]:
    """Return, in words, why a split with this region is refused (docs/protocol.md section 2)."""
    geometry = protocol.geometry
    if corners is None:
        return ("it has no corners",)
    points = np.array(corners)
    if not np.isfinite(points).all():
        return ("a corner is not finite",)
    if is_far(points[None], geometry)[0]:
        return (f"a corner is more than {geometry.max_region_distance_m:g} m away",)
    if crosses_itself(points[None])[0]:
        return ("it crosses or touches itself",)
    faults = []
    if is_small(points[None], geometry)[0]:
        faults.append(f"it is smaller than {geometry.min_region_area_m2:g} m²")
    if touches_start(prepare_regions(points[None]), geometry)[0]:
        faults.append("it touches the car where it stands")
    return tuple(faults)


def measured(
    corners: Corners, path: tuple[Waypoint, ...] | None, protocol: ProtocolDocument
) -> dict[str, Any]:
    """Return a region's area, clearance from the recorded drive (None if unknown), and faults."""
    area_m2 = drive_m = None
    points = np.array([corners])
    if not is_far(points, protocol.geometry)[0] and not crosses_itself(points)[0]:
        area_m2 = float(np.abs(signed_area_m2(points))[0])
        if path:
            drive = _from_origin(path)[None]
            drive_m = float(clearance_m(drive, prepare_regions(points), protocol.geometry)[0])
    return {
        "faults": region_faults(corners, protocol),
        "area_m2": area_m2,
        "clearance_m": drive_m,
    }


def tube_m(path: tuple[Waypoint, ...], protocol: ProtocolDocument) -> list[list[list[float]]]:
    """Convex pieces of the collision tube of a path."""
    pieces = tube_pieces_m(_from_origin(path), protocol.geometry)
    return [piece.round(3).tolist() for piece in pieces]


def start_footprint_m(protocol: ProtocolDocument) -> list[list[float]]:
    """Return the footprint of the car at its start."""
    corners: list[list[float]] = footprints_m(np.zeros((1, 1, 2)), protocol.geometry)[0, 0].tolist()
    return corners


def _from_origin(path: tuple[Waypoint, ...]) -> FloatArray:
    return np.array([(0.0, 0.0), *path])
