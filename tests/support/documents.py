"""The manifest of a small split, and a score sheet on it: documents of several folders' tests."""

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import Manifest, SplitRef

REVISION = "sha256:" + "5" * 64


def make_manifest(name: str = "sample", revision: str = REVISION) -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name=name,
        title="Sample",
        revision=revision,
        waypoints=6,
        time_step_s=0.5,
        sample_ids=("s1", "s2", "s3"),
    )


def make_sheet(protocol_digest: str, row: MetricRow) -> ScoreSheet:
    """A sheet whose every aggregate says the same."""
    return ScoreSheet(
        challenge=PLANNING.id,
        protocol=ProtocolRef(version="1.0", digest=protocol_digest),
        split=SplitRef(name="sample", revision=REVISION),
        scorer_version="1",
        n=3,
        coverage=Coverage(edited=1.0, source=1.0),
        micro=row,
        macro_family=row,
        families={"sudden_emergence": BreakdownRow.of(3, row)},
        tasks={},
        plausibility=Plausibility(shares={"blind": 0.0}),
    )
