"""The table of challenges: the form of a prediction, and the class that scores it."""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

from exceptiondrive_schemas.challenges import (
    CHALLENGES,
    PLANNING,
    STRATEGY,
    Challenge,
    ChallengeId,
    Registry,
)
from exceptiondrive_schemas.check.answers import CheckedDocument
from exceptiondrive_schemas.check.fault_list import FaultList, Path
from exceptiondrive_schemas.check.planning_rules import PlanningRules
from exceptiondrive_schemas.check.strategy_rules import StrategyRules
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest


class PredictionRules(Protocol):
    """The rules of a challenge for its own file; the rest is the same for all."""

    required_keys: ClassVar[frozenset[str]]
    """Keys of every prediction."""
    optional_keys: ClassVar[frozenset[str]]
    """Keys that a prediction may have."""

    def __init__(self, protocol: ProtocolDocument, faults: FaultList) -> None:
        """Begin a file."""

    def answer(self, prediction: dict[str, Any], path: Path, sample_id: str | None) -> Any:
        """Check one prediction and return its answer."""

    def finish(self, answers: Mapping[str, Any], manifest: Manifest | None) -> FileProfile | None:
        """Run the checks over all predictions; return the profile of the file."""

    def notes(self, n_predictions: int, profile: FileProfile | None) -> tuple[str, ...]:
        """Say what a sound file leaves out, and what it will be flagged for, though ranked."""

    def unranked_because(self, n_predictions: int, profile: FileProfile | None) -> str | None:
        """Say why a sound file would be scored but not ranked; None if it would be ranked."""

    def document(self, split: str, answers: Mapping[str, Any]) -> CheckedDocument:
        """Return the sound file."""


RULES: Registry[type[PredictionRules]] = Registry()
SCORED_BY: Registry[str] = Registry()
"""Names instead of classes: scoring needs numpy, which checking a file does not."""


def register(challenge: Challenge, rules: type[PredictionRules], scored_by: str) -> None:
    """Register a challenge, here only and for all code.

    `scored_by` is the `module:class` of an `exceptiondrive_scoring.challenge.ChallengeScoring`.

    Raises:
        ValueError: One of this name exists.
    """
    CHALLENGES.register(challenge.id, challenge)
    RULES.register(challenge.id, rules)
    SCORED_BY.register(challenge.id, scored_by)


register(PLANNING, PlanningRules, "exceptiondrive_scoring.planning:PlanningScoring")
register(STRATEGY, StrategyRules, "exceptiondrive_scoring.strategy:StrategyScoring")


def challenge_by_key(key: str) -> ChallengeId | None:
    """Return the challenge of predictions with this key, if `schema` does not give it."""
    for challenge_id, rules in RULES.items():
        if key != "sample_id" and key in rules.required_keys | rules.optional_keys:
            return challenge_id
    return None
