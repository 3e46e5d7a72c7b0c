"""Collects faults while a file is read: all are counted, and all affected samples.

The first examples of each code are kept, at most one per sample.

Values of the file are shown shortened, on one line, escaped.
"""

import json
import math
import re
import unicodedata
from collections.abc import Iterable
from typing import Any

from exceptiondrive_schemas.faults import MAX_EXAMPLES, MESSAGES, Fault, FaultCode, FaultGroup
from exceptiondrive_schemas.printable import counted

MAX_SHOWN_CHARACTERS = 60

JSON_KINDS = {bool: "a boolean", int: "a number", float: "a number", str: "text"}


def escaped(text: str) -> str:
    r"""Return at most 60 characters of `text`, all of them printable.

    Control characters, lone surrogates and invisible or bidirectional marks become `\uXXXX`: the
    reader sees what the file contains, and it can be printed anywhere.
    """
    shown = (
        character if character.isprintable() else f"\\u{ord(character):04x}"
        for character in text[:MAX_SHOWN_CHARACTERS]
    )
    return "".join(shown)[:MAX_SHOWN_CHARACTERS]


def quoted(text: str) -> str:
    """Return `text` in quotes; a long one is cut, and its length given."""
    if len(text) <= MAX_SHOWN_CHARACTERS:
        return f'"{escaped(text)}"'
    return f'"{escaped(text)}..." ({len(text):,} characters)'


def shown(value: Any) -> str:
    """Describe one value, as the JSON decoder gave it, in a few words."""
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
    """Return the JSON kind of a value with an article, to follow "got"."""
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
"""Maximum of examples of all codes together, which bounds the size of a report."""
MIN_EXAMPLES_PER_CODE = 3
MAX_SAMPLE_IDS_IN_REPORT = 25_000
"""Maximum for all codes together: eight kinds of faults in every sample of 3,181."""
FEW_SAMPLES = 0.1
"""A fault in at most this share of the samples is the planner's, not one of the whole file."""
WRITE_NULL_CODES = frozenset(
    {
        FaultCode.NON_FINITE,
        FaultCode.OUT_OF_BOUNDS,
        FaultCode.STEP_TOO_LONG,
        FaultCode.WRONG_WAYPOINT_COUNT,
        FaultCode.WRONG_WAYPOINT_SHAPE,
    }
)
"""Faults of values that a planner writes for samples on which it failed."""
MAX_FAULTS = 100_000
"""Reading stops here, which bounds the time for a hostile file (about 2 s). The limit is above all
coordinates of 3,181 samples with both trajectories (76,344), so honest files are counted fully."""

BY_CONVERT = re.compile(r"[;:]? ?`exceptiondrive convert FILE.*")
"""The part of a hint that suggests conversion."""

Path = tuple[str | int, ...]


