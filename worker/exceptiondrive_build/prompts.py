"""Prompts for the models: the organizer's texts, filled in, and digests that identify answers.

Changing a text, model, setting or picture changes the digest: answers to the former question no
longer count, and count again when the change is reverted.
"""

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

from exceptiondrive_build.records import Author
from exceptiondrive_build.scenes.keyframe import Keyframe
from exceptiondrive_build.settings import ChatSection, EditSection, ModelSection
from exceptiondrive_build.values import Screened
from exceptiondrive_schemas.base import content_digest

if TYPE_CHECKING:
    from exceptiondrive_build.workshop import Workshop


class Prompts:
    """The prompts of a workshop."""

    def __init__(self, workshop: "Workshop") -> None:
        """Read the prompt files.

        Raises:
            BuildError: One cannot be read, or a task has no texts.
        """
        self._hazards = {task.id: task.hazard for task in workshop.tasks}
        self._texts = workshop.task_texts
        self._screen, self._edit, self._review = (
            workshop.text(model.prompt) for model in workshop.settings.models.values()
        )
        self.screen = cache(self._screen_words)

    def _screen_words(self, task_id: str) -> str:
        """Return the prompt of the screening model for a task."""
        texts = self._texts[task_id]
        rules = "\n".join(f"{code}: {words}" for code, words in texts.rejections.items())
        return _filled(
            self._screen,
            {
                "hazard": self._hazards[task_id],
                "suitable": texts.suitable,
                "rejections": rules,
                "ahead_m": _span(texts.ahead_m),
                "left_m": _span(texts.left_m),
            },
        )

    def edit(self, task_id: str, instruction: str) -> str:
        """Return the editing model's prompt for a view: keep the rest, the hazard, and where."""
        hazard = self._texts[task_id].edit
        return f"{self._edit.strip()}\n\nPut into the picture: {hazard}\nWhere: {instruction}"

    def review(self, task_id: str, screened: Screened) -> str:
        """Return the prompt of the reviewing model for an edit."""
        ahead_m, left_m = screened.target_m or (0.0, 0.0)
        return _filled(
            self._review,
            {
                "edit": self._texts[task_id].edit,
                "hazard": self._hazards[task_id],
                "ahead_m": f"{ahead_m:.1f}",
                "left_m": f"{left_m:.1f}",
            },
        )


def scene_words(keyframe: Keyframe) -> str:
    """Return the text about a scene that models get beside its pictures."""
    return f"The scene: {keyframe.description or 'no description'}"


def chat_author(section: ChatSection, *words: str) -> Author:
    """Return the author of decisions that a chat model makes with these prompts."""
    return _author(section, words, [section.temperature, section.max_tokens, section.extra])


def edit_author(section: EditSection, *words: str) -> Author:
    """Return the author when the editing model gets these prompts, one for each view."""
    return _author(section, words, [section.seed, section.resample, section.extra])


def _author(section: ModelSection, words: tuple[str, ...], settings: list[object]) -> Author:
    prompt = content_digest(list(words))
    return Author(model=section.model, prompt=prompt, settings=content_digest(settings))


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g} to {ends[1]:g}"


def _filled(text: str, values: Mapping[str, str]) -> str:
    """Substitute values for `{names}`; other braces, such as those of JSON, stay."""
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", value)
    return text
