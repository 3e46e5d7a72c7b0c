"""The present state of every candidate, derived from the records alone.

A model's record counts as long as the same model would get the same prompt about the same pictures;
a person's, as long as the pictures are the same. Thresholds are applied on reading, so changing
them requires no new answers.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np

from exceptiondrive_build.prompts import Prompts, chat_author, edit_author, scene_words
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.scenes.cameras import project
from exceptiondrive_build.scenes.keyframe import Camera, Keyframe
from exceptiondrive_build.settings import ReviewSection, TaskTexts
from exceptiondrive_build.values import (
    Edited,
    Inspected,
    Localized,
    Mark,
    Reviewed,
    Screened,
    Unanswered,
    ViewEdit,
    Withdrawn,
)
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.taxonomy import Task

Value = TypeVar("Value", bound=Document)


@dataclass(eq=False)
class Candidate:
    """One keyframe and one task, and the decisions about them.

    Attributes:
        sample_id: Its id, in the workshop and in a split.
        keyframe: The moment.
        task: The task.
        thresholds: Limits that an edit must meet.
        place: Where its hazard is to be drawn: as screened, or as of the auxiliary set; None if
            nothing is to be edited.
        current: The record that counts now, by kind; of `verify` the newest.
        inspections: All decisions of people about these pictures, oldest first.
        verifications: All decisions of people about the region, oldest first.
    """

    sample_id: str
    keyframe: Keyframe
    task: Task
    thresholds: ReviewSection
    place: Screened | None = None
    current: dict[Kind, Record] = field(default_factory=dict)
    inspections: tuple[Record, ...] = ()
    verifications: tuple[Record, ...] = ()

    @cached_property
    def screened(self) -> Screened | Unanswered | None:
        """Whether the task suits the scene."""
        return self._answer(Kind.SCREEN, Screened)

    @cached_property
    def edited(self) -> Edited | Unanswered | None:
        """The edited pictures."""
        return self._answer(Kind.EDIT, Edited)

    @cached_property
    def reviewed(self) -> Reviewed | Unanswered | None:
        """Marks and measured change."""
        return self._answer(Kind.REVIEW, Reviewed)

    @cached_property
    def inspected(self) -> Inspected | None:
        """The newest decision of a person about the pictures."""
        return self._value(Kind.INSPECT, Inspected)

    @cached_property
    def localized(self) -> Localized | None:
        """The proposed region."""
        return self._value(Kind.LOCALIZE, Localized)

    @cached_property
    def withdrawn(self) -> Withdrawn | None:
        """Set if a later revision no longer counts the sample."""
        return self._value(Kind.WITHDRAW, Withdrawn)

    @property
    def is_suitable(self) -> bool:
        """Whether screening found that the task suits the scene."""
        return isinstance(self.screened, Screened) and self.screened.suitable

    @cached_property
    def review_faults(self) -> tuple[str, ...]:
        """Codes of the thresholds that the review misses; empty if it meets all.

        `low_mark:<mark>`, `low_mean_mark`; as measured, `target_not_in_view`, `nothing_changed`
        within the target area of any view, `background_changed` outside it in some view.
        """
        if not isinstance(self.reviewed, Reviewed):
            return ()
        marks, changes = self.reviewed.marks, self.reviewed.changes.values()
        least = self.thresholds
        faults = [
            f"low_mark:{mark}"
            for mark in Mark
            if marks[mark] < least.min_marks.get(mark, least.min_mark)
        ]
        if sum(marks.values()) < least.min_mean_mark * len(marks):
            faults.append("low_mean_mark")
        inside = [change.inside for change in changes if change.inside is not None]
        if not inside:
            faults.append("target_not_in_view")
        elif max(inside) < least.min_change_inside:
            faults.append("nothing_changed")
        if any(change.outside > least.max_change_outside for change in changes):
            faults.append("background_changed")
        return tuple(faults)

    @property
    def passed_review(self) -> bool:
        """Whether the edit was reviewed and meets every threshold."""
        is_reviewed = self.is_suitable and isinstance(self.reviewed, Reviewed)
        return is_reviewed and not self.review_faults

    @property
    def is_accepted(self) -> bool:
        """Whether the pictures suffice, by a person's newest decision or else the review."""
        return self.accepted_after(self.inspected)

    def accepted_after(self, word: Inspected | None) -> bool:
        """The same, if this is the newest decision of a person."""
        if word is None or not self.is_suitable:
            return self.passed_review
        return word.passed

    @cached_property
    def pictures(self) -> tuple[str, ...]:
        """Digests of the pictures people see: source, then edited, of each edited view."""
        if not isinstance(self.edited, Edited):
            return ()
        return picture_digests(
            name
            for view, edited in self.edited.images.items()
            for name in (self.keyframe.camera(view).image, edited)
        )

    @property
    def decisions(self) -> tuple[Record, ...]:
        """The records that count: of models by stage, of people by digest, a withdrawal last."""
        by_people = sorted((*self.inspections, *self.verifications), key=lambda it: it.digest)
        others = {k: it for k, it in self.current.items() if k not in (Kind.INSPECT, Kind.VERIFY)}
        last = [others.pop(Kind.WITHDRAW)] if Kind.WITHDRAW in others else []
        return (*others.values(), *by_people, *last)

    def _value(self, kind: Kind, value: type[Value]) -> Value | None:
        record = self.current.get(kind)
        return None if record is None else value.model_validate(record.value, strict=False)

    def _answer(self, kind: Kind, value: type[Value]) -> Value | Unanswered | None:
        record = self.current.get(kind)
        if record is not None and record.value is not None and "failure" in record.value:
            return Unanswered.model_validate(record.value)
        return self._value(kind, value)


