"""Rules for texts: length, and characters that can be kept, compared and shown."""

import unicodedata

from exceptiondrive_schemas.check.findings import Findings, Path
from exceptiondrive_schemas.check.shown import kind, quoted
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.printable import counted

UNKEEPABLE = frozenset({"Cc", "Cs"})
"""Unicode categories: control characters (NUL among them) and lone surrogates."""
LINE_BREAKS = frozenset("\t\n\r")


def has_unkeepable(text: str, allowed: frozenset[str] = frozenset()) -> bool:
    """Whether a text holds control characters or lone surrogates other than `allowed`."""
    return not text.isprintable() and any(
        unicodedata.category(character) in UNKEEPABLE and character not in allowed
        for character in text
    )


def check_text(
    value: object,
    path: Path,
    findings: Findings,
    *,
    sample_id: str | None = None,
    max_characters: int,
    allowed: frozenset[str] = LINE_BREAKS,
) -> bool:
    """Check a text; tell whether it is sound."""
    if not isinstance(value, str):
        findings.add(
            FaultCode.WRONG_TYPE, path, expected="text", got=kind(value), sample_id=sample_id
        )
        return False
    if len(value) > max_characters:
        limit = f"at most {counted(max_characters, 'character')}"
        got = counted(len(value), "character")
        findings.add(FaultCode.TEXT_TOO_LONG, path, expected=limit, got=got, sample_id=sample_id)
        return False
    if has_unkeepable(value, allowed):
        findings.add(
            FaultCode.INVALID_TEXT,
            path,
            expected="no control characters, no lone surrogates",
            got=quoted(value),
            sample_id=sample_id,
        )
        return False
    return True
