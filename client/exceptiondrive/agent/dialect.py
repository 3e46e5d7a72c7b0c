"""How to ask: endpoints differ in structured output and in the name of the token limit.

Every refusal leads to a plainer dialect, never back, so asking ends after a few tries.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from exceptiondrive.agent.answer_schemas import Schema
from exceptiondrive.agent.prompts import Message


class AnswerForm(StrEnum):
    """How the answer's form is asked for: by schema, as any JSON object, or in words alone."""

    JSON_SCHEMA = "json_schema"
    JSON_OBJECT = "json_object"
    WORDS = "words"


_PLAINER = {
    AnswerForm.JSON_SCHEMA: AnswerForm.JSON_OBJECT,
    AnswerForm.JSON_OBJECT: AnswerForm.WORDS,
}


@dataclass(frozen=True)
class Dialect:
    """One way of asking."""

    form: AnswerForm = AnswerForm.JSON_SCHEMA
    token_limit: str = "max_tokens"
    sends_temperature: bool = True


def plainer(dialect: Dialect, refused_field: str | None) -> Dialect | None:
    """Return the dialect to try after a refusal, or None when there is none left.

    Args:
        dialect: The dialect that was refused.
        refused_field: Request field that the endpoint names as the cause, if it names one.
    """
    if refused_field == "max_tokens" and dialect.token_limit == "max_tokens":
        return replace(dialect, token_limit="max_completion_tokens")
    if refused_field == "temperature" and dialect.sends_temperature:
        return replace(dialect, sends_temperature=False)
    if dialect.form in _PLAINER:
        return replace(dialect, form=_PLAINER[dialect.form])
    return None


@dataclass(frozen=True)
class ModelSettings:
    """What is asked of the model beside the messages."""

    model: str
    temperature: float = 0.0
    max_tokens: int = 1000
    extra: dict[str, Any] = field(default_factory=dict)


def request_body(
    settings: ModelSettings, dialect: Dialect, messages: list[Message], name: str, schema: Schema
) -> dict[str, Any]:
    """The chat-completions request in one dialect; `extra` fields win over ours."""
    body: dict[str, Any] = {"model": settings.model, "messages": messages}
    body[dialect.token_limit] = settings.max_tokens
    if dialect.sends_temperature:
        body["temperature"] = settings.temperature
    if dialect.form is AnswerForm.JSON_SCHEMA:
        body["response_format"] = {
            "type": "json_schema",
            "json_schema": {"name": name, "strict": True, "schema": schema},
        }
    elif dialect.form is AnswerForm.JSON_OBJECT:
        body["response_format"] = {"type": "json_object"}
    return {**body, **settings.extra}
