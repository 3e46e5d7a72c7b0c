"""The challenges behind one interface, so that no caller branches on the challenge.

Answers and measurements are passed as columns (named arrays over samples): upload readers make
them, stores keep them, and every function here takes them.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.check import CheckedDocument
from exceptiondrive_schemas.check.rules import SCORED_BY
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.score_sheet import (
    ClearanceCurve,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_scoring.aliases import Columns, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import Regrading, SampleScores
from exceptiondrive_scoring.plausibility import OfControls
from exceptiondrive_scoring.sheet import Breakdown, MetricValues, breakdown, group_means
from exceptiondrive_scoring.similarity import AlikeRule

if TYPE_CHECKING:
    from exceptiondrive_schemas.drawing import EntryDrawings


class ChallengeScoring(ABC):
    """Measure, grade and what is published beside the score; by default nothing is."""

    challenge: ClassVar[Challenge]
    """Metrics in column order."""
    alike: ClassVar[AlikeRule | None] = None
    """When two submissions are alike; None: they are not compared."""
    regrading: ClassVar[Regrading | None] = None
    """How new required clearances are graded from few columns; None: everything is graded anew."""

    @abstractmethod
    def columns(self, document: CheckedDocument, sample_ids: Sequence[str]) -> Columns:
        """The answers of a sound file, one row per sample, in the order of `sample_ids`."""

    @abstractmethod
    def measure(self, answers: Columns, split: SplitArrays, geometry: GeometrySection) -> Columns:
        """Columns that depend on answers, regions and geometry alone; cached by content."""

    @abstractmethod
    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> SampleScores:
        """Metric values of each sample, (N, M)."""

    @abstractmethod
    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of samples answered: `edited`, and `source` where there is one."""

    @abstractmethod
    def plausibility(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> Plausibility:
        """Shares and flags."""

    def of_controls(self, answers: Columns, protocol: ProtocolDocument) -> OfControls:
        """Metrics over the controls, for the total, and flags; from the answers about them alone."""
        return OfControls({})

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> dict[str, MetricRow]:
        """Further named rows of the score sheet."""
        return {}

    def clearance_curve(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> ClearanceCurve | None:
        """Share of samples by the kept part of the required clearance; None without clearances."""
        return None

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ProtocolDocument,
    ) -> "EntryDrawings | None":
        """Pictures of some samples, regions and all; None where there is nothing to draw."""
        return None


def scoring_of(challenge_id: str) -> ChallengeScoring:
    """Return the scoring of a registered challenge; its module is imported on demand.

    Raises:
        UnknownChallengeError: No such challenge is registered.
    """
    scoring: ChallengeScoring = resolve_name(SCORED_BY[challenge_id])()
    return scoring


def document_columns(document: CheckedDocument, sample_ids: Sequence[str]) -> Columns:
    """Return the answers of a sound file, one row per sample, in the order of `sample_ids`.

    Raises:
        KeyError: The file has no prediction for one of the samples.
    """
    return scoring_of(document.challenge).columns(document, sample_ids)


@dataclass(frozen=True)
class Settled:
    """The part of a sheet that does not depend on required clearances, and what does. Withheld.

    Attributes:
        sheet: The sheet without its breakdown; `micro` holds the metrics over the controls.
        means: (R, M) as of `group_means`; NaN for the metrics of the challenge's `regrading`.
        measured: What `regrading`, `extra` and `clearance_curve` read, each (N,); with a
            `regrading`, sorted by task.
    """

    sheet: ScoreSheet
    means: FloatArray
    measured: Columns

    @classmethod
    def from_columns(cls, columns: Columns) -> "Settled":
        """Read what `columns` wrote.

        Raises:
            ValidationError: Another version of the code wrote it.
        """
        measured = dict(columns)
        sheet, means = measured.pop("sheet"), measured.pop("means")
        return cls(ScoreSheet.model_validate_json(sheet.item()), means, measured)

    def columns(self) -> Columns:
        """What a store keeps: `sheet` as JSON, `means`, and the measurements."""
        return {"sheet": np.array(canonical_json(self.sheet)), "means": self.means, **self.measured}


def settle(
    scoring: ChallengeScoring,
    measured: Columns,
    split: SplitArrays,
    split_ref: SplitRef,
    protocol: ProtocolDocument,
    of_controls: OfControls | None = None,
) -> Settled:
    """Grade and aggregate all that does not depend on required clearances; as `exact_sheet`."""
    means = group_means(scoring.grade(measured, split, protocol), split)
    coverage = scoring.coverage(measured)
    edited, source = coverage["edited"] or 0.0, coverage.get("source")
    said = of_controls or OfControls({})
    plausibility = scoring.plausibility(measured, split, protocol)
    sheet = ScoreSheet(
        challenge=scoring.challenge.id,
        protocol=ProtocolRef.of(protocol),
        split=split_ref,
        scorer_version=SCORER_VERSION,
        n=split.n_samples,
        coverage=Coverage(
            edited=edited,
            source=source,
            n_edited=round(edited * split.n_samples),
            n_source=None if source is None else round(source * split.n_samples),
        ),
        micro=said.metrics,
        macro_family={},
        families={},
        tasks={},
        plausibility=plausibility.model_copy(update={"flags": (*plausibility.flags, *said.flags)}),
    )
    if scoring.regrading is not None:
        means[:, scoring.regrading.places] = np.nan
        order = split.by_task.order
        measured = {
            name: measured[name] if order is None else measured[name][order]
            for name in scoring.regrading.columns
        }
    return Settled(sheet, means, measured)


def graded_breakdown(
    scoring: ChallengeScoring, settled: Settled, split: SplitArrays, protocol: ProtocolDocument
) -> Breakdown:
    """Grade and aggregate what depends on required clearances, and merge it with the rest."""
    means, split = settled.means, _as_kept(split, scoring)
    if scoring.regrading is not None:
        scores = scoring.regrading.grade(settled.measured, split, protocol)
        means = means.copy()
        means[:, scoring.regrading.places] = group_means(scores, split)
    return breakdown(scoring.challenge.metrics, means, split, protocol.taxonomy)


def graded_sheet(
    scoring: ChallengeScoring,
    settled: Settled,
    split: SplitArrays,
    split_ref: SplitRef,
    protocol: ProtocolDocument,
) -> ScoreSheet:
    """Build the exact sheet from the settled part and from what depends on required clearances."""
    measured, split = settled.measured, _as_kept(split, scoring)
    found = graded_breakdown(scoring, settled, split, protocol)
    graded = {
        "protocol": ProtocolRef.of(protocol),
        "split": split_ref,
        "micro": found.micro | settled.sheet.micro,
        "macro_family": found.macro_family,
        "families": _rows(found.family_sizes, found.families),
        "tasks": _rows(found.task_sizes, found.tasks),
        "extra": scoring.extra(measured, split, protocol),
        "clearance_curve": scoring.clearance_curve(measured, split, protocol),
    }
    return ScoreSheet.model_validate(dict(settled.sheet) | graded)


def _as_kept(split: SplitArrays, scoring: ChallengeScoring) -> SplitArrays:
    """The split in the order of `Settled.measured`."""
    return split if scoring.regrading is None else split.task_by_task


def exact_sheet(
    scoring: ChallengeScoring,
    measured: Columns,
    split: SplitArrays,
    split_ref: SplitRef,
    protocol: ProtocolDocument,
    of_controls: OfControls | None = None,
) -> ScoreSheet:
    """Grade and aggregate measurements of the samples that count (docs/protocol.md section 3).

    `of_controls` comes from `scoring.of_controls`, if the split has controls. Nothing is rounded.
    """
    settled = settle(scoring, measured, split, split_ref, protocol, of_controls)
    return graded_sheet(scoring, settled, split, split_ref, protocol)


def _rows(
    sizes: Mapping[str, int], values: Mapping[str, MetricValues]
) -> dict[str, dict[str, float | None]]:
    return {key: {"n": n, **values[key]} for key, n in sizes.items()}
