"""One small valid example of every document; all tell the same story of three samples.

They are stored as data, `published/examples/NAME.json`. Publishing rewrites them from their present
models; tests check their numbers and digests with the checker, the scorer and each other.
"""

import json
import re
from collections.abc import Mapping

from exceptiondrive_schemas.api.problems import Problem
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_schemas.submission_files import PlanningSubmission, StrategySubmission

MODELS: Mapping[str, type[Document]] = {
    "planning": PlanningSubmission,
    "strategy": StrategySubmission,
    "split": Split,
    "manifest": Manifest,
    "protocol": ProtocolDocument,
    "score-sheet": ScoreSheet,
    "board": Board,
    "submission": SubmissionView,
    "check-report": CheckReport,
    "problem": Problem,
}
FILES = frozenset({"planning", "strategy", "split"})
"""Documents that people write by hand or by program: their optional keys are left out."""
_PLAIN_LIST = re.compile(r"\[[^\[\]{}]*\]")
_LIST_OF_LISTS = re.compile(r"\[\s*(\[[^\[\]{}\n]*\](?:,\s*\[[^\[\]{}\n]*\])*)\s*\]")
_BLANKS = re.compile(r"\s+")
LINE_LENGTH = 100


def indented(text: str) -> str:
    """Return the same JSON document, laid out for reading, with a final newline."""
    text = json.dumps(json.loads(text), indent=2, ensure_ascii=False)
    return _LIST_OF_LISTS.sub(_on_one_line, _PLAIN_LIST.sub(_on_one_line, text)) + "\n"


def _on_one_line(match: re.Match[str]) -> str:
    flat = _BLANKS.sub(" ", match.group()).replace("[ ", "[").replace(" ]", "]")
    return flat if len(flat) <= LINE_LENGTH and '"' not in flat else match.group()


def example_json(name: str) -> str:
    """Return an example as indented JSON, a list of numbers on one line."""
    document = MODELS[name].model_validate_json(example_text(name))
    return indented(document.model_dump_json(by_alias=True, exclude_unset=name in FILES))