class FaultList:
    """The faults of one file. Holds a bounded number of examples, however many faults there are."""

    is_convertible = True
    """Whether `exceptiondrive convert` reads such files; otherwise no hint suggests it."""

    def __init__(self) -> None:
        self._counts: dict[FaultCode, int] = {}
        self._examples: dict[FaultCode, list[Fault]] = {}
        self._sample_ids: dict[FaultCode, dict[str, None]] = {}
        self._sentences: dict[FaultCode, str] = {}

    def __len__(self) -> int:
        return sum(self._counts.values())

    @property
    def is_empty(self) -> bool:
        """Whether no fault was found."""
        return not self._counts

    @property
    def is_full(self) -> bool:
        """Whether there are enough faults to stop reading."""
        return len(self) >= MAX_FAULTS

    def add(
        self,
        code: FaultCode,
        path: Path,
        expected: str,
        got: str,
        sample_id: str | None = None,
        hint: str | None = None,
    ) -> None:
        """Count a fault, and keep it as an example while there is room.

        `path` consists of keys and indices from the root of the document. `got` and the id of the
        sample are already shortened and escaped.
        """
        self._counts[code] = self._counts.get(code, 0) + 1
        is_new = sample_id is None or self._note_sample(code, sample_id)
        examples = self._examples.setdefault(code, [])
        if is_new and len(examples) < MAX_EXAMPLES:
            if hint is not None and not self.is_convertible:
                hint = BY_CONVERT.sub("", hint) or None
            fault = Fault(
                path=json_path(path), sample_id=sample_id, expected=expected, got=got, hint=hint
            )
            examples.append(fault)

    def count(self, code: FaultCode, sample_ids: Iterable[str]) -> None:
        """Count a fault in each of these samples, in addition to the examples."""
        for sample_id in sample_ids:
            self._counts[code] = self._counts.get(code, 0) + 1
            self._note_sample(code, sample_id)

    def _note_sample(self, code: FaultCode, sample_id: str) -> bool:
        """Note that a sample has such a fault; return whether it is its first one."""
        known = self._sample_ids.setdefault(code, {})
        n_before = len(known)
        known.setdefault(sample_id)
        return len(known) > n_before

    def forget(self, *codes: FaultCode) -> None:
        """Remove faults that another one explains."""
        for code in codes:
            for kept in (self._counts, self._examples, self._sample_ids, self._sentences):
                kept.pop(code, None)

    def has(self, code: FaultCode) -> bool:
        """Whether there is such a fault."""
        return code in self._counts

    def n_samples(self, code: FaultCode) -> int:
        """Return the number of samples with such a fault."""
        return len(self._sample_ids.get(code, ()))

    def say(self, code: FaultCode, sentence: str) -> None:
        """Replace the sentence of a code by a more specific one for this file."""
        self._sentences[code] = sentence

    def advise(self, code: FaultCode, instead_of: str, hint: str) -> None:
        """Replace the hint in the examples of a code, when more is known at the end."""
        self._examples[code] = [
            example.model_copy(update={"hint": hint}) if example.hint == instead_of else example
            for example in self._examples.get(code, ())
        ]

    def groups(
        self, n_predictions: int | None = None, *, is_of_planner: bool = True
    ) -> tuple[FaultGroup, ...]:
        """Return all faults, grouped by code in the order of `FaultCode`.

        With `is_of_planner`, a fault in few samples counts as the planner's, not as one mistake of
        the whole file.
        """
        per_code = MAX_EXAMPLES_IN_REPORT // max(len(self._counts), 1)
        kept = min(MAX_EXAMPLES, max(per_code, MIN_EXAMPLES_PER_CODE))
        groups, room = [], MAX_SAMPLE_IDS_IN_REPORT
        for code in FaultCode:
            if code not in self._counts:
                continue
            sample_ids = tuple(self._sample_ids.get(code, ()))
            groups.append(
                FaultGroup(
                    code=code,
                    message=self._message(code, n_predictions or 0 if is_of_planner else 0),
                    count=self._counts[code],
                    n_samples=len(sample_ids),
                    sample_ids=sample_ids[:room],
                    examples=tuple(self._examples[code][:kept]),
                )
            )
            room = max(room - len(sample_ids), 0)
        return tuple(groups)

    def _message(self, code: FaultCode, n_predictions: int) -> str:
        message = self._sentences.get(code, MESSAGES[code])
        n_samples = self.n_samples(code)
        if code not in WRITE_NULL_CODES or not 0 < n_samples <= FEW_SAMPLES * n_predictions:
            return message
        return (
            f"{message} Only {n_samples:,} of {counted(n_predictions, 'sample')} "
            f"{'has' if n_samples == 1 else 'have'} it: where the planner's answer is nonsense, "
            "write null for the whole trajectory, which counts as unsafe "
            "(`exceptiondrive convert FILE --null-invalid` does so and lists them)."
        )


UNKEEPABLE = frozenset({"Cc", "Cs"})
"""Unicode categories: control characters (NUL among them) and lone surrogates."""
LINE_BREAKS = frozenset("\t\n\r")


def has_unkeepable(text: str, allowed: frozenset[str]) -> bool:
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
    """Check a text; return whether it is sound."""
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
