"""Grade: measurements to metric values of each sample. No geometry, no uploads."""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.measure import Measurements


@dataclass(frozen=True)
class SampleScores:
    """Metric values of each sample. Withheld: only their aggregates are published.

    Attributes:
        metric_keys: The challenge's M metrics, in column order.
        values: (N, M); NaN where undefined.
    """

    metric_keys: tuple[str, ...]
    values: FloatArray

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


def grade(measurements: Measurements, split: SplitArrays, protocol: Protocol) -> SampleScores:
    """Grade measurements of the planning challenge (PROTOCOL.md section 3).

    A missing edited trajectory is an intrusion; a missing source leaves the shift undefined.
    """
    required_m = split.d_safe_m * protocol.grading.d_safe_scale
    clearance, intrusion = measurements.clearance_m, measurements.intrusion
    by_key = {
        "hcc": clearance_compliance(clearance, intrusion, required_m),
        "ur": intrusion.astype(np.float64),
        "hpr": proximity_response(clearance, intrusion, required_m),
        "cts": measurements.shift_m,
        "cts_x": measurements.shift_x_m,
        "cts_y": measurements.shift_y_m,
    }
    keys = PLANNING.metric_keys
    return SampleScores(keys, np.stack([by_key[key] for key in keys], axis=1))
