"""Walks a submission file once, from the first key to the last, and notes every fault."""

from typing import Any

from exceptiondrive_schemas.challenges import PLANNING, ChallengeId
from exceptiondrive_schemas.check.answers import CheckedDocument
from exceptiondrive_schemas.check.findings import Findings, Path
from exceptiondrive_schemas.check.json_stream import (
    JsonStream,
    JsonStreamError,
    elements,
    members,
    skip,
    skip_members,
)
from exceptiondrive_schemas.check.repeated_keys import report_repeated_keys
from exceptiondrive_schemas.check.rules import RULES, PredictionRules, challenge_by_key
from exceptiondrive_schemas.check.sample_ids import SampleIds
from exceptiondrive_schemas.check.schema_key import check_schema, find_challenge
from exceptiondrive_schemas.check.shown import escaped, kind, quoted
from exceptiondrive_schemas.check.split_name import check_split_name
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Manifest

ROOT_KEYS = ("schema", "split", "predictions")


class _TooManyFaultsError(Exception):
    """No more faults are worth counting."""


class SubmissionReader:
    """One reading of one file.

    Attributes:
        findings: The faults found.
        challenge: What the file's `schema` says it is for, None where that is unknown.
        split: What the file says it is for, shortened and escaped.
        n_predictions: Length of the list of predictions, None where there is none.
        notes: What else is worth knowing.
    """

    def __init__(
        self,
        data: bytes,
        *,
        protocol: Protocol,
        manifest: Manifest | None,
        challenge: ChallengeId | None,
        findings: Findings,
    ) -> None:
        self._data = data
        self._stream = JsonStream(data)
        self._protocol = protocol
        self._manifest = manifest
        self._wanted = challenge
        self._ids = SampleIds(manifest, findings)
        self._rules: PredictionRules | None = None
        self._answers: dict[str, Any] = {}
        self._seen: set[str] = set()
        self._reading: Path = ()
        self.findings = findings
        self.challenge: ChallengeId | None = None
        self.split: str | None = None
        self.n_predictions: int | None = None
        self.notes: list[str] = []

    def read(self) -> CheckedDocument | None:
        """Read the file; return its content if it is sound."""
        is_complete = self._read_all()
        if is_complete:
            self._report_missing_keys()
        self._ids.finish(is_complete=is_complete and self.n_predictions is not None)
        if self._rules is not None:
            self._rules.finish()
        return self._sound_document()

    def _read_all(self) -> bool:
        try:
            return self._read_root()
        except JsonStreamError as error:
            self._refuse(error.code, self._reading, error.expected, error.got)
            self.notes.append("Reading stopped there: what follows was not checked.")
        except _TooManyFaultsError:
            self.notes.append("Reading stopped after too many faults; the counts are incomplete.")
        return False

    def _read_root(self) -> bool:
        first = self._stream.peek()
        if first == "":
            self.findings.add(
                FaultCode.EMPTY_FILE, (), expected="a JSON document", got="blanks alone"
            )
            return False
        if first == "[":
            self._refuse(FaultCode.WRONG_TYPE, (), "an object with the key `schema`", "a list")
            return False
        for key in members(self._stream):
            self._read_member(key)
        self._reading = ()
        if self._stream.peek():
            follows = self._stream.not_json("the end of the file")
            self._refuse(FaultCode.TRAILING_DATA, (), follows.expected, follows.got)
        return True

    def _read_member(self, key: str) -> None:
        self._stop_when_full()
        self._reading = (key,)
        if key in self._seen:
            self._refuse(FaultCode.DUPLICATE_KEY, (), "every key once", f"{quoted(key)} again")
            skip(self._stream)
        elif key == "predictions":
            self._seen.add(key)
            self._read_predictions()
        elif key in ROOT_KEYS:
            self._seen.add(key)
            self._read_name(key)
        else:
            expected = f"only {', '.join(ROOT_KEYS)}"
            self._refuse(FaultCode.UNKNOWN_KEY, (key,), expected, quoted(key))
            self._report_repeated(self._stream.value(), (key,))

    def _read_name(self, key: str) -> None:
        value = self._stream.value()
        self._report_repeated(value, (key,))
        if key == "schema":
            self.challenge = check_schema(value, self._wanted, self.findings)
        else:
            self.split = escaped(value) if isinstance(value, str) else None
            check_split_name(value, self._manifest, self.findings)

    def _read_predictions(self) -> None:
        if self._stream.peek() != "[":
            self._refuse_predictions()
            return
        self.n_predictions = 0
        for index in elements(self._stream):
            self._stop_when_full()
            self._reading = ("predictions", index)
            value = self._stream.value()
            self._report_repeated(value, self._reading)
            self._read_prediction(value, index)
            self.n_predictions = index + 1

    def _refuse_predictions(self) -> None:
        is_object = self._stream.peek() == "{"
        got = "an object" if is_object else kind(self._stream.value())
        hint = "write a list; the sample id stands inside each prediction" if is_object else None
        self.findings.add(
            FaultCode.WRONG_TYPE, ("predictions",), expected="a list", got=got, hint=hint
        )
        if is_object:
            skip_members(self._stream)

    def _read_prediction(self, value: Any, index: int) -> None:
        path: Path = ("predictions", index)
        if not isinstance(value, dict):
            self._refuse(FaultCode.WRONG_TYPE, path, "an object", kind(value))
            return
        rules = self._rules or self._choose_rules(value)
        stated = value.get("sample_id")
        sample_id = self._ids.admit(stated, index) if "sample_id" in value else None
        shown_id = sample_id or (escaped(stated) if isinstance(stated, str) else None)
        if value.keys() != rules.required_keys:
            self._check_keys(value, rules, path, shown_id)
        answer = rules.answer(value, path, shown_id)
        if self.findings.is_empty and sample_id is not None:
            self._answers[sample_id] = answer

    def _check_keys(
        self, value: dict[str, Any], rules: PredictionRules, path: Path, sample_id: str | None
    ) -> None:
        for key in sorted(rules.required_keys - value.keys()):
            self._refuse(FaultCode.MISSING_KEY, path, f"the key {quoted(key)}", "none", sample_id)
        known = rules.required_keys | rules.optional_keys
        for key in value.keys() - known:
            expected = f"only {', '.join(sorted(known))}"
            self._refuse(FaultCode.UNKNOWN_KEY, (*path, key), expected, quoted(key), sample_id)

    def _choose_rules(self, prediction: dict[str, Any]) -> PredictionRules:
        challenge = self.challenge or self._wanted
        if "schema" not in self._seen:
            challenge = find_challenge(JsonStream(self._data)) or challenge
        for key in prediction:
            challenge = challenge or challenge_by_key(key)
        self._rules = RULES[challenge or PLANNING.id](self._protocol, self.findings)
        return self._rules

    def _report_missing_keys(self) -> None:
        for key in ROOT_KEYS:
            if key not in self._seen:
                self._refuse(FaultCode.MISSING_KEY, (), f"the key {quoted(key)}", "none")

    def _report_repeated(self, value: Any, path: Path) -> None:
        if self._stream.has_repeated_keys:
            report_repeated_keys(value, path, self.findings)

    def _stop_when_full(self) -> None:
        if self.findings.is_full:
            raise _TooManyFaultsError

    def _sound_document(self) -> CheckedDocument | None:
        if not self.findings.is_empty or self.split is None:
            return None
        challenge = self.challenge or PLANNING.id
        rules = self._rules or RULES[challenge](self._protocol, self.findings)
        self.notes += rules.notes(len(self._answers))
        return rules.document(self.split, self._answers)

    def _refuse(
        self, code: FaultCode, path: Path, expected: str, got: str, sample_id: str | None = None
    ) -> None:
        self.findings.add(code, path, expected=expected, got=got, sample_id=sample_id)
