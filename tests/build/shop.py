"""A workshop whose edits wait for people: made-up scenes, a block painted at each target."""

from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from exceptiondrive_build.candidates import Candidate, asked, walk
from exceptiondrive_build.prompts import Prompts
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.scenes.cameras import NEAR_M, projection
from exceptiondrive_build.scenes.generated import make_scenes
from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_build.scenes.read_in import read_in
from exceptiondrive_build.values import (
    Change,
    Corners,
    Edited,
    Localized,
    Mark,
    Reviewed,
    Screened,
    ViewEdit,
)
from exceptiondrive_build.workshop import Workshop, new_workshop
from exceptiondrive_schemas.base import Document
from exceptiondrive_scoring.aliases import FloatArray

VIEWS = ("CAM_FRONT", "CAM_FRONT_LEFT")
TARGET_M = (14.0, 1.0)


def block(place: int) -> Corners:
    """A region near the target, a little elsewhere for each candidate."""
    x, y = TARGET_M[0] + place % 5, TARGET_M[1] + place % 3 * 0.5
    return ((x, y - 1.2), (x, y + 1.2), (x + 3, y + 1.2), (x + 3, y - 1.2))


def make_shop(folder: Path, *, n_scenes: int = 1, draw: int = 168, width_px: int = 320) -> Path:
    """Make a workshop in which every combination is screened, edited, reviewed and localized."""
    make_scenes(folder / "set", n_scenes=n_scenes, n_samples=7, width_px=width_px)
    new_workshop(folder / "shop", "made-2027", "0" * 64)
    settings = folder / "shop" / "workshop.toml"
    text = settings.read_text().replace("draw = 168", f"draw = {draw}")
    settings.write_text(text.replace('title = "made-2027"', 'title = "Made-up split 2027"'))
    with Workshop(folder / "shop") as workshop:
        read_in(workshop, folder / "set")
        prompts, painter = Prompts(workshop), _Painter(workshop)
        decisions = [
            record
            for place, candidate in enumerate(walk(workshop).values())
            for record in _decisions(workshop, prompts, painter, candidate, block(place))
        ]
        workshop.records.append(*decisions)
    return folder / "shop"


def _decisions(
    workshop: Workshop,
    prompts: Prompts,
    painter: "_Painter",
    candidate: Candidate,
    corners: Corners,
) -> list[Record]:
    screened = Screened(
        suitable=True,
        target_m=TARGET_M,
        views=tuple(ViewEdit(view=view, instruction="put it there") for view in VIEWS),
    )

    def decide(kind: Kind, value: Document) -> Record:
        by, inputs = asked(kind, workshop, prompts, candidate)
        return record(kind, by, inputs, value)

    def record(kind: Kind, by: Author, inputs: tuple[str, ...], value: Document) -> Record:
        told = value.model_dump(mode="json")
        record = Record(kind=kind, candidate=candidate.sample_id, by=by, inputs=inputs, value=told)
        candidate.current[kind] = record
        return record

    candidate.place = screened
    images = {view: painter.edited(candidate.keyframe.camera(view), corners) for view in VIEWS}
    reviewed = Reviewed(
        marks=dict.fromkeys(Mark, 4),
        changes={view: Change(inside=0.4, outside=0.01) for view in VIEWS},
        note="clear to see",
    )
    localized = Localized(corners=corners, source="detector", score=0.9)
    return [
        decide(Kind.SCREEN, screened),
        decide(Kind.EDIT, Edited(images=images)),
        decide(Kind.REVIEW, reviewed),
        record(
            Kind.LOCALIZE,
            Author(model="detector", settings="sha256:0"),
            candidate.pictures,
            localized,
        ),
    ]


class _Painter:
    """Edits views; the same view and region once."""

    def __init__(self, workshop: Workshop) -> None:
        self.workshop = workshop
        self.done: dict[tuple[str, Corners], str] = {}

    def edited(self, camera: Camera, corners: Corners) -> str:
        """Name of the source view with the region painted on the road."""
        key = camera.image, corners
        if key not in self.done:
            self.done[key] = self.workshop.keep_image(self._paint(camera, corners), "png")
        return self.done[key]

    def _paint(self, camera: Camera, corners: Corners) -> bytes:
        with Image.open(BytesIO(self.workshop.image(camera.image))) as picture:
            drawn = ground_polygon(camera, np.array(corners))
            if len(drawn) > 2:
                outline = [(float(u), float(v)) for u, v in drawn]
                ImageDraw.Draw(picture).polygon(outline, fill=(250, 170, 20))
            file = BytesIO()
            picture.save(file, "PNG")
        return file.getvalue()


def ground_polygon(camera: Camera, corners_m: FloatArray) -> FloatArray:
    """The part of a polygon on the ground that is in front of a camera, in pixels.

    Args:
        camera: Calibration.
        corners_m: (n, 2) in the ego frame, in order round it.

    Returns:
        (k, 2) corners, inside of the picture or not; k = 0 where all of it is behind the camera.
    """
    on_ground = np.array([(x, y, 0, 1) for x, y in corners_m])
    seen = on_ground @ projection(camera).T
    cut = []
    for here, there in zip(seen, np.roll(seen, -1, axis=0), strict=True):
        if here[2] >= NEAR_M:
            cut.append(here)
        if (here[2] >= NEAR_M) != (there[2] >= NEAR_M):
            cut.append(here + (there - here) * (NEAR_M - here[2]) / (there[2] - here[2]))
    found = np.array(cut).reshape(-1, 3)
    pixels: FloatArray = found[:, :2] / found[:, 2:]
    return pixels
