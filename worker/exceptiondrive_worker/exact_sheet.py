"""From measurements to the exact score sheet: scoring's numbers in the published form."""

import exceptiondrive_scoring
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    Flag,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.challenge import ChallengeScoring
from exceptiondrive_scoring.sheet import Row, aggregate
from exceptiondrive_worker.split_store import LoadedSplit

SCORER_VERSION = exceptiondrive_scoring.SCORER_VERSION
"""Part of the key of kept results: those of older code are left."""


def exact_sheet(
    scoring: ChallengeScoring, measured: Columns, split: LoadedSplit, protocol: Protocol
) -> ScoreSheet:
    """Grade and aggregate measurements; nothing is rounded."""
    scores = scoring.grade(measured, split.arrays, protocol)
    breakdown = aggregate(scores, split.arrays, protocol.taxonomy)
    coverage = scoring.coverage(measured)
    plausibility = scoring.plausibility(measured, protocol)
    return ScoreSheet(
        challenge=scoring.challenge.id.value,
        protocol=ProtocolRef(version=protocol.version, digest=protocol.digest),
        split=split.manifest.ref,
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
        extra=scoring.extra(measured, split.arrays, protocol),
    )


def _rows(rows: dict[str, Row]) -> dict[str, BreakdownRow]:
    return {key: BreakdownRow.of(row.n, row.metrics) for key, row in rows.items()}
