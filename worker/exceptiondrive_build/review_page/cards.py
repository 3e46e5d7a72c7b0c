"""A card as sent to the page: one document with all that a reviewer needs to see."""

from typing import Any

from exceptiondrive_build.agreement import readings
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.review_page.desk import Desk, Queue
from exceptiondrive_build.review_page.region import start_footprint_m, tube_m
from exceptiondrive_build.scenes.cameras import projection
from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_build.values import Edited, Reviewed, Screened


def card(desk: Desk, queue: Queue, sample_id: str) -> dict[str, Any]:
    """Return a card; only for a third reader does it hold decisions of others."""
    candidate = desk.candidates[sample_id]
    keyframe, task, protocol = candidate.keyframe, candidate.task, desk.workshop.protocol
    screened, reviewed = candidate.screened, candidate.reviewed
    is_third = queue == "verify" and desk.is_third(sample_id)
    return {
        "id": sample_id,
        "third": is_third,
        "why": desk.why.get(sample_id, "") if queue == "inspect" else "",
        "scene": keyframe.scene or keyframe.scene_id,
        "location": keyframe.location,
        "description": keyframe.description,
        "task": {
            "id": task.id,
            "title": task.title,
            "hazard": task.hazard,
            "region": task.region,
            "words": desk.workshop.task_texts[task.id].edit,
        },
        "target": screened.target_m if isinstance(screened, Screened) else None,
        "views": [_view(candidate, camera) for camera in keyframe.cameras],
        "marks": reviewed.marks if isinstance(reviewed, Reviewed) else {},
        "review_note": reviewed.note if isinstance(reviewed, Reviewed) else "",
        "recorded": keyframe.recorded or (),
        "tube": tube_m(keyframe.recorded, protocol) if keyframe.recorded else [],
        "footprint": start_footprint_m(protocol),
        "d_safe_m": task.d_safe_m * protocol.grading.d_safe_scale,
        "corners": candidate.localized.corners if candidate.localized else None,
        "source": candidate.localized.source if candidate.localized else None,
        "others": [
            word.model_dump(mode="json", exclude={"blind"})
            for _, word in (readings(desk.standing("verify", sample_id)) if is_third else [])
            if word.blind
        ],
    }


def _view(candidate: Candidate, camera: Camera) -> dict[str, Any]:
    """One view. `ground` maps (x, y, 1) in metres on the ground to (u depth, v depth, depth)."""
    edited = (
        candidate.edited.images.get(camera.view) if isinstance(candidate.edited, Edited) else None
    )
    reviewed = candidate.reviewed
    change = reviewed.changes.get(camera.view) if isinstance(reviewed, Reviewed) else None
    return {
        "name": camera.view,
        "source": camera.image,
        "edited": edited,
        "width": camera.width_px,
        "height": camera.height_px,
        "ground": projection(camera)[:, [0, 1, 3]].tolist(),
        "change": change.model_dump() if change else None,
    }
