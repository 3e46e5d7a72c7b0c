"""Rules for one prediction of `exceptiondrive.strategy/1` (docs/protocol.md section 6)."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, ClassVar, get_args

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.check.answers import StrategyAnswer, StrategyDocument
from exceptiondrive_schemas.check.fault_list import FaultList, Path, check_text, kind, quoted
from exceptiondrive_schemas.coverage import too_little_covered
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission_files import MAX_TEXT_CHARACTERS, ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy

STRATEGIES = frozenset(strategy.value for strategy in Strategy)
RISK_LEVELS = frozenset(get_args(RiskLevel))
TEXT_KEYS = ("relative_location", "evidence", "safety_constraint")
SAME_ANSWER = "same_answer"
REMINDER_KEYS = frozenset(ReminderRecord.model_fields)


class StrategyRules:
    """Checks the strategy and the reminder record of each sample."""

    required_keys: ClassVar = frozenset({"sample_id", "strategy"})
    optional_keys: ClassVar = frozenset({"reminder"})

    def __init__(self, protocol: ProtocolDocument, faults: FaultList) -> None:
        self._faults = faults
        self._refuse = faults.add
        self._task_ids = frozenset(task.id for task in protocol.tasks)
        self._ranking, self._plausibility = protocol.ranking, protocol.plausibility
        self._n_missing = 0
        self._letters: Counter[Strategy] = Counter()

    def answer(self, prediction: dict[str, Any], path: Path, sample_id: str | None) -> Any:
        """Check the strategy and the reminder of one prediction and return them."""
        strategy = self._strategy(prediction.get("strategy"), (*path, "strategy"), sample_id)
        self._n_missing += strategy is None
        if strategy is not None:
            self._letters[strategy] += 1
        reminder = self._reminder(prediction.get("reminder"), (*path, "reminder"), sample_id)
        return StrategyAnswer(strategy, reminder)

    def finish(self, answers: Mapping[str, Any], manifest: Manifest | None) -> None:
        """Do nothing: no check concerns all predictions together."""

    def notes(self, n_predictions: int, profile: FileProfile | None) -> tuple[str, ...]:
        """Say what a sound file leaves out, and what that costs."""
        if not self._n_missing:
            return ()
        share = f"{self._n_missing:,} of {n_predictions:,} samples"
        return (f"strategy is null for {share}: each counts as wrong and under-warning",)

    def unranked_because(self, n_predictions: int, profile: FileProfile | None) -> str | None:
        """Say why a sound file would be scored but not ranked; None if it would be ranked."""
        share = 1 - self._n_missing / max(n_predictions, 1)
        covered = STRATEGY.words.covered
        reasons = [too_little_covered(covered, {"edited": share}, self._ranking.min_coverage)]
        n_given, section = self._letters.total(), self._plausibility
        for letter, n in self._letters.most_common(1):
            is_same = n / n_given > section.flag_same_answer
            is_flagged = is_same and n_given >= section.flag_family_min_samples
            if is_flagged and SAME_ANSWER in self._ranking.unranked_flags:
                most = share_past(n / n_given, section.flag_same_answer)
                reasons.append(f"flagged {FLAGS[SAME_ANSWER].label}: {most} are {letter}")
        return "; ".join(filter(None, reasons)) or None

    def document(self, split: str, answers: Mapping[str, Any]) -> StrategyDocument:
        """Return the sound file."""
        return StrategyDocument(split, answers)

    def _strategy(self, value: Any, path: Path, sample_id: str | None) -> Strategy | None:
        code = FaultCode.UNKNOWN_STRATEGY
        letter = self._one_of(value, STRATEGIES, code, "A, B, C, D, E or null", path, sample_id)
        return Strategy(letter) if letter is not None else None

    def _reminder(self, value: Any, path: Path, sample_id: str | None) -> ReminderRecord | None:
        if value is None:
            return None
        if not isinstance(value, dict):
            self._refuse(FaultCode.WRONG_TYPE, path, "an object or null", kind(value), sample_id)
            return None
        for key in sorted(value.keys() - REMINDER_KEYS):
            expected = f"only {', '.join(sorted(REMINDER_KEYS))}"
            self._refuse(FaultCode.UNKNOWN_KEY, (*path, key), expected, quoted(key), sample_id)
        n_before = len(self._faults)
        fields = self._reminder_fields(value, path, sample_id)
        return ReminderRecord(**fields) if len(self._faults) == n_before else None

    def _reminder_fields(
        self, value: dict[str, Any], path: Path, sample_id: str | None
    ) -> dict[str, Any]:
        fields = {key: value.get(key) for key in REMINDER_KEYS}
        if not isinstance(fields["hazard_present"], bool | None):
            got = kind(fields["hazard_present"])
            at = (*path, "hazard_present")
            self._refuse(FaultCode.WRONG_TYPE, at, "true, false or null", got, sample_id)
        for key, allowed, code, expected in (
            ("hazard_type", self._task_ids, FaultCode.UNKNOWN_HAZARD_TYPE, "a task id or null"),
            (
                "risk_level",
                RISK_LEVELS,
                FaultCode.UNKNOWN_RISK_LEVEL,
                "none, low, medium, high or null",
            ),
        ):
            self._one_of(fields[key], allowed, code, expected, (*path, key), sample_id)
        fields["recommended_strategy"] = self._strategy(
            fields["recommended_strategy"], (*path, "recommended_strategy"), sample_id
        )
        for key in TEXT_KEYS:
            if fields[key] is not None:
                check_text(
                    fields[key],
                    (*path, key),
                    self._faults,
                    sample_id=sample_id,
                    max_characters=MAX_TEXT_CHARACTERS,
                )
        return fields

    def _one_of(
        self,
        value: Any,
        allowed: frozenset[str],
        code: FaultCode,
        expected: str,
        path: Path,
        sample_id: str | None,
    ) -> str | None:
        if value is None:
            return None
        if not isinstance(value, str):
            self._refuse(FaultCode.WRONG_TYPE, path, expected, kind(value), sample_id)
            return None
        if value not in allowed:
            self._refuse(code, path, expected, quoted(value), sample_id)
            return None
        return value
