"""Proposals for the regions: a detector's boxes, or a rectangle at the target to be moved by hand.

The formats of a detector's file are those of `exceptiondrive-build localize --help`; plain corners
may replace a box. The box whose centre is nearest to the target is proposed. If the boxes of a file
as a whole are in another frame, it is refused, and the frame in which they would fit is named.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import AfterValidator, BaseModel, ConfigDict, TypeAdapter, ValidationError

from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.inspection import to_inspect
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.scenes.keyframe import Number, Row, Row4
from exceptiondrive_build.scenes.nuscenes import rigid
from exceptiondrive_build.values import Corners, Localized, Screened
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document, bytes_digest, faults_in
from exceptiondrive_schemas.submission_files import Waypoint
from exceptiondrive_scoring.aliases import FloatArray

MIN_QUATERNION = 1e-6
MIN_JUDGED = 3
"""Least number of candidates from which the frame of a file is judged."""
HALVES = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
"""Corners of a rectangle relative to its centre, by length and width."""
_MOVED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "with x and y exchanged": lambda corners: corners[:, ::-1],
    "with y to the right": lambda corners: corners * (1, -1),
    "with x to the right and y ahead": lambda corners: corners[:, ::-1] * (1, -1),
    "with x backwards": lambda corners: corners * (-1, 1),
}


@dataclass(frozen=True)
class Box:
    """A detected box from above: (4, 2) corners in order around it, and its confidence."""

    corners_m: FloatArray
    score: float | None


class LocalizeReport(Document):
    """The result for a detector's file: number of proposals, and why other candidates have none."""

    proposed: int
    unchanged: int
    without: dict[str, int]


_Corner = tuple[Number, Number]


def _turn(quaternion: Row4) -> Row4:
    if np.linalg.norm(quaternion) < MIN_QUATERNION:
        raise ValueError("no quaternion that turns anything")
    return quaternion


