"""The JSON schemas of the two answers, for endpoints with structured output.

Only keywords that every structured-output engine knows (type, enum, anyOf, required): lengths are
checked after the answer has come.
"""

from typing import Any, get_args

from exceptiondrive_schemas.strategy import ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy

Schema = dict[str, Any]


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