def picture_digests(names: Iterable[str]) -> tuple[str, ...]:
    """Return the digests of pictures from their names in the workshop."""
    return tuple(f"sha256:{name.partition('.')[0]}" for name in names)


def walk(workshop: Workshop) -> dict[str, Candidate]:
    """Return every candidate of the workshop by sample id, ordered by keyframe, then by task.

    Raises:
        BuildError: Settings, prompts, scenes or records cannot be read.
    """
    reading = _Reading(workshop)
    found: dict[str, Candidate] = {}
    for keyframe in workshop.keyframes.values():
        for task in workshop.tasks:
            sample_id = workshop.sample_id(keyframe.keyframe_id, task.id)
            found[sample_id] = Candidate(sample_id, keyframe, task, workshop.settings.review)
            reading.screening(found[sample_id])
    for sample_id, place in auxiliary_places(workshop, found).items():
        found[sample_id].place = place
        reading.pictures(found[sample_id])
    return found


class _Reading:
    """Fills candidates with the records that count now."""

    def __init__(self, workshop: Workshop) -> None:
        self._workshop = workshop
        self._prompts = Prompts(workshop)
        self._records = {kind: workshop.records.standing(kind) for kind in Kind}

    def screening(self, candidate: Candidate) -> None:
        self._look_at_model(candidate, Kind.SCREEN)
        withdrawals = self._of(Kind.WITHDRAW, candidate)
        if withdrawals:
            candidate.current[Kind.WITHDRAW] = withdrawals[-1]
        if isinstance(candidate.screened, Screened) and candidate.screened.suitable:
            candidate.place = candidate.screened
            self.pictures(candidate)

    def pictures(self, candidate: Candidate) -> None:
        self._look_at_model(candidate, Kind.EDIT)
        if not candidate.pictures:
            return
        self._look_at_model(candidate, Kind.REVIEW)
        for kind in (Kind.INSPECT, Kind.LOCALIZE, Kind.VERIFY):
            self._look(candidate, kind, candidate.pictures)
        candidate.inspections, candidate.verifications = (
            tuple(r for r in self._of(kind, candidate) if r.inputs == candidate.pictures)
            for kind in (Kind.INSPECT, Kind.VERIFY)
        )

    def _look_at_model(self, candidate: Candidate, kind: Kind) -> None:
        by, inputs = asked(kind, self._workshop, self._prompts, candidate)
        self._look(candidate, kind, inputs, by)

    def _look(
        self, candidate: Candidate, kind: Kind, inputs: tuple[str, ...], by: Author | None = None
    ) -> None:
        """Take the newest record with exactly these inputs, by whoever would be asked now."""
        for record in reversed(self._of(kind, candidate)):
            if record.inputs == inputs and by in (None, record.by):
                candidate.current[kind] = record
                return

    def _of(self, kind: Kind, candidate: Candidate) -> tuple[Record, ...]:
        return self._records[kind].get(candidate.sample_id, ())


