"""Check of submission files: one validator for client and worker, in pure Python.

`check` reads a file once and either finds all faults or returns its content. Every fault code, with
its sentence and a real report, is in docs/errors.md.
"""

from exceptiondrive_schemas.check.answers import (
    CheckedDocument,
    PlanningDocument,
    StrategyAnswer,
    StrategyDocument,
)
from exceptiondrive_schemas.check.checker import Checked, check
from exceptiondrive_schemas.check.inflate import (
    MAX_INFLATED_BYTES,
    MAX_UPLOAD_BYTES,
    UnreadableFileError,
    inflate,
)

__all__ = [
    "MAX_INFLATED_BYTES",
    "MAX_UPLOAD_BYTES",
    "Checked",
    "CheckedDocument",
    "PlanningDocument",
    "StrategyAnswer",
    "StrategyDocument",
    "UnreadableFileError",
    "check",
    "inflate",
]
