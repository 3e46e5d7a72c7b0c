"""Format numbers and times for pages: digits, units, minus signs, plurals; positions on a scale."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, lru_cache, partial

from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.printable import MINUS, counted, decimal_text
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_schemas.score_sheet import Interval, is_whole_percent

THIN_SPACE = "\u202f"
DASH = "\u2013"
MUCH_NEARER = 1.5
"""So many times as far the other end of an interval lies."""
_UNITS = {"fraction": "%", "metre": "m"}


@dataclass(frozen=True)
class Digits:
    """How many decimals leave the server, from the protocol's publication section."""

    percent: int = 2
    metre: int = 2
    has_fine_intervals: bool = False
    """Whether intervals beside each other are told finer than to whole per cents."""

    @classmethod
    def of(cls, publication: PublicationSection, *, has_fine_intervals: bool = False) -> "Digits":
        """Return the digits that a protocol publishes."""
        decimals = publication.percent_decimals, publication.metre_decimals
        return cls(*decimals, has_fine_intervals)

    def text(self, metric: Metric, value: float | None) -> str | None:
        """Write a published metric without its unit; None stays None (undefined is never zero)."""
        if value is None:
            return None
        if metric.unit == "fraction":
            return fixed(100 * value, self.percent)
        return fixed(value, self.metre)

    @cached_property
    def briefly(self) -> "Digits":
        """Those of a row among many: per cent with one decimal, metres as published."""
        return Digits(min(self.percent, 1), self.metre)

    def brief(self, metric: Metric, value: float | None) -> str | None:
        """Write a metric for a row among many."""
        return self.briefly.text(metric, value)

    def spread(self, metric: Metric, value: float, interval: Interval) -> str:
        """Write how far an interval reaches from its value: `±2.1`, to the end that is farther.

        Where the other end is much nearer, or no value lies that far, both ways are told: `−12.0 +0.5`;
        where it reaches to one side alone, as from zero, that one.
        """
        below, above = value - interval[0], interval[1] - value
        near, far = (below, above) if below < above else (above, below)
        text = self.briefly.text
        least = 10.0 ** -(self.percent + 2 if metric.unit == "fraction" else self.metre) / 2
        if near < least <= far:
            return f"{'+' if far == above else MINUS}{text(metric, far)}"
        is_within = metric.unit == "metre" or far <= value <= 1 - far
        if far < least or (is_within and far <= MUCH_NEARER * near):
            return f"±{text(metric, far)}"
        low, high = text(metric, below), text(metric, above)
        return f"±{high}" if low == high else f"{MINUS}{low} +{high}"

    def fraction(self, value: float) -> str:
        """Write a fraction as per cent, without the sign."""
        return fixed(value * 100, self.percent)

    def signed(self, metric: Metric, difference: float | None) -> str:
        """Write a difference with its sign: per cent points or metres; nothing where it is unknown."""
        text = self.text(metric, abs(difference)) if difference is not None else None
        if difference is None or text is None:
            return ""
        if not text.strip("0."):
            return text
        return f"{'+' if difference > 0 else MINUS}{text}"

    def difference(self, metric: Metric, a: float | None, b: float | None) -> str:
        """Write `a` minus `b` with its sign; nothing where one of the two is unknown."""
        return self.signed(metric, None if a is None or b is None else a - b)

    def interval(self, metric: Metric, interval: Interval | None, *, signed: bool = False) -> str:
        """Write `57.30 to 65.50`; nothing where no interval is known.

        One that was rounded to whole per cents, as of withheld splits, claims no decimals, but where
        others beside it have them.
        """
        if interval is None:
            return ""
        is_coarse = not self.has_fine_intervals and all(map(is_whole_percent, interval))
        digits = _WHOLE if is_coarse and metric.unit == "fraction" else self
        write = digits.signed if signed else digits.text
        return " to ".join([write(metric, end) or "" for end in interval])

    def best(self, metric: Metric, values: Iterable[float | None]) -> str | None:
        """Return the best of some values; None if none is known or the metric has no better direction."""
        known = [value for value in values if value is not None]
        if not known or metric.better is None:
            return None
        return self.text(metric, max(known) if metric.better == "higher" else min(known))


_WHOLE = Digits(percent=0)


def unit_of(metric: Metric) -> str:
    """Return the unit in which a metric is written."""
    return _UNITS[metric.unit]


def heading(metric: Metric) -> str:
    """Return the column heading of a metric: `HCC %`."""
    return f"{metric.label} {unit_of(metric)}"


def with_unit(metric: Metric, text: str) -> str:
    """Put the unit behind a written number."""
    return f"{text}{THIN_SPACE}{unit_of(metric)}"


@lru_cache(maxsize=64)  # each interval of a board asks
def percent(share: float) -> str:
    """Write a share that somebody set, such as that of intervals: `95 %`."""
    return f"{100 * share:g}{THIN_SPACE}%"


fixed = partial(decimal_text, minus=MINUS)
"""Write a number with so many decimals and a real minus sign."""


def grouped(count: int) -> str:
    """Write a count with thousands separated."""
    return f"{count:,}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """Write `a, b and c`."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def day(moment: datetime) -> str:
    """Write a date: `21 Nov 2026`."""
    at = moment.astimezone(UTC)
    return f"{at.day} {at:%b %Y}"


def minute(moment: datetime) -> str:
    """Write a moment: `21 Nov 2026, 14:05 UTC`."""
    return f"{day(moment)}, {moment.astimezone(UTC):%H:%M} UTC"


def iso(moment: datetime) -> str:
    """Write a moment for machines."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def short_digest(digest: str) -> str:
    """Return the first twelve hex digits of a digest."""
    return digest.removeprefix("sha256:")[:12]


def slug(text: str) -> str:
    """Return `text` as a name for an address: lower case letters, digits and hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "entry"


def size_text(size_bytes: int) -> str:
    """Write a size: `812 bytes`, `1.4 kB`, `2.0 MB`."""
    if size_bytes < 1000:
        return counted(size_bytes, "byte")
    if round(size_bytes / 1000, 1) < 1000:
        return f"{size_bytes / 1000:.1f} kB"
    return f"{size_bytes / 1_000_000:.1f} MB"


# Scales: from values to positions in an SVG, with round ticks.

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

    The domain holds `include` too, and never goes below `floor` or above `ceiling`; without values
    it is (0, 1). `extent` has the positions of the two ends.
    """
    wanted = [*values, *include] or [0.0, 1.0]
    low, high = min(wanted), max(wanted)
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    step = max(_round_step((high - low) / max(n_ticks - 1, 1)), _FINEST_STEP)
    first, last = math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step
    first = first if floor is None else max(first, floor)
    last = last if ceiling is None else min(last, ceiling)
    start = math.ceil(first / step - 1e-9) * step
    count = math.floor((last - start) / step + 1e-9)
    ticks = tuple(round(start + index * step, 10) for index in range(count + 1))
    return Scale(domain=(first, last), extent=extent, ticks=ticks)


def _round_step(raw: float) -> float:
    power = 10.0 ** math.floor(math.log10(raw))
    return next(step * power for step in _STEPS if step * power >= raw * 0.999999)


def px(value: float) -> str:
    """Write a coordinate: one decimal, no trailing zero."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text
