"""From measurements to the exact score sheet: one assembly for worker and `evaluate`."""

from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    Flag,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.challenge import ChallengeScoring
from exceptiondrive_scoring.sheet import Row, aggregate


def exact_sheet(
    scoring: ChallengeScoring,
    measured: Columns,
    split: SplitArrays,
    split_ref: SplitRef,
    protocol: Protocol,
) -> ScoreSheet:
    """Grade and aggregate measurements (docs/protocol.md section 3); nothing is rounded."""
    scores = scoring.grade(measured, split, protocol)
    breakdown = aggregate(scores, split, protocol.taxonomy)
    coverage = scoring.coverage(measured)
    plausibility = scoring.plausibility(measured, protocol)
    return ScoreSheet(
        challenge=scoring.challenge.id.value,
        protocol=ProtocolRef(version=protocol.version, digest=protocol.digest),
        split=split_ref,
        scorer_version=SCORER_VERSION,
        n=breakdown.n,
        coverage=Coverage(edited=coverage["edited"] or 0.0, source=coverage["source"]),
        micro=breakdown.micro,
        macro_family=breakdown.macro_family,
        families=_rows(breakdown.families),
        tasks=_rows(breakdown.tasks),
        plausibility=Plausibility(
            shares=plausibility.shares,
            flags=tuple(
                Flag(code=flag.code, label=flag.label, detail=flag.detail)
                for flag in plausibility.flags
            ),
        ),
        extra=scoring.extra(measured, split, protocol),
    )


def _rows(rows: dict[str, Row]) -> dict[str, BreakdownRow]:
    return {key: BreakdownRow.of(row.n, row.metrics) for key, row in rows.items()}
