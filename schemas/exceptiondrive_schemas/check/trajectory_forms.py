"""Other forms of waypoints that planners write: the checker names them, `convert` reads them."""

import math
from collections.abc import Mapping
from typing import Any

AXES = (("x", "y"), ("x_m", "y_m"), ("X", "Y"))
HEADINGS = ("heading", "heading_rad", "yaw", "theta")


NULL_WORDS = frozenset({"", "none", "nan", "null", "na", "n/a", "nil"})
"""Texts that programs write for a missing value, in lower case."""


def is_null_word(value: Any) -> bool:
    """Whether it is a text, or false, that means a missing value."""
    return value is False or (isinstance(value, str) and value.strip().lower() in NULL_WORDS)


def is_number(value: Any) -> bool:
    """Whether it is a number, not a boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def number_in(text: Any) -> float | None:
    """Return the number in a text, including NaN, infinities and a decimal comma.

    None if it is no number.
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
    """Return [x, y] or [x, y, heading] of a waypoint that is an object with these keys."""
    axes = _axes_of(value)
    if axes is None:
        return None
    return [*axes, *([value[key] for key in HEADINGS if key in value][:1])]


def _axes_of(value: Any) -> list[Any] | None:
    if isinstance(value, Mapping):
        for axes in AXES:
            if all(axis in value for axis in axes):
                return [value[axis] for axis in axes]
    return None
