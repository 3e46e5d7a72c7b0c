"""Other forms in which planners write a trajectory: the checker names them, `convert` reads them."""

import json
import math
from collections.abc import Mapping
from typing import Any

AXES = (("x", "y"), ("x_m", "y_m"))
HEADINGS = ("heading", "heading_rad", "yaw", "theta")
MAX_POINT_WIDTH = 3
"""x, y and a heading."""


def is_number(value: Any) -> bool:
    """Whether it is a number, not a boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_in(text: Any) -> float | None:
    """Return the number that a text writes, NaN and infinities included; None where it is none."""
    if not isinstance(text, str):
        return None
    try:
        return float(text)
    except ValueError:
        return None


def point_in(value: Any) -> list[Any] | None:
    """Return [x, y] or [x, y, heading] of a waypoint that is an object with these keys."""
    axes = _axes_of(value)
    if axes is None:
        return None
    return [*axes, *([value[key] for key in HEADINGS if key in value][:1])]


def trajectory_in(value: Any) -> tuple[list[Any], str] | None:
    """Find the waypoints in what stands in place of a trajectory.

    Args:
        value: Decoded JSON.

    Returns:
        The waypoints as they stand there, and the form in words; None where it is a list of
        waypoints already, or nothing that is known.
    """
    if isinstance(value, str):
        return _list_in(value)
    columns = _axes_of(value)
    if columns is not None and all(isinstance(column, list) for column in columns):
        return _transposed(columns), "an object with a list of x and a list of y"
    if isinstance(value, Mapping) and len(value) == 1:
        ((key, inner),) = value.items()
        if isinstance(inner, list):
            return inner, f'waypoints in an object, under the key "{key}"'
    if not isinstance(value, list) or not value:
        return None
    if all(is_number(each) or number_in(each) is not None for each in value):
        if len(value) % 2:
            return None
        flat = [list(pair) for pair in zip(value[::2], value[1::2], strict=True)]
        return flat, "one flat list, read as x1, y1, x2, y2, ..."
    if len(value) == len(AXES[0]) and all(_is_row(row) for row in value):
        return _transposed(value), "a row of x and a row of y"
    return None


def _list_in(text: str) -> tuple[list[Any], str] | None:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return (found, "a list that is written as text") if isinstance(found, list) else None


def _axes_of(value: Any) -> list[Any] | None:
    if isinstance(value, Mapping):
        for axes in AXES:
            if all(axis in value for axis in axes):
                return [value[axis] for axis in axes]
    return None


def _is_row(row: Any) -> bool:
    return isinstance(row, list) and len(row) > MAX_POINT_WIDTH and all(map(is_number, row))


def _transposed(columns: list[Any]) -> list[Any]:
    xs, ys = columns
    n = max(len(xs), len(ys))
    padded = ([*column, *[math.nan] * (n - len(column))] for column in (xs, ys))
    return [list(point) for point in zip(*padded, strict=True)]
