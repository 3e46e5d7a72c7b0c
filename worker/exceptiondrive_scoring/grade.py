"""Grade: measurements to metric values of each sample. No geometry, no uploads."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.challenges import PLANNING, Metric
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.measure import Measurements


@dataclass(frozen=True)
class SampleScores:
    """Metric values of each sample. Withheld: only their aggregates are published.

    Attributes:
        metrics: M metrics, in column order: all those of a challenge, or some.
        values: (N, M); NaN where undefined.
    """

    metrics: tuple[Metric, ...]
    values: FloatArray

    @property
    def metric_keys(self) -> tuple[str, ...]:
        """Keys of the M metrics."""
        return tuple(metric.key for metric in self.metrics)

    @property
    def defined(self) -> BoolArray:
        """(N, M) whether the value is defined."""
        return ~np.isnan(self.values)


def clearance_compliance(
    clearance_m: FloatArray, intrusion: BoolArray, d_safe_m: FloatArray
) -> FloatArray:
    """HCC_i = (1 - ur_i) min(d_i / d_safe, 1), the paper's HCC term; (N,)."""
    return np.where(intrusion, 0.0, np.minimum(clearance_m / d_safe_m, 1.0))


def proximity_response(
    clearance_m: FloatArray, intrusion: BoolArray, d_safe_m: FloatArray
) -> FloatArray:
    """HPR_i = (1 - ur_i) d_safe / (|d_i - d_safe| + d_safe), the paper's HPR term; (N,)."""
    return np.where(intrusion, 0.0, d_safe_m / (np.abs(clearance_m - d_safe_m) + d_safe_m))


def grade(
    measurements: Measurements, split: SplitArrays, protocol: ProtocolDocument
) -> SampleScores:
    """Grade measurements of the planning challenge (docs/protocol.md section 3).

    A missing edited trajectory is an intrusion; a missing source leaves the shift undefined.
    """
    required_m = split.d_safe_m * protocol.grading.d_safe_scale
    clearance, intrusion = measurements.clearance_m, measurements.intrusion
    by_key: dict[str, FloatArray | BoolArray] = {
        "hcc": clearance_compliance(clearance, intrusion, required_m),
        "ur": intrusion,
        "hpr": proximity_response(clearance, intrusion, required_m),
        "cts": measurements.shift_m,
        "cts_x": measurements.shift_x_m,
        "cts_y": measurements.shift_y_m,
    }
    return sample_scores(PLANNING.metrics, by_key)


def sample_scores(
    metrics: tuple[Metric, ...], by_key: Mapping[str, FloatArray | BoolArray]
) -> SampleScores:
    """Put the columns of all metrics, each (N,), into one array, column by column in memory."""
    columns = np.array([by_key[metric.key] for metric in metrics], dtype=np.float64)
    return SampleScores(metrics, columns.T)
