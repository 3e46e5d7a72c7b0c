"""Fast reader of `exceptiondrive.strategy/1`: one typed decode, then checks on the answers."""

from typing import Any, Literal

import msgspec
import numpy as np

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.check import StrategyAnswer
from exceptiondrive_schemas.check.fast_decode import (
    ROOT_TEXTS,
    are_short,
    decode,
    n_texts,
    prediction_type,
    rows_of,
    submission_decoder,
)
from exceptiondrive_schemas.check.strategy_rules import TEXT_KEYS
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission_files import MAX_TEXT_CHARACTERS, ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.strategy import strategy_answers

Letter = Literal["A", "B", "C", "D", "E"]
UNSET = msgspec.UNSET


def _optional(kind: Any) -> Any:
    return kind | None | msgspec.UnsetType


REMINDER = prediction_type(
    "Reminder",
    [
        ("hazard_present", _optional(bool), UNSET),
        ("hazard_type", _optional(str), UNSET),
        ("relative_location", _optional(str), UNSET),
        ("risk_level", _optional(RiskLevel), UNSET),
        ("evidence", _optional(str), UNSET),
        ("safety_constraint", _optional(str), UNSET),
        ("recommended_strategy", _optional(Letter), UNSET),
    ],
)
PREDICTION = prediction_type(
    "StrategyPrediction",
    [("sample_id", str), ("strategy", Letter | None), ("reminder", _optional(REMINDER), UNSET)],
)
DECODER = submission_decoder(PREDICTION)
MAX_TEXTS_PER_PREDICTION = 5 + 2 * len(REMINDER.__struct_fields__)


def read_strategy(text: bytes, manifest: Manifest, protocol: ProtocolDocument) -> Columns | None:
    """Return the columns of `StrategyAnswers` in canonical order; None if not certainly sound."""
    n_max = ROOT_TEXTS + MAX_TEXTS_PER_PREDICTION * len(manifest.sample_ids)
    if n_texts(text) > n_max:
        return None
    submission = decode(text, DECODER, STRATEGY.file_schema)
    if submission is None or submission.split != manifest.name:
        return None
    rows = rows_of([each.sample_id for each in submission.predictions], manifest)
    if rows is None:
        return None
    if n_texts(text) != ROOT_TEXTS + sum(map(_n_texts_of, submission.predictions)):
        return None
    if not are_short(text):
        return None
    hazard_types = frozenset({None, UNSET, *(task.id for task in protocol.tasks)})
    if not all(_is_surely_sound(each.reminder, hazard_types) for each in submission.predictions):
        return None
    in_file_order = strategy_answers([_answer(each) for each in submission.predictions]).columns()
    order = np.argsort(rows)
    return {name: column[order] for name, column in in_file_order.items()}


def _n_texts_of(prediction: Any) -> int:
    """Return the number of strings in one prediction with unique keys."""
    n = 3 + (prediction.strategy is not None) + (prediction.reminder is not UNSET)
    if prediction.reminder:
        values = msgspec.structs.astuple(prediction.reminder)
        n += sum((value is not UNSET) + isinstance(value, str) for value in values)
    return n


def _is_surely_sound(reminder: Any, hazard_types: frozenset[Any]) -> bool:
    if not reminder:
        return True
    if reminder.hazard_type not in hazard_types:
        return False
    texts = [getattr(reminder, key) or "" for key in TEXT_KEYS]
    return all(each.isprintable() and len(each) <= MAX_TEXT_CHARACTERS for each in texts)


def _answer(prediction: Any) -> StrategyAnswer:
    strategy = Strategy(prediction.strategy) if prediction.strategy else None
    if not prediction.reminder:
        return StrategyAnswer(strategy, None)
    values = msgspec.structs.asdict(prediction.reminder)
    given = {key: value for key, value in values.items() if value is not UNSET}
    return StrategyAnswer(strategy, ReminderRecord.model_construct(**given))
