"""Rounding for publication: no digit leaves the worker that the protocol does not publish.

Exact values stay in the private store. A score sheet is rounded once, here, and everything that
is shown, ranked or sorted is computed from the rounded one.
"""

import math
from collections.abc import Collection
from typing import Self

from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    ClearanceCurve,
    Interval,
    MetricRow,
    ScoreSheet,
)
from exceptiondrive_scoring.bootstrap import SAME_TO
from exceptiondrive_worker.stages import Target


class Rounding:
    """Rounds values of one challenge by the protocol's publication section.

    On a withheld split, whose regions are not public, intervals of shares are published in whole
    per cents: they are further readings of the same samples, and finer ones would reveal more than
    the bounds of docs/leakage.md count.
    """

    def __init__(
        self,
        challenge: Challenge,
        publication: PublicationSection,
        *,
        is_public: bool = False,
        has_public_drives: bool = False,
    ) -> None:
        self.is_public = is_public
        self._has_public_drives = has_public_drives
        self._publication = publication
        self._fraction_decimals = publication.percent_decimals + 2
        self._metrics: dict[str, Metric] = {metric.key: metric for metric in challenge.metrics}
        self._in_metres = {metric.key for metric in challenge.metrics if metric.unit == "metre"}

    @classmethod
    def of(cls, target: Target, *, is_public: bool) -> Self:
        """Return the rounding for the sheet of a target, whose split is public or withheld."""
        has_drives = target.split.manifest.recorded is not None
        publication = target.protocol.publication
        return cls(target.challenge, publication, is_public=is_public, has_public_drives=has_drives)

    def fraction(self, value: float | None) -> float | None:
        """Round a share; None stays None, and there is no negative zero."""
        return None if value is None else _rounded(value, self._fraction_decimals)

    def metric(self, key: str, value: float | None) -> float | None:
        """Round a value of a metric; keys that are not metrics hold shares."""
        return None if value is None else _rounded(value, self._decimals(key))

    def row(self, metrics: MetricRow) -> MetricRow:
        """Round a row of metrics."""
        return {key: self.metric(key, value) for key, value in metrics.items()}

    def counted_row(self, row: MetricRow) -> MetricRow:
        """Round a further row; of one that counts too few samples only `n` is kept."""
        n = row.get("n")
        if n is not None and n < self._publication.min_samples_per_cell:
            return dict.fromkeys(row) | {"n": n}
        return self.row(row)

    def interval(self, key: str, interval: Interval | None) -> Interval | None:
        """Round both ends of an interval of a metric."""
        if interval is None:
            return None
        if not self.is_public and key not in self._in_metres:
            return self.coarse_interval(interval)
        low, high = (_rounded(end, self._decimals(key)) for end in interval)
        return low, high

    def coarse_interval(self, interval: Interval | None) -> Interval | None:
        """Round an interval of shares outward to whole per cents: it may only grow."""
        if interval is None:
            return None
        low, high = interval
        return (math.floor(100 * (low + SAME_TO)) / 100, math.ceil(100 * (high - SAME_TO)) / 100)

    def cell(self, row: BreakdownRow, told: Collection[str]) -> BreakdownRow:
        """Round a family or task; below the least number of samples its metrics are withheld.

        `told` are the kinds of `Metric.cells` that are published for this split.
        """
        metrics = row.metrics
        if row.n is not None and row.n < self._publication.min_samples_per_cell:
            return row.model_copy(update=dict.fromkeys(metrics))
        hidden = {key for key, metric in self._metrics.items() if metric.cells not in told}
        return row.model_copy(update=self.row(metrics) | dict.fromkeys(metrics.keys() & hidden))

    def sheet(self, sheet: ScoreSheet) -> ScoreSheet:
        """Return what may be published of an exact sheet."""
        publication, told, is_public = self._publication, {"always"}, self.is_public
        if publication.shows_outcome_cells(is_public_split=is_public):
            told.add("of public regions")
        if is_public or self._has_public_drives:
            told.add("of public drives")
        with_curve = publication.shows_curve(is_public_split=is_public)
        coverage, plausibility = sheet.coverage, sheet.plausibility
        return sheet.model_copy(
            update={
                "coverage": coverage.model_copy(
                    update={
                        "edited": self.fraction(coverage.edited),
                        "source": self.fraction(coverage.source),
                    }
                ),
                "micro": self.row(sheet.micro),
                "macro_family": self.row(sheet.macro_family),
                "families": {key: self.cell(row, told) for key, row in sheet.families.items()},
                "tasks": {key: self.cell(row, told) for key, row in sheet.tasks.items()},
                "plausibility": plausibility.model_copy(
                    update={"shares": {k: self.fraction(v) for k, v in plausibility.shares.items()}}
                ),
                "extra": {key: self.counted_row(row) for key, row in sheet.extra.items()},
                "clearance_curve": self._curve(sheet.clearance_curve) if with_curve else None,
            }
        )

    def _decimals(self, key: str) -> int:
        return (
            self._publication.metre_decimals if key in self._in_metres else self._fraction_decimals
        )

    def _curve(self, curve: ClearanceCurve | None) -> ClearanceCurve | None:
        if curve is None:
            return None
        rounded = {
            key: tuple(map(self.fraction, getattr(curve, key))) for key in ("micro", "macro_family")
        }
        return curve.model_copy(update=rounded)


def _rounded(value: float, decimals: int) -> float:
    return round(value, decimals) + 0.0  # adding zero turns -0.0 into 0.0
