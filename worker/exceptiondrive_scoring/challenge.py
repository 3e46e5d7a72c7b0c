"""The challenges behind one interface, so that no caller branches on the challenge.

Answers and measurements pass as columns (named arrays over samples): what an upload reader makes,
what a store keeps, and what every function here takes.
"""

import typing
from collections.abc import Iterator, Mapping, Sequence
from pkgutil import resolve_name
from typing import Any

from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import Challenge, ChallengeId
from exceptiondrive_schemas.check import CheckedDocument
from exceptiondrive_schemas.check.rules import SCORED_BY
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    ClearanceCurve,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.plausibility import OfControls
from exceptiondrive_scoring.sheet import Row, aggregate
from exceptiondrive_scoring.similarity import AlikeRule


class ChallengeScoring(typing.Protocol):
    """Measure, grade and what is published beside the score."""

    @property
    def challenge(self) -> Challenge:
        """Metrics in column order."""

    @property
    def alike(self) -> AlikeRule | None:
        """When two submissions are alike; None: they are not compared."""

    def columns(
        self, document: CheckedDocument, sample_ids: Sequence[str]
    ) -> dict[str, NDArray[Any]]:
        """The answers of a sound file, one row per sample, in the order of `sample_ids`."""

    def measure(
        self, answers: Columns, split: SplitArrays, geometry: GeometrySection
    ) -> dict[str, NDArray[Any]]:
        """Columns that depend on answers, regions and geometry alone: kept by content."""

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> SampleScores:
        """Metric values of each sample, (N, M)."""

    def of_controls(self, answers: Columns, protocol: ProtocolDocument) -> OfControls:
        """Metrics over the controls, for the total, and flags; from the answers about them alone."""

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of samples answered: `edited`, and `source` where there is one."""

    def plausibility(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> Plausibility:
        """Shares and flags."""

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> dict[str, MetricRow]:
        """Further named rows of the score sheet."""

    def clearance_curve(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> ClearanceCurve | None:
        """Share of samples by what they keep of the required clearance; None without clearances."""

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ProtocolDocument,
    ) -> EntryDrawings | None:
        """Pictures of some samples, regions and all; None where there is nothing to draw."""


class _Scoring(Mapping[ChallengeId, ChallengeScoring]):
    """How each registered challenge is scored; imported when it is asked for."""

    def __getitem__(self, challenge_id: str) -> ChallengeScoring:
        scoring: ChallengeScoring = resolve_name(SCORED_BY[challenge_id])()
        return scoring

    def __iter__(self) -> Iterator[ChallengeId]:
        return iter(SCORED_BY)

    def __len__(self) -> int:
        return len(SCORED_BY)


SCORING: Mapping[ChallengeId, ChallengeScoring] = _Scoring()


def document_columns(
    document: CheckedDocument, sample_ids: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return the answers of a sound file, one row per sample, in the order of `sample_ids`.

    Raises:
        KeyError: The file has no prediction for one of the samples.
    """
    return SCORING[document.challenge].columns(document, sample_ids)


def exact_sheet(
    scoring: ChallengeScoring,
    measured: Columns,
    split: SplitArrays,
    split_ref: SplitRef,
    protocol: ProtocolDocument,
    of_controls: OfControls | None = None,
) -> ScoreSheet:
    """Grade and aggregate measurements (docs/protocol.md section 3); nothing is rounded.

    Args:
        scoring: Of the challenge.
        measured: Of the samples that count.
        split: The same samples.
        split_ref: Name and revision of the split.
        protocol: Everything besides.
        of_controls: What `scoring.of_controls` says, where the split has controls.
    """
    scores = scoring.grade(measured, split, protocol)
    breakdown = aggregate(scores, split, protocol.taxonomy)
    coverage = scoring.coverage(measured)
    edited, source = coverage["edited"] or 0.0, coverage.get("source")
    said = of_controls or OfControls({})
    plausibility = scoring.plausibility(measured, split, protocol)
    return ScoreSheet(
        challenge=scoring.challenge.id,
        protocol=ProtocolRef(version=protocol.version, digest=protocol.digest),
        split=split_ref,
        scorer_version=SCORER_VERSION,
        n=breakdown.n,
        coverage=Coverage(
            edited=edited,
            source=source,
            n_edited=round(edited * breakdown.n),
            n_source=None if source is None else round(source * breakdown.n),
        ),
        micro=breakdown.micro | said.metrics,
        macro_family=breakdown.macro_family,
        families=_rows(breakdown.families),
        tasks=_rows(breakdown.tasks),
        plausibility=plausibility.model_copy(update={"flags": (*plausibility.flags, *said.flags)}),
        extra=scoring.extra(measured, split, protocol),
        clearance_curve=scoring.clearance_curve(measured, split, protocol),
    )


def _rows(rows: dict[str, Row]) -> dict[str, BreakdownRow]:
    return {key: BreakdownRow.of(row.n, row.metrics) for key, row in rows.items()}
