"""The form of both answers, and from the model's text to a validated one or a reason for none.

A strategy may also be the bare letter.
"""

import json
import re
from collections.abc import Iterator
from typing import get_args

from pydantic import ValidationError

from exceptiondrive_endpoints.answers import (
    Schema,
    after_thinking,
    json_object,
    object_of,
    one_of,
    or_null,
    sentence_of,
)
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_schemas.check.fault_list import LINE_BREAKS, has_unkeepable
from exceptiondrive_schemas.submission_files import ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy

_BARE_LETTER = re.compile(r"""["'`*(\s]*([A-E])["'`*).\s]*""")
_REQUIRED = ("hazard_present", "risk_level", "recommended_strategy")


def reminder_schema(taxonomy: Taxonomy) -> Schema:
    """Schema of a reminder record whose hazard type is a task id of `taxonomy`, or null."""
    text = or_null({"type": "string"})
    properties = {
        "hazard_present": {"type": "boolean"},
        "hazard_type": or_null(one_of([task.id for task in taxonomy.tasks])),
        "relative_location": text,
        "risk_level": one_of(get_args(RiskLevel)),
        "evidence": text,
        "safety_constraint": text,
        "recommended_strategy": one_of([strategy.value for strategy in Strategy]),
    }
    if list(properties) != list(ReminderRecord.model_fields):
        raise ValueError("the reminder schema must name the fields of ReminderRecord, in order")
    return object_of(properties)


def decision_schema() -> Schema:
    """Schema of `{"strategy": "A" | ... | "E"}`."""
    return object_of({"strategy": one_of([strategy.value for strategy in Strategy])})


def read_reminder(text: str, taxonomy: Taxonomy) -> ReminderRecord:
    """Return the reminder record in `text`.

    Raises:
        NoAnswerError: `not_json`, `wrong_schema` or `unknown_hazard_type`.
    """
    answer = json_object(text)
    missing = [name for name in ReminderRecord.model_fields if name not in answer]
    missing += [name for name in _REQUIRED if answer.get(name, "") is None]
    if missing:
        raise NoAnswerError(Reason.WRONG_SCHEMA, f"missing: {', '.join(missing)}", text)
    try:
        record = ReminderRecord.model_validate_json(json.dumps(answer))
    except ValidationError as error:
        raise NoAnswerError(Reason.WRONG_SCHEMA, sentence_of(error), text) from None
    if any(has_unkeepable(value, LINE_BREAKS) for value in _texts(record)):
        raise NoAnswerError(Reason.WRONG_SCHEMA, "a text holds control characters", text)
    known = {task.id for task in taxonomy.tasks}
    if record.hazard_type is not None and record.hazard_type not in known:
        detail = f"{record.hazard_type!r} is no task id of the taxonomy"
        raise NoAnswerError(Reason.UNKNOWN_HAZARD_TYPE, detail, text)
    return record


def _texts(record: ReminderRecord) -> Iterator[str]:
    return (value for _, value in record if isinstance(value, str))


def read_strategy(text: str) -> Strategy:
    """Return the strategy in `text`: `{"strategy": "C"}` or a bare letter.

    Raises:
        NoAnswerError: `not_json` or `wrong_schema`.
    """
    bare = _BARE_LETTER.fullmatch(after_thinking(text))
    if bare:
        return Strategy(bare.group(1))
    answer = json_object(text)
    letter = answer.get("strategy")
    if set(answer) != {"strategy"} or letter not in [strategy.value for strategy in Strategy]:
        raise NoAnswerError(Reason.WRONG_SCHEMA, 'expected {"strategy": "A" to "E"}', text)
    return Strategy(letter)
