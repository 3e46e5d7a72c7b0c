"""JSON Schemas, generated from the models."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.planning import PlanningSubmission
from exceptiondrive_schemas.problems import Problem
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_schemas.strategy import StrategySubmission
from exceptiondrive_schemas.submission import SubmissionView

MODELS: Mapping[str, type[Document]] = MappingProxyType(
    {
        "planning": PlanningSubmission,
        "strategy": StrategySubmission,
        "split": Split,
        "manifest": Manifest,
        "protocol": Protocol,
        "score-sheet": ScoreSheet,
        "board": Board,
        "submission": SubmissionView,
        "check-report": CheckReport,
        "problem": Problem,
    }
)
WRITTEN_BY_SERVER = frozenset({"score-sheet", "board", "submission", "check-report", "problem"})
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a document, as it is written or as it is read."""
    mode: Literal["serialization", "validation"] = (
        "serialization" if name in WRITTEN_BY_SERVER else "validation"
    )
    return {"$schema": DIALECT, **MODELS[name].model_json_schema(by_alias=True, mode=mode)}
