"""One small valid example of every document; all tell the same story of three samples."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Links
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check_bytes
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.problems import Problem, ProblemCode
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.publish.broken_files import file_bytes, report_of
from exceptiondrive_schemas.publish.example_scores import (
    METHOD,
    PHASE,
    RECEIVED_AT,
    SCORED_AT,
    SUBMISSION_ID,
    TEAM,
    example_board,
    example_score_sheet,
)
from exceptiondrive_schemas.publish.example_split import (
    example_manifest,
    example_planning,
    example_split,
    example_strategy,
)
from exceptiondrive_schemas.publish.indented import indented
from exceptiondrive_schemas.submission import SubmissionStatus, SubmissionView

FILES = frozenset({"planning", "strategy", "split"})
"""What people write by hand or by program: keys that may be left out are left out."""


def example_submission() -> SubmissionView:
    """The example planning file, uploaded and scored."""
    planning = file_bytes(example_planning())
    report = check_bytes(planning, protocol=packaged_protocol(), manifest=example_manifest())
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


def example_report() -> CheckReport:
    """The report of a file with a mistyped sample id."""
    return report_of(FaultCode.UNKNOWN_SAMPLE)


def example_problem() -> Problem:
    """The answer to one upload too many."""
    return Problem(
        type=f"/problems/{ProblemCode.QUOTA_EXCEEDED}",
        title="Quota exceeded",
        status=429,
        code=ProblemCode.QUOTA_EXCEEDED,
        detail="Your team has used its 5 submissions of today in this phase. "
        "The quota resets at 00:00 UTC.",
        instance="/api/v1/submissions",
        retry_after_s=3600,
    )


EXAMPLES: Mapping[str, Callable[[], Document]] = MappingProxyType(
    {
        "planning": example_planning,
        "strategy": example_strategy,
        "split": example_split,
        "manifest": example_manifest,
        "protocol": packaged_protocol,
        "score-sheet": example_score_sheet,
        "board": example_board,
        "submission": example_submission,
        "check-report": example_report,
        "problem": example_problem,
    }
)


def example_json(name: str) -> str:
    """Return an example as indented JSON, a list of numbers on one line."""
    document = EXAMPLES[name]()
    return indented(document.model_dump_json(by_alias=True, exclude_unset=name in FILES))
