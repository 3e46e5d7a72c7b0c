"""Sensitivity: HCC as it would be with other required clearances. Published, never ranked."""

from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores, clearance_compliance, sample_scores
from exceptiondrive_scoring.measure import Measurements
from exceptiondrive_scoring.sheet import aggregate

ROW_PREFIX = "d_safe_x"


def clearance_sensitivity(
    measurements: Measurements, split: SplitArrays, protocol: Protocol
) -> dict[str, dict[str, float | None]]:
    """Score HCC with every required clearance multiplied (docs/protocol.md section 3).

    Returns:
        A row for each of `grading.sensitivity_factors`, such as `d_safe_x0.5`, with `hcc_micro` and
        `hcc_macro_family`.
    """
    rows = {}
    for factor in protocol.grading.sensitivity_factors:
        means = aggregate(_hcc_at(factor, measurements, split, protocol), split, protocol.taxonomy)
        rows[f"{ROW_PREFIX}{factor:g}"] = {
            "hcc_micro": means.micro["hcc"],
            "hcc_macro_family": means.macro_family["hcc"],
        }
    return rows


def _hcc_at(
    factor: float, measurements: Measurements, split: SplitArrays, protocol: Protocol
) -> SampleScores:
    required_m = split.d_safe_m * protocol.grading.d_safe_scale * factor
    hcc = clearance_compliance(measurements.clearance_m, measurements.intrusion, required_m)
    return sample_scores(("hcc",), {"hcc": hcc})
