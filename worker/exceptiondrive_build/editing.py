"""Editing: one picture at a time, and all views of a candidate or none."""

import asyncio
from collections.abc import Sequence
from io import BytesIO
from typing import Any

from PIL import Image

from exceptiondrive_build.asking import Answer, Question, Stage
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.measure import UnreadablePictureError, read_picture
from exceptiondrive_build.records import Kind
from exceptiondrive_build.values import Edited, Screened
from exceptiondrive_endpoints.endpoint import Endpoint
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_endpoints.images import ImageDataError, clean_image

SAME_SHAPE = 0.02
"""Relative difference of two aspect ratios that still counts as the same shape."""


class EditStage(Stage):
    """Produces the edited picture of each view in which the hazard is to be drawn."""

    kind = Kind.EDIT

    def is_open(self, candidate: Candidate) -> bool:
        """Whether it has a place for its hazard and has not been edited."""
        return candidate.place is not None and candidate.edited is None

    def questions(self, candidate: Candidate) -> tuple[Question, ...]:
        """One for each view."""
        return tuple(
            self.question(
                [self.prompts.edit(candidate.task.id, view.instruction)],
                {view.view: candidate.keyframe.camera(view.view).image},
                part=view.view,
            )
            for view in _place(candidate).views
        )

    async def ask(
        self, endpoint: Endpoint, candidate: Candidate, question: Question, known: dict[str, Any]
    ) -> None:
        """Have one view edited, and store the picture."""
        settings = self.workshop.settings.edit
        source = await asyncio.to_thread(self.picture, question.images[question.part])
        answer, untaken = await endpoint.edit(source, question.words[0], settings.seed)
        known["form"] = "".join(f"without {name} " for name in untaken).strip() or "images/edits"
        if answer.usage is not None:
            known |= answer.usage.model_dump()
        camera = candidate.keyframe.camera(question.part)
        size = (camera.width_px, camera.height_px)
        data, extension = await asyncio.to_thread(fitted, answer.picture, size, settings.resample)
        known["image"] = await asyncio.to_thread(self.workshop.keep_image, data, extension)

    def value(self, candidate: Candidate, answers: Sequence[Answer]) -> Edited:
        """The pictures by view."""
        views = [view.view for view in _place(candidate).views]
        pictures = [str(answer.image) for answer in answers]
        return Edited(images=dict(zip(views, pictures, strict=True)))


def fitted(data: bytes, size: tuple[int, int], resample: bool) -> tuple[bytes, str]:
    """Return an edited picture in the size of its source, (width, height), without metadata.

    With `resample` a picture of the same shape but another size is scaled. Transparency is removed:
    people see the colours that are measured.

    Returns:
        The bytes, which are those of the endpoint if nothing had to be changed, and the extension
        of their file.

    Raises:
        NoAnswerError: `no_picture` or `wrong_size`.
    """
    try:
        image = read_picture(data)
    except UnreadablePictureError as error:
        raise NoAnswerError(Reason.NO_PICTURE, f"not a whole picture: {error}") from None
    if image.size != size:
        shape, wanted = image.width / image.height, size[0] / size[1]
        if not resample or abs(shape / wanted - 1) > SAME_SHAPE:
            detail = f"asked for {size[0]} x {size[1]} pixels, got {image.width} x {image.height}"
            raise NoAnswerError(Reason.WRONG_SIZE, detail)
    elif image.format in ("PNG", "JPEG") and not image.has_transparency_data:
        try:
            clean = clean_image(data)
        except ImageDataError as error:
            raise NoAnswerError(Reason.NO_PICTURE, str(error)) from None
        return clean.data, clean.extension
    file = BytesIO()
    image.info.pop("transparency", None)  # a converted picture would keep it
    image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(file, "PNG")
    return file.getvalue(), "png"


def _place(candidate: Candidate) -> Screened:
    assert candidate.place is not None
    return candidate.place
