"""Fast reader of `exceptiondrive.planning/1`: one typed decode, then checks on whole arrays.

The decode leaves each trajectory as its own piece of JSON text. What is left of all pieces without
digits proves the shape of every trajectory at once; what is left without brackets is one flat list
of numbers. No object is made per waypoint, which is what costs most in JSON.
"""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import GeometrySection, PlausibilitySection, ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_worker.fast_decode import (
    ROOT_TEXTS,
    decode,
    n_texts,
    prediction_type,
    rows_of,
    submission_decoder,
)

TEXTS_PER_PREDICTION = 4
"""Keys `sample_id`, `source`, `edited`, and the id."""
ANGLE_MARGIN_DEG = 1e-6
"""Directions this close to the limit of the frame check are left to the precise checker."""

NULL = b"null"
NO_NUMBERS_NO_BLANKS = b"+-.0123456789Ee \t\n\r"
BRACKETS_TO_BLANKS = bytes.maketrans(b"[]", b"  ")
NUMBERS = msgspec.json.Decoder(list[float], strict=True)


DECODER = submission_decoder(
    prediction_type(
        "PlanningPrediction",
        [("sample_id", str), ("source", msgspec.Raw), ("edited", msgspec.Raw)],
    )
)


def read_planning(
    text: bytes, manifest: Manifest, protocol: ProtocolDocument
) -> dict[str, NDArray[Any]] | None:
    """Return the columns `source` and `edited`, (N, T, 2) metres, NaN where missing.

    Returns:
        None where the file is faulty or not certainly sound.
    """
    if n_texts(text) != ROOT_TEXTS + TEXTS_PER_PREDICTION * len(manifest.sample_ids):
        return None
    submission = decode(text, DECODER, PLANNING.file_schema, manifest)
    rows = rows_of(submission.predictions, manifest) if submission else None
    if submission is None or rows is None:
        return None
    source = _column([each.source for each in submission.predictions], rows, protocol.geometry)
    edited = _column([each.edited for each in submission.predictions], rows, protocol.geometry)
    if source is None or edited is None:
        return None
    if not is_surely_in_frame(source[:, -1], protocol.plausibility):
        return None
    return {"source": source, "edited": edited}


def _column(
    trajectories: Sequence[msgspec.Raw], rows: NDArray[np.intp], geometry: GeometrySection
) -> FloatArray | None:
    """Return (N, T, 2) in canonical order, or None where a shape or a bound is broken."""
    texts = list(map(bytes, trajectories))
    given = [text for text in texts if text != NULL]
    points_m = _points_m(given, geometry.waypoints)
    if points_m is None or not _is_within_bounds(points_m, geometry):
        return None
    if len(given) < len(texts):
        rows = rows[[text != NULL for text in texts]]
    column_m = np.full((len(texts), geometry.waypoints, 2), math.nan)
    column_m[rows] = points_m
    return column_m


def _points_m(texts: Sequence[bytes], n_waypoints: int) -> FloatArray | None:
    """Return (n, T, 2) of n JSON texts, or None where one is not `[[x, y] x T]`."""
    joined = b",".join(texts)
    one = b"[" + b",".join([b"[,]"] * n_waypoints) + b"]"
    if joined.translate(None, NO_NUMBERS_NO_BLANKS) != b",".join([one] * len(texts)):
        return None
    try:
        numbers = NUMBERS.decode(b"[" + joined.translate(BRACKETS_TO_BLANKS) + b"]")
    except msgspec.DecodeError:
        return None
    if len(numbers) != len(texts) * n_waypoints * 2:
        return None
    points_m = np.fromiter(numbers, np.float64, len(numbers))
    points_m += 0.0  # no negative zeros, as in the precise checker
    return points_m.reshape(-1, n_waypoints, 2)


def _is_within_bounds(points_m: FloatArray, geometry: GeometrySection) -> bool:
    if points_m.size == 0:
        return True
    if not max(points_m.max(), -points_m.min()) <= geometry.max_coordinate_m:
        return False  # first of all: squares of what is far outside overflow
    steps_m = np.diff(points_m, axis=1, prepend=0.0)
    squares_m2 = np.square(steps_m, out=steps_m)
    longest_m2 = (squares_m2[..., 0] + squares_m2[..., 1]).max()
    return bool(longest_m2 <= geometry.max_step_m**2)


def is_surely_in_frame(ends_m: FloatArray, rules: PlausibilitySection) -> bool:
    """Whether the frame check of docs/protocol.md section 5 certainly passes.

    More than half of the moving trajectories within the cone around +x, and so is their median.

    Args:
        ends_m: (N, 2) last source waypoints, NaN where missing.
        rules: Thresholds.
    """
    x_m, y_m = ends_m[:, 0], ends_m[:, 1]
    moves = x_m * x_m + y_m * y_m > rules.frame_check_min_motion_m**2
    n_moving = np.count_nonzero(moves)
    if n_moving < rules.frame_check_min_samples:
        return True
    limit_rad = math.radians(rules.frame_check_max_angle_deg - ANGLE_MARGIN_DEG)
    is_ahead = np.abs(y_m) * math.cos(limit_rad) < x_m * math.sin(limit_rad)
    return bool(np.count_nonzero(moves & is_ahead) * 2 > n_moving)
