"""The two questions: what is asked, in which form, and how the answer is read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from exceptiondrive.agent.answer_schemas import Schema, decision_schema, reminder_schema
from exceptiondrive.agent.answers import read_reminder, read_strategy
from exceptiondrive.agent.dialect import ModelSettings
from exceptiondrive.agent.journal import JournalHeader, JournalLine
from exceptiondrive.agent.prompts import (
    DECISION_INSTRUCTIONS,
    reminder_instructions,
    reminder_text,
)
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.strategy import ReminderRecord
from exceptiondrive_schemas.taxonomy import Taxonomy


@dataclass(frozen=True)
class Question:
    """A question that is the same for every sample, save its images and its reminder.

    Attributes:
        name: `remind` or `decide`.
        instructions: Base instructions.
        schema: JSON schema of the answer.
        read: From the model's text to the journal fields that hold the answer.
        reminders: Text of the reminder of a sample; samples that are not in it are asked without.
        views: Public names of the views, or none.
    """

    name: Literal["remind", "decide"]
    instructions: str
    schema: Schema
    read: Callable[[str], dict[str, Any]]
    reminders: Mapping[str, str] = field(default_factory=dict)
    views: tuple[str, ...] = ()

    def header(self, model: ModelSettings, *, with_reminders: bool = False) -> JournalHeader:
        """The journal header of this question to this model."""
        settings = {
            "instructions": self.instructions,
            "schema": self.schema,
            "views": list(self.views),
            "with_reminders": with_reminders,
            "temperature": model.temperature,
            "max_tokens": model.max_tokens,
            "extra": model.extra,
        }
        return JournalHeader(
            question=self.name, model=model.model, settings_digest=content_digest(settings)
        )

    def given_reminder_digest(self, sample_id: str) -> str | None:
        """Digest of the reminder that goes with a sample, if one does."""
        text = self.reminders.get(sample_id)
        return None if text is None else content_digest(text)

    def is_finished(self, line: JournalLine) -> bool:
        """Whether a journal line answers what would be asked now."""
        return line.is_done and line.given_reminder_digest == self.given_reminder_digest(
            line.sample_id
        )


def remind_question(taxonomy: Taxonomy, views: tuple[str, ...] = ()) -> Question:
    """Images and the public taxonomy in, a reminder record out."""
    return Question(
        name="remind",
        instructions=reminder_instructions(taxonomy),
        schema=reminder_schema(taxonomy),
        read=lambda text: {"reminder": read_reminder(text, taxonomy)},
        views=views,
    )


def decide_question(
    reminders: Mapping[str, ReminderRecord], taxonomy: Taxonomy, views: tuple[str, ...] = ()
) -> Question:
    """Images, with or without a reminder, in, a strategy out."""
    question = Question(
        name="decide",
        instructions=DECISION_INSTRUCTIONS,
        schema=decision_schema(),
        read=lambda text: {"strategy": read_strategy(text)},
        views=views,
    )
    texts = {key: reminder_text(record, taxonomy) for key, record in reminders.items()}
    return replace(question, reminders=texts)
