"""The two questions: what the model is told, in which form, and how its answer is read.

Nothing here depends on the sample, save its images and its reminder. Of the protocol only what the
paper calls the shared taxonomy is used: ids, names, hazards and families of the tasks, letters and
meanings of the strategies. Acceptable sets, required clearances and region kinds are never read.
Both settings of `decide` share images, strategies and base instructions (paper, Reminder Agent
Evaluation): the reminder is one more text part.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from pydantic import ValidationError

from exceptiondrive_agent.journal import JournalHeader, JournalLine
from exceptiondrive_endpoints.answers import (
    Schema,
    after_thinking,
    json_object,
    object_of,
    one_of,
    or_null,
    sentence_of,
)
from exceptiondrive_endpoints.endpoint import Message, ModelSettings, picture_part, text_part
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_endpoints.images import CleanImage
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.check.fault_list import LINE_BREAKS, has_unkeepable
from exceptiondrive_schemas.submission_files import ReminderRecord, RiskLevel
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy

_BARE_LETTER = re.compile(r"""["'`*(\s]*([A-E])["'`*).\s]*""")
_REQUIRED = ("hazard_present", "risk_level", "recommended_strategy")
_STRATEGIES = "\n".join(f"{strategy.value}: {strategy.action}" for strategy in Strategy)
_SCENE = (
    "You see camera images of one driving scene, all taken at the same moment from one car, "
    "the ego vehicle."
)

DECISION_INSTRUCTIONS = f"""{_SCENE}
Choose the one high-level strategy with which the ego vehicle should go on for the next three \
seconds. Judge from what the images show. Be as cautious as the scene demands, and not more.

Strategies:
{_STRATEGIES}

Answer with one JSON object and nothing else: {{"strategy": "<letter>"}}"""


def reminder_instructions(taxonomy: Taxonomy) -> str:
    """Base instructions of the Reminder Agent with the shared taxonomy."""
    return f"""{_SCENE}
You are a risk reminder. You neither plan a path nor control the car: you look for evidence of a \
hazard for the ego vehicle and write a short structured record for the agent that decides.
At most one of the risk definitions below applies; often none does. You are not told which. Claim \
only what the images show.

Risk definitions (id, name: hazard):
{taxonomy_text(taxonomy)}

Strategies (letter: meaning):
{_STRATEGIES}

Answer with one JSON object and nothing else. Its keys, all of them required:
"hazard_present": true or false
"hazard_type": the id of the risk definition that applies, or null
"relative_location": where the hazard is as seen from the ego vehicle, or null
"risk_level": "none", "low", "medium" or "high"
"evidence": what in the images shows it, in at most two sentences, or null
"safety_constraint": what the ego vehicle must keep to, in at most two sentences, or null
"recommended_strategy": the letter of one strategy"""


def taxonomy_text(taxonomy: Taxonomy) -> str:
    """The public part of the taxonomy as text: families, then id, name and hazard of each task."""
    lines = []
    for family in taxonomy.families:
        lines.append(f"[{family.title}]")
        lines += [f"{t.id}, {t.name}: {t.hazard}" for t in taxonomy.tasks_of(family.id)]
    return "\n".join(lines)


def reminder_text(record: ReminderRecord, taxonomy: Taxonomy) -> str:
    """A reminder record as the deciding agent reads it, with its hazard type spelled out."""
    fields = record.model_dump(mode="json")
    if record.hazard_type is not None:
        task = taxonomy.task(record.hazard_type)
        fields["hazard_type"] = f"{task.name}: {task.hazard}"
    if record.recommended_strategy is not None:
        strategy = record.recommended_strategy
        fields["recommended_strategy"] = f"{strategy.value}: {strategy.action}"
    return (
        "Risk reminder, written by an auxiliary agent from the same images. It may be wrong; weigh "
        "it against what you see:\n" + json.dumps(fields, ensure_ascii=False, indent=1)
    )


def messages(
    instructions: str,
    images: Sequence[CleanImage],
    views: Sequence[str] = (),
    reminder: str | None = None,
) -> list[Message]:
    """Chat messages: instructions, then the images in order, then the reminder if there is one.

    There are as many names of views as images, or none.
    """
    parts: list[dict[str, Any]] = []
    for number, image in enumerate(images, start=1):
        view = f" ({views[number - 1]})" if views else ""
        parts.append(text_part(f"Image {number} of {len(images)}{view}:"))
        parts.append(picture_part(image))
    if reminder is not None:
        parts.append(text_part(reminder))
    return [{"role": "system", "content": instructions}, {"role": "user", "content": parts}]


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
        """The journal header of this question to this model.

        The token limit is not part of it: no answer that is kept was cut by it, and those that were
        are asked again under a higher one, in the same journal.
        """
        settings = {
            "prompt and --protocol": [self.instructions, self.schema],
            "--views": list(self.views),
            "--reminders or none": with_reminders,
            "--temperature": model.temperature,
            "--extra-body": model.extra,
        }
        digests = {name: content_digest(value) for name, value in settings.items()}
        return JournalHeader(question=self.name, model=model.model, settings=digests)

    def given_reminder_digest(self, sample_id: str) -> str | None:
        """Digest of the reminder that goes with a sample, if one does."""
        text = self.reminders.get(sample_id)
        return None if text is None else content_digest(text)

    def is_finished(self, line: JournalLine) -> bool:
        """Whether a journal line answers what would be asked now."""
        return line.is_done and line.given_reminder_digest == self.given_reminder_digest(
            line.sample_id
        )


def remind_question(taxonomy: Taxonomy, views: tuple[str, ...]) -> Question:
    """Images and the public taxonomy in, a reminder record out."""
    return Question(
        name="remind",
        instructions=reminder_instructions(taxonomy),
        schema=reminder_schema(taxonomy),
        read=lambda text: {"reminder": read_reminder(text, taxonomy)},
        views=views,
    )


def decide_question(
    reminders: Mapping[str, ReminderRecord], taxonomy: Taxonomy, views: tuple[str, ...]
) -> Question:
    """Images, with or without a reminder, in, a strategy out."""
    return Question(
        name="decide",
        instructions=DECISION_INSTRUCTIONS,
        schema=decision_schema(),
        read=lambda text: {"strategy": read_strategy(text)},
        reminders={key: reminder_text(record, taxonomy) for key, record in reminders.items()},
        views=views,
    )


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
    texts = (value for _, value in record if isinstance(value, str))
    if any(has_unkeepable(value, LINE_BREAKS) for value in texts):
        raise NoAnswerError(Reason.WRONG_SCHEMA, "a text holds control characters", text)
    known = {task.id for task in taxonomy.tasks}
    if record.hazard_type is not None and record.hazard_type not in known:
        detail = f"{record.hazard_type!r} is no task id of the taxonomy"
        raise NoAnswerError(Reason.UNKNOWN_HAZARD_TYPE, detail, text)
    return record


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
