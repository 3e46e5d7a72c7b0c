"""What most people would write, and the best that shapely gives: the references.

Both share no code with the scoring package.
"""

import math
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon
from shapely.ops import unary_union

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray


def naive_headings(points: list[tuple[float, float]], geometry: GeometrySection) -> list[float]:
    """Heading at each of T + 1 points."""
    headings = [0.0]
    for (x0, y0), (x1, y1) in pairwise(points):
        if (
            math.hypot(x1 - x0, y1 - y0)
            <= geometry.heading_hold_m + geometry.heading_hold_tolerance_m
        ):
            headings.append(headings[-1])
            continue
        angle = math.atan2(y1 - y0, x1 - x0)
        off = (angle - headings[-1] + math.pi) % (2 * math.pi) - math.pi
        if abs(off) > math.radians(geometry.reverse_above_deg) + 1e-9:
            angle += math.pi
        headings.append(math.atan2(math.sin(angle), math.cos(angle)))
    return headings


def naive_footprint(x: float, y: float, heading: float, geometry: GeometrySection) -> Polygon:
    """The vehicle rectangle at one pose."""
    cos, sin = math.cos(heading), math.sin(heading)
    front = geometry.footprint_centre_ahead_m + geometry.footprint_length_m / 2
    rear = geometry.footprint_centre_ahead_m - geometry.footprint_length_m / 2
    half = geometry.footprint_width_m / 2
    return Polygon(
        [
            (x + ahead * cos - left * sin, y + ahead * sin + left * cos)
            for ahead, left in ((front, half), (rear, half), (rear, -half), (front, -half))
        ]
    )


def naive_clearance_m(
    waypoints: FloatArray, region: FloatArray, geometry: GeometrySection
) -> float:
    """Clearance of one sample: hulls, their union, intersects, distance."""
    points = [(0.0, 0.0), *((float(x), float(y)) for x, y in waypoints)]
    headings = naive_headings(points, geometry)
    boxes = [naive_footprint(x, y, h, geometry) for (x, y), h in zip(points, headings, strict=True)]
    if geometry.collision_tube == "footprints":
        tube = unary_union(boxes)
    else:
        pieces = [MultiPolygon(pair).convex_hull for pair in pairwise(boxes)]
        tube = unary_union(pieces)
    hazard = Polygon(region)
    return 0.0 if tube.intersects(hazard) else float(tube.distance(hazard))


def naive_clearances_m(
    waypoints: FloatArray, regions: FloatArray, geometry: GeometrySection
) -> FloatArray:
    """Loop over samples."""
    return np.array(
        [naive_clearance_m(w, r, geometry) for w, r in zip(waypoints, regions, strict=True)]
    )


def vectorised_clearances_m(
    waypoints: FloatArray, regions: FloatArray, geometry: GeometrySection
) -> FloatArray:
    """Shapely on arrays: one MultiPolygon of overlapping hulls per sample, distance only."""
    n_samples, n_waypoints, _ = waypoints.shape
    points = np.concatenate([np.zeros((n_samples, 1, 2)), waypoints], axis=1)
    corners = _corners(points, _headings(points, geometry), geometry)
    both = np.concatenate([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 8, 2)
    hulls = np.asarray(shapely.convex_hull(np.asarray(shapely.linestrings(both))))
    tubes = shapely.multipolygons(hulls.reshape(n_samples, n_waypoints))
    return np.asarray(shapely.distance(np.asarray(tubes), np.asarray(shapely.polygons(regions))))


def _headings(points: FloatArray, geometry: GeometrySection) -> FloatArray:
    steps = np.diff(points, axis=1)
    angles = np.arctan2(steps[..., 1], steps[..., 0])
    moved = np.hypot(steps[..., 0], steps[..., 1]) > (
        geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    )
    headings = np.zeros(points.shape[:2])
    for t in range(steps.shape[1]):
        off = (angles[:, t] - headings[:, t] + np.pi) % (2 * np.pi) - np.pi
        reverse = np.abs(off) > np.radians(geometry.reverse_above_deg) + 1e-9
        headings[:, t + 1] = np.where(moved[:, t], angles[:, t] + np.pi * reverse, headings[:, t])
    return headings


def _corners(points: FloatArray, headings: FloatArray, geometry: GeometrySection) -> FloatArray:
    cos, sin = np.cos(headings)[..., None], np.sin(headings)[..., None]
    half, centre = geometry.footprint_length_m / 2, geometry.footprint_centre_ahead_m
    ahead = np.array([centre + half, centre - half, centre - half, centre + half])
    left = np.array([1, 1, -1, -1]) * geometry.footprint_width_m / 2
    x = points[..., 0:1] + ahead * cos - left * sin
    y = points[..., 1:2] + ahead * sin + left * cos
    return np.stack([x, y], axis=-1)
