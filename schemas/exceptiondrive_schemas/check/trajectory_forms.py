"""Other forms in which planners write a trajectory: the checker names them, `convert` reads them."""

import math
import re
from collections.abc import Mapping
from typing import Any

AXES = (("x", "y"), ("x_m", "y_m"), ("X", "Y"))
HEADINGS = ("heading", "heading_rad", "yaw", "theta")
_ROW = re.compile(r"\[([^\[\]]+)\]")
MAX_POINT_WIDTH = 3
"""x, y and a heading."""


NULL_WORDS = frozenset({"", "none", "nan", "null", "na", "n/a", "nil"})
"""What programs write as text for nothing, in small letters."""


def is_null_word(value: Any) -> bool:
    """Whether it is a text, or false, that stands for nothing."""
    return value is False or (isinstance(value, str) and value.strip().lower() in NULL_WORDS)


def is_number(value: Any) -> bool:
    """Whether it is a number, not a boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_in(text: Any) -> float | None:
    """Return the number that a text writes, NaN, infinities and a decimal comma included.

    None where it is none.
    """
    if not isinstance(text, str):
        return None
    if is_null_word(text):
        return math.nan
    try:
        return float(text.replace(",", ".") if "." not in text else text)
    except ValueError:
        return None


def point_in(value: Any) -> list[Any] | None:
    """Return [x, y] or [x, y, heading] of a waypoint that is an object with these keys, or a text."""
    if isinstance(value, str):
        return _numbers_in(value)
    axes = _axes_of(value)
    if axes is None:
        return None
    return [*axes, *([value[key] for key in HEADINGS if key in value][:1])]


def trajectory_in(value: Any) -> tuple[list[Any], str] | None:
    """Find the waypoints in decoded JSON that stands in place of a trajectory.

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
    if len(value) > 1 and all(_is_point_in_list(each) for each in value):
        return [each[0] for each in value], "waypoints each in a list of its own"
    if all(is_number(each) or number_in(each) is not None for each in value):
        if len(value) % 2:
            return None
        flat = [list(pair) for pair in zip(value[::2], value[1::2], strict=True)]
        return flat, "one flat list, read as x1, y1, x2, y2, ..."
    if len(value) == len(AXES[0]) and all(_is_row(row) for row in value):
        return _transposed(value), "a row of x and a row of y"
    return None


def _list_in(text: str) -> tuple[list[Any], str] | None:
    """Read `[[1.0, 0.0], ...]` with commas or blanks, as numpy and torch print it."""
    found = [_numbers_in(row) for row in _ROW.findall(text)]
    if len(found) < 2 or None in found:
        return None
    return found, "a list that is written as text"


def _numbers_in(text: str) -> list[Any] | None:
    numbers = [number_in(word) for word in text.strip("()[] ").replace(",", " ").split()]
    return numbers if len(numbers) > 1 and None not in numbers else None


def _is_point_in_list(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 1 and isinstance(value[0], list)


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
