"""One small valid example of every document; all tell the same story of three samples."""

from collections.abc import Callable, Mapping
from datetime import datetime

from exceptiondrive_schemas.api.problems import Problem, ProblemCode
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Board, BoardEntry, FamilyCell, FamilyHead
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.publish.broken_files import file_bytes, report_of
from exceptiondrive_schemas.publish.example_split import (
    example_manifest,
    example_planning,
    example_split,
    example_strategy,
    indented,
)
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)

RECEIVED_AT = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
SCORED_AT = datetime(2026, 3, 2, 9, 30, 2, tzinfo=UTC)
SUBMISSION_ID = "s-example-4f7q"
PHASE, TEAM, METHOD = "planning-example", "Example Team", "Braking planner"


def _row(*values: float | None) -> MetricRow:
    """The paper's metrics; an example need not hold one that came later."""
    return dict(zip(("hcc", "ur", "hpr", "cts", "cts_x", "cts_y"), values, strict=True))


TOTAL = _row(0.3333, 0.6667, 0.169, 2.34, 2.0, 0.34)
BY_TASK = {
    "SE1": _row(0.0, 1.0, 0.0, None, None, None),
    "LB1": _row(1.0, 0.0, 0.5071, 4.0, 4.0, 0.0),
    "BG1": _row(0.0, 1.0, 0.0, 0.69, 0.0, 0.69),
}
SENSITIVITY = {0.5: 0.3333, 2.0: 0.3333}
FREEZE_TOTAL = _row(1.0, 0.0, 0.1038, 9.0, 9.0, 0.0)
FREEZE_BY_TASK = {
    "SE1": _row(1.0, 0.0, 0.1214, 9.0, 9.0, 0.0),
    "LB1": _row(1.0, 0.0, 0.1056, 9.0, 9.0, 0.0),
    "BG1": _row(1.0, 0.0, 0.0845, 9.0, 9.0, 0.0),
}


def _family(task: str) -> str:
    return packaged_protocol().taxonomy.task(task).family


def example_score_sheet() -> ScoreSheet:
    """The published, rounded score sheet of the example planning file."""
    tasks = {task: BreakdownRow.of(1, row) for task, row in BY_TASK.items()}
    shares = ("edited_stationary", "source_stationary", "blind", "impossible")
    return ScoreSheet(
        challenge=PLANNING.id,
        protocol=ProtocolRef.of(packaged_protocol()),
        split=example_split().ref,
        scorer_version="1",
        n=3,
        coverage=Coverage(edited=0.6667, source=1.0),
        micro=TOTAL,
        macro_family=TOTAL,
        families={_family(task): row for task, row in tasks.items()},
        tasks=tasks,
        plausibility=Plausibility(shares=dict.fromkeys(shares, 0.0)),
        extra={
            f"d_safe_x{factor:g}": {"hcc_micro": hcc, "hcc_macro_family": hcc}
            for factor, hcc in SENSITIVITY.items()
        },
    )


def example_board() -> Board:
    """A board with the example entry, which covers too little to rank, and a reference row."""
    protocol = packaged_protocol()
    cells = _cells(BY_TASK)
    return Board(
        challenge=PLANNING.id,
        phase=PHASE,
        split=example_split().ref,
        protocol=ProtocolRef.of(protocol),
        headline=protocol.grading.headline,
        board=1,
        published_at=SCORED_AT,
        n_samples=3,
        confidence=protocol.ranking.confidence,
        families=tuple(
            FamilyHead(id=family.id, title=family.title, n=1)
            for family in protocol.families
            if family.id in cells
        ),
        entries=(_scored_entry(), _reference_entry()),
    )


def _scored_entry() -> BoardEntry:
    return BoardEntry(
        source="scored",
        rank=None,
        rank_interval=None,
        unranked_because="66.67% of the samples as edited are answered; a rank needs 99%",
        submission_id=SUBMISSION_ID,
        method=METHOD,
        team=TEAM,
        links=Links(code="https://example.org/braking-planner"),
        submitted_at=RECEIVED_AT,
        metrics=TOTAL,
        micro=TOTAL,
        macro_family=TOTAL,
        intervals=dict.fromkeys(TOTAL),
        families=_cells(BY_TASK),
        coverage={"edited": 0.6667, "source": 1.0},
    )


def _reference_entry() -> BoardEntry:
    return BoardEntry(
        source="reference",
        rank=None,
        rank_interval=None,
        unranked_because="reference rows never rank",
        submission_id=None,
        method="FREEZE",
        team="Reference",
        description="Stands still; scored by the same code.",
        submitted_at=None,
        metrics=FREEZE_TOTAL,
        micro=FREEZE_TOTAL,
        macro_family=FREEZE_TOTAL,
        intervals=dict.fromkeys(FREEZE_TOTAL),
        families=_cells(FREEZE_BY_TASK),
        coverage={"edited": 1.0, "source": 1.0},
    )


def _cells(by_task: dict[str, MetricRow]) -> dict[str, FamilyCell]:
    return {_family(task): FamilyCell.of(1, row) for task, row in by_task.items()}


FILES = frozenset({"planning", "strategy", "split"})
"""What people write by hand or by program: keys that may be left out are left out."""


def example_submission() -> SubmissionView:
    """The example planning file, uploaded and scored."""
    planning = file_bytes(example_planning())
    report = check(planning, protocol=packaged_protocol(), manifest=example_manifest()).report
    return SubmissionView(
        id=SUBMISSION_ID,
        phase=PHASE,
        challenge=PLANNING.id,
        team=TEAM,
        method=METHOD,
        description="",
        links=Links(code="https://example.org/braking-planner"),
        file_digest=report.digest,
        size_bytes=report.size_bytes,
        status=SubmissionStatus.SCORED,
        received_at=RECEIVED_AT,
        status_at=SCORED_AT,
        report=report,
        sheet=example_score_sheet(),
    )


def example_problem() -> Problem:
    """The answer to one upload too many."""
    return Problem(
        type=f"/problems/{ProblemCode.QUOTA_EXCEEDED}",
        title="The quota is used up",
        status=429,
        code=ProblemCode.QUOTA_EXCEEDED,
        detail="Your team has used its 5 submissions of today in this phase. "
        "The quota resets at 00:00 UTC.",
        instance="/api/v1/submissions",
        retry_after_s=3600,
    )


EXAMPLES: Mapping[str, Callable[[], Document]] = {
    "planning": example_planning,
    "strategy": example_strategy,
    "split": example_split,
    "manifest": example_manifest,
    "protocol": packaged_protocol,
    "score-sheet": example_score_sheet,
    "board": example_board,
    "submission": example_submission,
    "check-report": lambda: report_of(FaultCode.UNKNOWN_SAMPLE),
    "problem": example_problem,
}


def example_json(name: str) -> str:
    """Return an example as indented JSON, a list of numbers on one line."""
    document = EXAMPLES[name]()
    return indented(document.model_dump_json(by_alias=True, exclude_unset=name in FILES))
