"""From a model's text to one JSON object, and the form of an answer as a schema.

Schemas hold only keywords that every structured-output engine knows (type, enum, anyOf, required):
lengths are checked after the answer has come. Nothing is guessed, repaired or filled in. Accepted
forms: JSON alone, JSON in the only code fence, JSON as the end of the text. Two JSON objects are
none.
"""

import json
import re
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_schemas.base import faults_in

Schema = dict[str, Any]
_FENCE = re.compile(r"```(?:json)?\s*\n?(.*?)```", re.DOTALL)


def object_of(properties: Schema) -> Schema:
    """Schema of an object with these keys, all of them required."""
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def one_of(values: Sequence[str]) -> Schema:
    """Schema of one of these texts."""
    return {"type": "string", "enum": list(values)}


def or_null(schema: Schema) -> Schema:
    """Schema of this or null."""
    return {"anyOf": [schema, {"type": "null"}]}


class _DuplicateKeyError(ValueError):
    """A key stands twice: which value counts is not for us to say."""


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
        return json.loads(text, object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)
    except json.JSONDecodeError:
        return None


def _answer_part(text: str) -> str:
    """What follows the thinking, out of its code block if it stands in one."""
    body = after_thinking(text)
    fences: list[str] = _FENCE.findall(body)
    if len(fences) > 1:
        raise NoAnswerError(Reason.NOT_JSON, "more than one code block", text)
    return fences[0].strip() if fences else body


def _decode(body: str) -> Any:
    """Decode `body`, or the one object at its end; an object before it makes it ambiguous."""
    start = 0 if body[:1] in ('"', "[") else max(body.find("{"), 0)
    return json.loads(body[start:], object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = [key for key, _ in pairs]
    repeated = sorted({key for key in keys if keys.count(key) > 1})
    if repeated:
        raise _DuplicateKeyError(f"keys that stand twice: {', '.join(repeated)}")
    return dict(pairs)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def after_thinking(text: str) -> str:
    """Return the text after a reasoning block; empty when the block never ends."""
    if "<think>" in text and "</think>" not in text:
        return ""
    return text.rpartition("</think>")[2].strip()


def sentence_of(error: ValidationError) -> str:
    """What is wrong with an answer, in one sentence."""
    return "; ".join(faults_in(error))
