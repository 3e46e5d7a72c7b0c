"""JSON Schemas and one small valid example of every document, as package data.

Written by `python -m exceptiondrive_schemas.publish` and served by the server under `/api/v1`.
"""

from pathlib import Path

DOCUMENT_NAMES = (
    "planning",
    "strategy",
    "split",
    "manifest",
    "protocol",
    "score-sheet",
    "board",
    "submission",
    "check-report",
    "problem",
)


def schema_text(name: str) -> str:
    """Return the JSON Schema of a document.

    Raises:
        KeyError: There is no such document.
    """
    return _read("schemas", name)


def example_text(name: str) -> str:
    """Return the example of a document.

    Raises:
        KeyError: There is no such document.
    """
    return _read("examples", name)


def _read(folder: str, name: str) -> str:
    if name not in DOCUMENT_NAMES:
        raise KeyError(name)
    file = Path(__file__).parent / folder / f"{name}.json"
    return file.read_text(encoding="utf-8")
