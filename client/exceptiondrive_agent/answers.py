"""The form of an answer, and from the model's text to a validated answer or a reason for none.

Schemas hold only keywords that every structured-output engine knows (type, enum, anyOf, required):
lengths are checked after the answer has come. Nothing is guessed, repaired or filled in. Accepted
forms: JSON alone, JSON in the only code fence, JSON as the end of the text; for a strategy also the
bare letter. Two JSON objects are none.
"""

import json
import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import ValidationError

from exceptiondrive_agent.errors import NoAnswerError, Reason
from exceptiondrive_schemas.check.fault_list import LINE_BREAKS, has_unkeepable
from exceptiondrive_schemas.submission_files import ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy

Schema = dict[str, Any]
_FENCE = re.compile(r"```(?:json)?\s*\n?(.*?)```", re.DOTALL)
_BARE_LETTER = re.compile(r"""["'`*(\s]*([A-E])["'`*).\s]*""")
_REQUIRED = ("hazard_present", "risk_level", "recommended_strategy")


def reminder_schema(taxonomy: Taxonomy) -> Schema:
    """Schema of a reminder record whose hazard type is a task id of `taxonomy`, or null."""
    text = _or_null({"type": "string"})
    properties = {
        "hazard_present": {"type": "boolean"},
        "hazard_type": _or_null(_one_of([task.id for task in taxonomy.tasks])),
        "relative_location": text,
        "risk_level": _one_of(get_args(RiskLevel)),
        "evidence": text,
        "safety_constraint": text,
        "recommended_strategy": _one_of([strategy.value for strategy in Strategy]),
    }
    if list(properties) != list(ReminderRecord.model_fields):
        raise ValueError("the reminder schema must name the fields of ReminderRecord, in order")
    return _object(properties)


def decision_schema() -> Schema:
    """Schema of `{"strategy": "A" | ... | "E"}`."""
    return _object({"strategy": _one_of([strategy.value for strategy in Strategy])})


def _object(properties: Schema) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _one_of(values: list[str] | tuple[str, ...]) -> Schema:
    return {"type": "string", "enum": list(values)}


def _or_null(schema: Schema) -> Schema:
    return {"anyOf": [schema, {"type": "null"}]}


class _DuplicateKeyError(ValueError):
    """A key stands twice: which value counts is not for us to say."""


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
        raise NoAnswerError(Reason.WRONG_SCHEMA, _sentence(error), text) from None
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
    bare = _BARE_LETTER.fullmatch(_after_thinking(text))
    if bare:
        return Strategy(bare.group(1))
    answer = json_object(text)
    letter = answer.get("strategy")
    if set(answer) != {"strategy"} or letter not in [strategy.value for strategy in Strategy]:
        raise NoAnswerError(Reason.WRONG_SCHEMA, 'expected {"strategy": "A" to "E"}', text)
    return Strategy(letter)


def json_object(text: str) -> dict[str, Any]:
    """Return the one JSON object that `text` answers with.

    Raises:
        NoAnswerError: `not_json`: there is none, more than one, or a key stands twice.
    """
    try:
        answer = _decode_whole(text)
        if answer is None:
            answer = _decode(_answer_part(text))
    except _DuplicateKeyError as error:
        raise NoAnswerError(Reason.NOT_JSON, str(error), text) from None
    except (ValueError, RecursionError):
        raise NoAnswerError(Reason.NOT_JSON, "no single JSON object", text) from None
    if not isinstance(answer, dict):
        raise NoAnswerError(Reason.NOT_JSON, "JSON, but not an object", text)
    return answer


def _decode_whole(text: str) -> Any:
    """Decode an answer that is JSON and nothing else, whatever its texts hold; else None."""
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_constant=_refuse_constant)
    except json.JSONDecodeError:
        return None


def _answer_part(text: str) -> str:
    """What follows the thinking, out of its code block if it stands in one."""
    body = _after_thinking(text)
    fences: list[str] = _FENCE.findall(body)
    if len(fences) > 1:
        raise NoAnswerError(Reason.NOT_JSON, "more than one code block", text)
    return fences[0].strip() if fences else body


def _decode(body: str) -> Any:
    """Decode `body`, or the one object at its end; an object before it makes it ambiguous."""
    start = 0 if body[:1] in ('"', "[") else max(body.find("{"), 0)
    return json.loads(body[start:], object_pairs_hook=_unique, parse_constant=_refuse_constant)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = [key for key, _ in pairs]
    repeated = sorted({key for key in keys if keys.count(key) > 1})
    if repeated:
        raise _DuplicateKeyError(f"keys that stand twice: {', '.join(repeated)}")
    return dict(pairs)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _after_thinking(text: str) -> str:
    """The text after a reasoning block; empty when the block never ends."""
    if "<think>" in text and "</think>" not in text:
        return ""
    return text.rpartition("</think>")[2].strip()


def _sentence(error: ValidationError) -> str:
    return "; ".join(
        f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}"
        for item in error.errors(include_url=False, include_input=False)
    )
