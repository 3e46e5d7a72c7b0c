"""Collects faults while a file is read: every one is counted, the first of each code are kept."""

from exceptiondrive_schemas.check.messages import MESSAGES
from exceptiondrive_schemas.check.shown import json_path
from exceptiondrive_schemas.faults import MAX_EXAMPLES, Fault, FaultCode, FaultGroup

MAX_EXAMPLES_IN_REPORT = 50
"""Examples of all codes together: they bound the size of a report."""
MIN_EXAMPLES_PER_CODE = 3
MAX_FAULTS = 100_000
"""Reading stops here: it bounds the time that a hostile file can take (about 2 s). Above every
coordinate of 3,181 samples with both trajectories (76,344), so honest files are counted whole."""

Path = tuple[str | int, ...]


class Findings:
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
