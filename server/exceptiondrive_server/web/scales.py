"""Scales: from values to positions in an SVG, with round ticks."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_FINEST_STEP = 0.0001
"""Four decimals write every tick apart from the next."""


@dataclass(frozen=True)
class Scale:
    """A linear map of `domain` onto `extent`, with round ticks inside the domain."""

    domain: tuple[float, float]
    extent: tuple[float, float]
    ticks: tuple[float, ...]

    def at(self, value: float) -> float:
        """Position of a value; values outside the domain fall outside the extent."""
        low, high = self.domain
        start, end = self.extent
        return start + (value - low) / (high - low) * (end - start)

    def clamped(self, value: float) -> float:
        """Position of a value, held inside the extent."""
        low, high = self.domain
        return self.at(min(max(value, low), high))

    def holds(self, value: float) -> bool:
        """Whether a value lies inside the domain."""
        return self.domain[0] <= value <= self.domain[1]

    @property
    def tick_decimals(self) -> int:
        """Decimals that write every tick exactly, at most four."""
        return next((n for n in range(4) if all(_is_whole(tick * 10**n) for tick in self.ticks)), 4)


def _is_whole(value: float) -> bool:
    return math.isclose(value, round(value), abs_tol=1e-6)


def nice_scale(
    values: Iterable[float],
    extent: tuple[float, float],
    *,
    n_ticks: int = 5,
    floor: float | None = None,
    ceiling: float | None = None,
    include: Iterable[float] = (),
) -> Scale:
    """Return a scale that holds all values, with round ends.

    Args:
        values: What must fit; none gives the domain (0, 1).
        extent: Positions of the two ends.
        n_ticks: About how many ticks are wanted.
        floor: The domain never goes below this.
        ceiling: The domain never goes above this.
        include: Further values that the domain must hold.
    """
    wanted = [*values, *include] or [0.0, 1.0]
    low, high = min(wanted), max(wanted)
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    step = max(_round_step((high - low) / max(n_ticks - 1, 1)), _FINEST_STEP)
    first, last = math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step
    first = first if floor is None else max(first, floor)
    last = last if ceiling is None else min(last, ceiling)
    count = math.floor((last - math.ceil(first / step - 1e-9) * step) / step + 1e-9)
    start = math.ceil(first / step - 1e-9) * step
    ticks = tuple(round(start + index * step, 10) for index in range(count + 1))
    return Scale(domain=(first, last), extent=extent, ticks=ticks)


def _round_step(raw: float) -> float:
    power = 10.0 ** math.floor(math.log10(raw))
    return next(step * power for step in _STEPS if step * power >= raw * 0.999999)


def px(value: float) -> str:
    """Write a coordinate: one decimal, no trailing zero."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text