class _Boxed(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    corners: tuple[_Corner, _Corner, _Corner, _Corner]
    score: float | None = None


class _Result(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    translation: Row
    size: Row
    rotation: Annotated[Row4, AfterValidator(_turn)]
    detection_score: float | None = None


_BOXES = TypeAdapter(dict[str, list[_Boxed]])
_RESULTS = TypeAdapter(dict[str, list[_Result]])


def localize(workshop: Workshop, file: Path) -> LocalizeReport:
    """Propose a detector's boxes for every candidate that is accepted or may yet be.

    Raises:
        BuildError: The file is not a detector's, or its boxes are in another frame.
        OSError: It cannot be read.
    """
    candidates = walk(workshop)
    data = file.read_bytes()
    boxes_of = _reader(file, data, {*workshop.keyframes, *candidates})
    limits = workshop.settings.localize
    found: dict[str, Box] = {}
    without: Counter[str] = Counter()
    distances: list[tuple[Candidate, Sequence[Box]]] = []
    eligible = _eligible(workshop, candidates)
    for candidate in eligible:
        boxes = [
            box for box in boxes_of(candidate) if box.score is None or box.score >= limits.min_score
        ]
        if not boxes:
            without["no box in the file"] += 1
            continue
        distances.append((candidate, boxes))
        nearest = min(boxes, key=lambda box: _distance_m(box.corners_m, candidate))
        if _distance_m(nearest.corners_m, candidate) > limits.max_distance_m:
            without["no box near the target"] += 1
        elif not shapely.is_valid(shapely.polygons(nearest.corners_m)):
            without["no quadrilateral"] += 1
        else:
            found[candidate.sample_id] = nearest
    _refuse_another_frame(file, distances, limits.max_distance_m)
    author = Author(model=file.name, settings=bytes_digest(data))
    values = {
        key: Localized(corners=_corners(box.corners_m), source="detector", score=box.score)
        for key, box in found.items()
    }
    return _propose(workshop, eligible, values, author, without)


def localize_by_hand(workshop: Workshop) -> LocalizeReport:
    """Propose a rectangle of the task's size at the target, for candidates without a proposal."""
    eligible = _eligible(workshop, walk(workshop))
    values = {}
    for candidate in eligible:
        if candidate.localized is None:
            length_m, width_m, _ = workshop.task_texts[candidate.task.id].size_m
            corners_m = HALVES * (length_m, width_m) + _target_m(candidate)
            values[candidate.sample_id] = Localized(corners=_corners(corners_m), source="by_hand")
    return _propose(workshop, eligible, values, Author(model="target of the screening"), Counter())


def _eligible(workshop: Workshop, candidates: Mapping[str, Candidate]) -> list[Candidate]:
    """Return candidates that are accepted, or that a person may yet accept."""
    waiting = to_inspect(candidates, workshop.settings.inspect)
    found = [
        candidate
        for sample_id, candidate in candidates.items()
        if candidate.is_accepted or (sample_id in waiting and candidate.inspected is None)
    ]
    if not found:
        advice = (
            "Run first: exceptiondrive-build run review; `report` says what was refused, and why."
        )
        raise BuildError("No edit is accepted, or waits for a person who may accept it.", advice)
    return found


def _propose(
    workshop: Workshop,
    eligible: Sequence[Candidate],
    values: Mapping[str, Localized],
    author: Author,
    without: Counter[str],
) -> LocalizeReport:
    records = [
        Record(
            kind=Kind.LOCALIZE,
            candidate=candidate.sample_id,
            by=author,
            inputs=candidate.pictures,
            value=values[candidate.sample_id].model_dump(mode="json", exclude_none=True),
        )
        for candidate in eligible
        if candidate.sample_id in values and candidate.localized != values[candidate.sample_id]
    ]
    workshop.records.append(*records)
    return LocalizeReport(
        proposed=len(records),
        unchanged=len(values) - len(records),
        without=dict(without.most_common()),
    )


def _reader(file: Path, data: bytes, known: set[str]) -> Callable[[Candidate], list[Box]]:
    """Map candidates to boxes in the ego frame; `known` are the ids of samples and keyframes."""
    results: dict[str, list[_Result]] = {}
    boxes: dict[str, list[_Boxed]] = {}
    try:
        document = json.loads(data)
        if isinstance(document, dict) and "results" in document:
            results = _RESULTS.validate_python(document["results"])
        else:
            boxes = _BOXES.validate_python(_as_boxes(document))
    except (ValueError, RecursionError) as error:
        first = faults_in(error)[0] if isinstance(error, ValidationError) else error
        raise BuildError(
            f"{file}: no detector's file: {first}.",
            "Its forms: exceptiondrive-build localize --help",
        ) from None
    if not known & (results or boxes).keys():
        raise BuildError(
            f"{file}: none of its ids is that of a sample or a keyframe of this workshop.",
            "Is it of other scenes, or of a workshop with another id_key?",
        )
    if results:
        return lambda candidate: [_in_ego_frame(it, candidate) for it in _of(results, candidate)]
    return lambda candidate: [
        Box(_in_order(np.array(box.corners)), box.score) for box in _of(boxes, candidate)
    ]


def _as_boxes(document: Any) -> Any:
    """Turn plain corners of a sample into a list of one box."""
    if not isinstance(document, dict):
        return document
    is_plain = {
        key: isinstance(value, list) and bool(value) and isinstance(value[0], list)
        for key, value in document.items()
    }
    return {k: [{"corners": v}] if is_plain[k] else v for k, v in document.items()}


def _of(boxes: Mapping[str, list[Any]], candidate: Candidate) -> list[Any]:
    by_sample = boxes.get(candidate.sample_id)
    return boxes.get(candidate.keyframe.keyframe_id, []) if by_sample is None else by_sample


def _in_ego_frame(result: _Result, candidate: Candidate) -> Box:
    """Return a box of nuScenes results (global frame; size: width, length, height) from above."""
    width_m, length_m, _ = result.size
    half = HALVES * (length_m, width_m)
    keyframe = candidate.keyframe
    global_from_box = rigid(np.array(result.rotation), np.array(result.translation))
    global_from_ego = rigid(np.array(keyframe.ego_rotation), np.array(keyframe.ego_translation_m))
    ego_from_box = np.linalg.inv(global_from_ego) @ global_from_box
    points = np.column_stack([half, np.zeros(4), np.ones(4)])
    return Box((points @ ego_from_box.T)[:, :2], result.detection_score)


def _in_order(corners_m: FloatArray) -> FloatArray:
    """Return the corners sorted around their centre, unless they are in order around it."""
    if shapely.is_valid(shapely.polygons(corners_m)):
        return corners_m
    from_centre = corners_m - corners_m.mean(axis=0)
    return corners_m[np.argsort(np.arctan2(from_centre[:, 1], from_centre[:, 0]))]


def _refuse_another_frame(
    file: Path, found: Sequence[tuple[Candidate, Sequence[Box]]], limit_m: float
) -> None:
    if len(found) < MIN_JUDGED:
        return

    def typical_m(moved: Callable[[FloatArray], FloatArray]) -> float:
        return median(
            min(_distance_m(moved(box.corners_m), candidate) for box in boxes)
            for candidate, boxes in found
        )

    as_it_is_m = typical_m(lambda corners: corners)
    if as_it_is_m <= limit_m:
        return
    others = {name: typical_m(move) for name, move in _MOVED.items()}
    best = min(others, key=lambda name: others[name])
    fits = others[best] <= limit_m
    raise BuildError(
        f"{file}: half of its boxes lie over {as_it_is_m:.0f} m from their targets"
        + (f"; {best} it would be {others[best]:.1f} m." if fits else "."),
        "Corners are metres of the ego frame, x ahead and y left of the rear axle; nothing is "
        "recorded.",
    )


def _distance_m(corners_m: FloatArray, candidate: Candidate) -> float:
    return float(np.hypot(*(corners_m.mean(axis=0) - _target_m(candidate))))


def _target_m(candidate: Candidate) -> Waypoint:
    assert isinstance(candidate.screened, Screened)
    assert candidate.screened.target_m is not None
    return candidate.screened.target_m


def _corners(corners_m: FloatArray) -> Corners:
    """Round to the millimetre, so that rounding errors of another machine give the same region."""
    rounded = corners_m.round(3) + 0.0
    return tuple((float(x), float(y)) for x, y in rounded)  # type: ignore[return-value]