def auxiliary_places(
    workshop: Workshop, candidates: Mapping[str, Candidate]
) -> dict[str, Screened]:
    """Return the pairs that are edited although the screening did not choose them, and where.

    They are drawn from candidates without a place by a digest of seed and sample id, by task like
    the accepted ones; the hazard goes to the middle of the task's range, in the first view that
    sees it. They serve the study of failures and later work, and are in no benchmark.
    """
    settings = workshop.settings.auxiliary
    if not settings.draw:
        return {}
    accepted = Counter(c.task.id for c in candidates.values() if c.passed_review)
    wanted = shares(accepted, settings.draw, capped=False)
    by_task: dict[str, list[str]] = defaultdict(list)
    for sample_id, candidate in candidates.items():
        if candidate.place is None and candidate.screened is not None:
            by_task[candidate.task.id].append(sample_id)
    found = {}
    for task_id, count in wanted.items():
        ids = sorted(by_task[task_id], key=lambda key: content_digest([settings.seed, key]))
        for sample_id in ids[:count]:
            found[sample_id] = _middle_place(candidates[sample_id], workshop.task_texts[task_id])
    return found


def _middle_place(candidate: Candidate, texts: TaskTexts) -> Screened:
    ahead_m, left_m = (sum(span) / 2 for span in (texts.ahead_m, texts.left_m))
    cameras = candidate.keyframe.cameras
    seeing = [camera for camera in cameras if _is_seen(camera, ahead_m, left_m)]
    view = (seeing or cameras)[0].view
    words = f"with its foot at {ahead_m:.1f} m ahead and {left_m:.1f} m to the left"
    return Screened(
        suitable=False,
        target_m=(ahead_m, left_m),
        views=(ViewEdit(view=view, instruction=f"in {view}: {words}"),),
    )


def _is_seen(camera: Camera, ahead_m: float, left_m: float) -> bool:
    ((u, v),) = project(camera, np.array([[ahead_m, left_m]]))
    return bool(0 <= u < camera.width_px and 0 <= v < camera.height_px)


def shares(sizes: Mapping[str, int], count: int, *, capped: bool = True) -> dict[str, int]:
    """Divide `count` among strata by largest remainder; `capped`: none gets more than it has."""
    whole = sum(sizes.values())
    if not whole:
        return dict.fromkeys(sizes, 0)
    count = min(count, whole) if capped else count
    exact = {key: count * size / whole for key, size in sizes.items()}
    found = {key: int(value) for key, value in exact.items()}
    rest = sorted(exact, key=lambda key: (found[key] - exact[key], key))
    for key in rest[: count - sum(found.values())]:
        found[key] += 1
    return found


def asked(
    kind: Kind, workshop: Workshop, prompts: Prompts, candidate: Candidate
) -> tuple[Author, tuple[str, ...]]:
    """Return the author at a stage that asks a model, and the digests of its input pictures."""
    settings, keyframe = workshop.settings, candidate.keyframe
    task, place = candidate.task, candidate.place
    if kind is Kind.SCREEN:
        words = (prompts.screen(task.id), scene_words(keyframe))
        sources = (camera.image for camera in keyframe.cameras)
        return chat_author(settings.screen, *words), picture_digests(sources)
    assert place is not None
    if kind is Kind.EDIT:
        told = (prompts.edit(task.id, view.instruction) for view in place.views)
        sources = (keyframe.camera(view.view).image for view in place.views)
        return edit_author(settings.edit, *told), picture_digests(sources)
    return chat_author(settings.review, prompts.review(task.id, place)), candidate.pictures
