"""The planning challenge: trajectory pairs against hazard regions (docs/protocol.md sections 1 to 5)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import CheckedDocument, PlanningDocument
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.score_sheet import ClearanceCurve, MetricRow, Plausibility
from exceptiondrive_scoring.aliases import Columns, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.challenge import ChallengeScoring
from exceptiondrive_scoring.grade import (
    Regrading,
    SampleScores,
    clearance_compliance,
    grade,
    kept_clearances,
    progress_of_pairs,
    sample_scores,
)
from exceptiondrive_scoring.measure import Clearances, Measurements, measure
from exceptiondrive_scoring.plausibility import OfControls, plausibility, raised
from exceptiondrive_scoring.sheet import group_means
from exceptiondrive_scoring.similarity import AlikeRule

if TYPE_CHECKING:
    from exceptiondrive_schemas.drawing import EntryDrawings

ROW_PREFIX = "d_safe_x"
BY_CLEARANCE = tuple(PLANNING.metric(key) for key in ("hcc", "hpr", "clear", "close"))


def _edited(answers: Columns) -> FloatArray:
    return np.asarray(answers["edited"], dtype=np.float64)


def _clearances(measurements: Columns) -> Clearances:
    return Clearances(measurements["clearance_m"], measurements["intrusion"])


def _grade_clearances(
    measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
) -> SampleScores:
    by_key = kept_clearances(_clearances(measurements), split, protocol)
    return sample_scores(BY_CLEARANCE, by_key)


class PlanningScoring(ChallengeScoring):
    """Trajectory pairs against hazard regions."""

    challenge = PLANNING
    alike: ClassVar[AlikeRule] = AlikeRule(
        _edited, tolerance=0.05, equal_share=0.9, mean_distance=0.25, may_be_scaled=True
    )
    regrading: ClassVar[Regrading] = Regrading(
        columns=("clearance_m", "intrusion"),
        metrics=BY_CLEARANCE,
        places=tuple(PLANNING.metrics.index(metric) for metric in BY_CLEARANCE),
        grade=_grade_clearances,
    )

    def columns(self, document: CheckedDocument, sample_ids: Sequence[str]) -> Columns:
        """The trajectories of a sound file: `source` and `edited`, (N, T, 2) metres."""
        assert isinstance(document, PlanningDocument)
        shape = (len(sample_ids), document.n_waypoints, 2)
        flat = document.columns(sample_ids)
        return {side: np.frombuffer(flat[side]).reshape(shape) for side in flat}

    def measure(self, answers: Columns, split: SplitArrays, geometry: GeometrySection) -> Columns:
        """Clearance, intrusion, shift, motion; from the columns `source` and `edited`."""
        pairs = TrajectoryPairs.from_columns(answers)
        return measure(pairs, split.prepared_regions, geometry, split.recorded_m).columns()

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> SampleScores:
        """HCC, UR, HPR, the CTS, progress, outcome and source fit of each sample."""
        return grade(Measurements.from_columns(measurements), split, protocol)

    def of_controls(self, answers: Columns, protocol: ProtocolDocument) -> OfControls:
        """Over-caution: the share that hardly progress, of the controls whose progress is defined.

        The flag needs enough controls in the split, not enough with defined progress: a file that
        stands still in both inputs has few of those, and is judged by these few.
        """
        section = protocol.plausibility
        share = progress_of_pairs(TrajectoryPairs.from_columns(answers), section)
        n_controls, share = len(share), share[~np.isnan(share)]
        if not len(share):
            return OfControls({"over_caution": None})
        held_back = float(np.mean(share < section.over_caution_below))
        is_flagged = (
            held_back > section.flag_over_caution and n_controls >= section.flag_family_min_samples
        )
        detail = (
            f"At {share_past(held_back, section.flag_over_caution)} of the controls, where no hazard is in "
            f"the way, the edited trajectories end less than {100 * section.over_caution_below:g}% along "
            "the source."
        )
        flags = (raised("over_cautious", detail),) if is_flagged else ()
        return OfControls({"over_caution": held_back}, flags)

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of edited and of source trajectories given."""
        return {
            "edited": float(np.mean(measurements["edited_given"])),
            "source": float(np.mean(measurements["source_given"])),
        }

    def plausibility(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> Plausibility:
        """Shares of docs/protocol.md section 5."""
        return plausibility(Measurements.from_columns(measurements), split, protocol)

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> dict[str, MetricRow]:
        """HCC with other required clearances."""
        return clearance_sensitivity(_clearances(measurements), split, protocol)

    def clearance_curve(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> ClearanceCurve | None:
        """Share of samples that keep at least each multiple of the required clearance."""
        return clearance_curve(_clearances(measurements), split, protocol)

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ProtocolDocument,
    ) -> "EntryDrawings | None":
        """The scene of each family with the worst and the median sample of the entry."""
        from exceptiondrive_scoring.drawing import Drawer

        pairs = TrajectoryPairs.from_columns(answers)
        measured = Measurements.from_columns(measurements)
        return Drawer(sample_ids, pairs, measured, split, protocol).chosen()


def clearance_sensitivity(
    clearances: Clearances, split: SplitArrays, protocol: ProtocolDocument
) -> dict[str, dict[str, float | None]]:
    """Score HCC with every required clearance multiplied (docs/protocol.md section 3).

    Returns:
        A row for each of `grading.sensitivity_factors`, such as `d_safe_x0.5`, with `hcc_micro` and
        `hcc_macro_family`.
    """
    factors = protocol.grading.sensitivity_factors
    if not factors:
        return {}
    required_m = split.d_safe_m * protocol.grading.d_safe_scale
    by_factor = [
        clearance_compliance(clearances.clearance_m, clearances.intrusion, required_m * factor)
        for factor in factors
    ]
    scores = SampleScores((PLANNING.metric("hcc"),) * len(factors), np.array(by_factor).T)
    *_, micro, macro_family = group_means(scores, split).tolist()
    return {
        f"{ROW_PREFIX}{factor:g}": {"hcc_micro": total, "hcc_macro_family": mean}
        for factor, total, mean in zip(factors, micro, macro_family, strict=True)
    }


def clearance_curve(
    clearances: Clearances, split: SplitArrays, protocol: ProtocolDocument
) -> ClearanceCurve:
    """Count samples by the share of the required clearance they keep (docs/protocol.md section 9).

    At 0 it is 1 - UR and at 1 the share `clear`. HCC is its area from 0 to 1: by the trapezoidal
    rule to within half a step of the share `close`.
    """
    step, until = protocol.grading.clearance_curve_step, protocol.grading.clearance_curve_until
    edges = np.arange(round(until / step) + 1) * step
    kept = clearances.clearance_m / (split.d_safe_m * protocol.grading.d_safe_scale)
    n_reached = np.where(clearances.intrusion, 0, np.searchsorted(edges, kept, side="right"))
    n_families, n_bins = len(protocol.families), len(edges) + 1
    cell = split.family_index * n_bins + n_reached
    in_bin = np.bincount(cell, minlength=n_families * n_bins).reshape(n_families, n_bins)
    reached = in_bin[:, ::-1].cumsum(axis=1)[:, ::-1]  # all samples, then those at each edge
    total = reached.sum(axis=0)
    reached = reached[reached[:, 0] > 0]
    by_family = reached[:, 1:] / reached[:, :1]
    return ClearanceCurve(
        step=step,
        micro=tuple((total[1:] / total[0]).tolist()),
        macro_family=tuple(by_family.mean(axis=0).tolist()),
    )
