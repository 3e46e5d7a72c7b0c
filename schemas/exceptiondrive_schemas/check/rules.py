"""The table of rules: what a prediction is, for each challenge."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Protocol

from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.check.answers import CheckedDocument
from exceptiondrive_schemas.check.findings import Findings, Path
from exceptiondrive_schemas.check.planning_rules import PlanningRules
from exceptiondrive_schemas.check.strategy_rules import StrategyRules
from exceptiondrive_schemas.protocol import Protocol as EvaluationProtocol


class PredictionRules(Protocol):
    """What a challenge knows of its own file; the rest is the same for all."""

    @property
    def required_keys(self) -> frozenset[str]:
        """Keys of every prediction."""

    @property
    def optional_keys(self) -> frozenset[str]:
        """Keys that a prediction may have."""

    def answer(self, prediction: dict[str, Any], path: Path, sample_id: str | None) -> Any:
        """Check one prediction and return its answer."""

    def finish(self) -> None:
        """Check what can be told only over all predictions."""

    def notes(self, n_predictions: int) -> tuple[str, ...]:
        """Say what a sound file leaves out."""

    def document(self, split: str, answers: Mapping[str, Any]) -> CheckedDocument:
        """Return the sound file."""


RULES: Mapping[ChallengeId, Callable[[EvaluationProtocol, Findings], PredictionRules]] = (
    MappingProxyType({ChallengeId.PLANNING: PlanningRules, ChallengeId.STRATEGY: StrategyRules})
)
CHALLENGE_BY_KEY: Mapping[str, ChallengeId] = MappingProxyType(
    {
        "source": ChallengeId.PLANNING,
        "edited": ChallengeId.PLANNING,
        "strategy": ChallengeId.STRATEGY,
        "reminder": ChallengeId.STRATEGY,
    }
)
"""Which challenge a prediction is for, where the file's `schema` does not say it."""
