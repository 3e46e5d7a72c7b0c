"""Grade: turn measurements into metric values of each sample. No geometry, no uploads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.challenges import PLANNING, Metric
from exceptiondrive_schemas.protocol import PlausibilitySection, ProtocolDocument
from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.kinematics import PathFit, positions_of_waypoints, progress_along, steps
from exceptiondrive_scoring.measure import Clearances, Measurements


@dataclass(frozen=True)
class SampleScores:
    """Metric values of each sample. Withheld: only their aggregates are published.

    Attributes:
        metrics: M metrics, in column order: all those of a challenge, or a subset.
        values: (N, M); NaN where undefined.
    """

    metrics: tuple[Metric, ...]
    values: FloatArray

    @property
    def metric_keys(self) -> tuple[str, ...]:
        """Keys of the M metrics."""
        return tuple(metric.key for metric in self.metrics)

    def only(self, metrics: Sequence[Metric]) -> "SampleScores":
        """Return the scores restricted to these metrics, in this order."""
        columns = [self.metric_keys.index(metric.key) for metric in metrics]
        return SampleScores(tuple(metrics), self.values[:, columns])

    @property
    def defined(self) -> BoolArray:
        """(N, M) whether each value is defined."""
        return ~np.isnan(self.values)


@dataclass(frozen=True)
class Regrading:
    """How to grade again under new required clearances, from few measurements.

    Everything else in a sheet follows from the measurements, the plausibility section, and the task
    and family of each sample, and is cached under those alone.

    Attributes:
        columns: The measurements that `grade`, `extra` and `clearance_curve` read.
        metrics: The metrics that depend on required clearances.
        places: Their positions among the metrics of the challenge.
        grade: Computes their values from these columns, bit for bit as when all metrics are graded.
    """

    columns: tuple[str, ...]
    metrics: tuple[Metric, ...]
    places: tuple[int, ...]
    grade: Callable[[Columns, SplitArrays, ProtocolDocument], SampleScores]


def clearance_compliance(
    clearance_m: FloatArray, intrusion: BoolArray, d_safe_m: FloatArray
) -> FloatArray:
    """HCC_i = (1 - ur_i) min(d_i / d_safe, 1), the paper's HCC term; (N,)."""
    kept = clearance_m / d_safe_m
    np.minimum(kept, 1.0, out=kept)
    np.putmask(kept, intrusion, 0.0)
    return kept


def proximity_response(
    clearance_m: FloatArray, intrusion: BoolArray, d_safe_m: FloatArray
) -> FloatArray:
    """HPR_i = (1 - ur_i) d_safe / (|d_i - d_safe| + d_safe), the paper's HPR term; (N,)."""
    response = clearance_m - d_safe_m
    np.abs(response, out=response)
    response += d_safe_m
    np.divide(d_safe_m, response, out=response)
    np.putmask(response, intrusion, 0.0)
    return response


def progress(
    reached_m: FloatArray, path_m: FloatArray, edited_given: BoolArray, section: PlausibilitySection
) -> FloatArray:
    """Share of its source path that each edited trajectory completes (docs/protocol.md section 9).

    Args:
        reached_m: (N,) arc length at which the edited end lies on the source path.
        path_m: (N,) length of that path, NaN where missing.
        edited_given: (N,).
        section: Holds the shortest path for which progress is defined.

    Returns:
        (N,) in [0, 1]; 0 where edited is missing, NaN where the source is missing or too short.
    """
    share = np.full(len(path_m), np.nan)
    has_path = path_m >= section.progress_min_path_m
    np.divide(reached_m, path_m, out=share, where=has_path & edited_given)
    share[has_path & ~edited_given] = 0.0
    return np.clip(share, 0.0, 1.0, out=share)


def measured_progress(measurements: Measurements, section: PlausibilitySection) -> FloatArray:
    """Return the progress of measured trajectories; (N,)."""
    m = measurements
    return progress(m.reached_m, m.source_path_m, m.edited_given, section)


def source_fit(measurements: Measurements) -> dict[str, FloatArray]:
    """Return the distances from the recorded paths by metric; NaN where there are none."""
    unknown = np.full(len(measurements.clearance_m), np.nan)
    known = {key: getattr(measurements, key) for key in PathFit._fields}
    return {key: unknown if gaps is None else gaps for key, gaps in known.items()}


def progress_of_pairs(pairs: TrajectoryPairs, section: PlausibilitySection) -> FloatArray:
    """Return the progress of trajectories that are not measured against a region; (N,)."""
    source, edited = (positions_of_waypoints(each) for each in (pairs.source, pairs.edited))
    reached_m, path_m = progress_along(source, steps(source), edited.x_m[-1], edited.y_m[-1])
    return progress(reached_m, path_m, pairs.edited_given, section)


def grade(
    measurements: Measurements, split: SplitArrays, protocol: ProtocolDocument
) -> SampleScores:
    """Grade measurements of the planning challenge (docs/protocol.md sections 3 and 9).

    A missing edited trajectory is an intrusion; a missing source leaves the shift undefined.
    """
    intrusion = measurements.intrusion
    has_reacted = measurements.shift_m >= protocol.plausibility.reaction_shift_m
    by_key: dict[str, FloatArray | BoolArray] = {
        **kept_clearances(measurements, split, protocol),
        "ur": intrusion,
        "cts": measurements.shift_m,
        "cts_x": measurements.shift_x_m,
        "cts_y": measurements.shift_y_m,
        "progress": measured_progress(measurements, protocol.plausibility),
        "hit_reacting": intrusion & has_reacted,
        "hit_unmoved": intrusion & ~has_reacted,
        **source_fit(measurements),
    }
    return sample_scores(PLANNING.metrics, by_key)


def kept_clearances(
    clearances: Clearances, split: SplitArrays, protocol: ProtocolDocument
) -> dict[str, FloatArray | BoolArray]:
    """Return the metrics that depend on required clearances, each (N,)."""
    required_m = split.d_safe_m * protocol.grading.d_safe_scale
    clearance_m, intrusion = clearances.clearance_m, clearances.intrusion
    is_clear = ~intrusion
    is_kept = is_clear & (clearance_m >= required_m)
    return {
        "hcc": clearance_compliance(clearance_m, intrusion, required_m),
        "hpr": proximity_response(clearance_m, intrusion, required_m),
        "clear": is_kept,
        "close": is_clear & ~is_kept,
    }


def sample_scores(
    metrics: tuple[Metric, ...], by_key: Mapping[str, FloatArray | BoolArray]
) -> SampleScores:
    """Combine the columns of all metrics, each (N,), into one array in column-major order."""
    columns = np.array([by_key[metric.key] for metric in metrics], dtype=np.float64)
    return SampleScores(metrics, columns.T)
