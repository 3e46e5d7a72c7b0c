"""Collects faults while a file is read: every one is counted, the first of each code are kept.

A value of the file is shown short, on one line, escaped.
"""

import json
import math
import unicodedata
from typing import Any

from exceptiondrive_schemas.faults import MAX_EXAMPLES, MESSAGES, Fault, FaultCode, FaultGroup
from exceptiondrive_schemas.printable import counted

MAX_SHOWN_CHARACTERS = 60

JSON_KINDS = {bool: "a boolean", int: "a number", float: "a number", str: "text"}


def escaped(text: str) -> str:
    r"""Return at most 60 characters of `text`, all of them printable.

    Control characters, lone surrogates and invisible or direction-turning marks become `\uXXXX`:
    what the reader sees is what the file holds, and it can be printed anywhere.
    """
    shown = "".join(
        character if character.isprintable() else f"\\u{ord(character):04x}"
        for character in text[:MAX_SHOWN_CHARACTERS]
    )
    return shown if len(shown) <= MAX_SHOWN_CHARACTERS else shown[:MAX_SHOWN_CHARACTERS]


def quoted(text: str) -> str:
    """Return `text` in quotes; a long one is cut, and its length told."""
    if len(text) <= MAX_SHOWN_CHARACTERS:
        return f'"{escaped(text)}"'
    return f'"{escaped(text)}..." ({len(text):,} characters)'


def shown(value: Any) -> str:
    """Describe one decoded JSON value in a few words.

    Args:
        value: None, bool, int, float, str, list or dict, as the JSON decoder gave it.
    """
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, dict):
        return f"an object with {counted(len(value), 'key')}"
    if isinstance(value, list):
        return f"a list of {counted(len(value), 'value')}"
    if isinstance(value, float) and math.isinf(value):
        return f"{'-' if value < 0 else ''}Infinity, or a number too large to hold"
    return json.dumps(value)


def kind(value: Any) -> str:
    """Return the JSON kind of a value with an article, to stand after "got"."""
    return JSON_KINDS.get(type(value), shown(value))


def json_path(parts: tuple[str | int, ...]) -> str:
    """Return the JSON path of a place: `$.predictions[3].edited[2][0]`."""
    return "$" + "".join(_step(part) for part in parts)


def _step(part: str | int) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    is_plain = part.isidentifier() and part.isascii() and len(part) <= MAX_SHOWN_CHARACTERS
    return f".{part}" if is_plain else f"[{quoted(part)}]"


MAX_EXAMPLES_IN_REPORT = 50
"""Examples of all codes together: they bound the size of a report."""
MIN_EXAMPLES_PER_CODE = 3
MAX_FAULTS = 100_000
"""Reading stops here: it bounds the time that a hostile file can take (about 2 s). Above every
coordinate of 3,181 samples with both trajectories (76,344), so honest files are counted whole."""

Path = tuple[str | int, ...]


class FaultList:
    """The faults of one file. Holds a bounded number of examples, however many faults there are."""

    def __init__(self) -> None:
        self._counts: dict[FaultCode, int] = {}
        self._examples: dict[FaultCode, list[Fault]] = {}
        self._sentences: dict[FaultCode, str] = {}

    def __len__(self) -> int:
        return sum(self._counts.values())

    @property
    def is_empty(self) -> bool:
        """Whether no fault was found."""
        return not self._counts

    @property
    def is_full(self) -> bool:
        """Whether it is no use to read further."""
        return len(self) >= MAX_FAULTS

    def add(
        self,
        code: FaultCode,
        path: Path,
        *,
        expected: str,
        got: str,
        sample_id: str | None = None,
        hint: str | None = None,
    ) -> None:
        """Count a fault, and keep it while there is room.

        Args:
            code: Kind of fault.
            path: Keys and indices from the root of the document.
            expected: What belongs there, in words.
            got: What stands there, already shortened and escaped.
            sample_id: Sample that the fault is in, shortened and escaped.
            hint: What probably went wrong.
        """
        n_before = self._counts.get(code, 0)
        self._counts[code] = n_before + 1
        if n_before < MAX_EXAMPLES:
            fault = Fault(
                path=json_path(path), sample_id=sample_id, expected=expected, got=got, hint=hint
            )
            self._examples.setdefault(code, []).append(fault)

    def count(self, code: FaultCode, n_more: int) -> None:
        """Count faults beyond the examples that were added."""
        if n_more:
            self._counts[code] = self._counts.get(code, 0) + n_more

    def say(self, code: FaultCode, sentence: str) -> None:
        """Replace the sentence of a code by one that knows more about this file."""
        self._sentences[code] = sentence

    def groups(self) -> tuple[FaultGroup, ...]:
        """All faults, grouped by code in the order of `FaultCode`."""
        per_code = MAX_EXAMPLES_IN_REPORT // max(len(self._counts), 1)
        kept = min(MAX_EXAMPLES, max(per_code, MIN_EXAMPLES_PER_CODE))
        return tuple(
            FaultGroup(
                code=code,
                message=self._sentences.get(code, MESSAGES[code]),
                count=self._counts[code],
                examples=tuple(self._examples[code][:kept]),
            )
            for code in FaultCode
            if code in self._counts
        )


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
    faults: FaultList,
    *,
    sample_id: str | None = None,
    max_characters: int,
    allowed: frozenset[str] = LINE_BREAKS,
) -> bool:
    """Check a text; tell whether it is sound."""
    if not isinstance(value, str):
        faults.add(
            FaultCode.WRONG_TYPE, path, expected="text", got=kind(value), sample_id=sample_id
        )
        return False
    if len(value) > max_characters:
        limit = f"at most {counted(max_characters, 'character')}"
        got = counted(len(value), "character")
        faults.add(FaultCode.TEXT_TOO_LONG, path, expected=limit, got=got, sample_id=sample_id)
        return False
    if has_unkeepable(value, allowed):
        faults.add(
            FaultCode.INVALID_TEXT,
            path,
            expected="no control characters, no lone surrogates",
            got=quoted(value),
            sample_id=sample_id,
        )
        return False
    return True
