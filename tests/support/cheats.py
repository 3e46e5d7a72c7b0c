"""Cheats and mistakes: what somebody may submit who knows the rules, or did not read them.

Each takes an honest planner's file as arrays and gives the file that is submitted. None looks at a
hazard, and none knows a region.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEPS = np.arange(1, 7)[:, None]
TIME_STEP_S = 0.5
AHEAD, LEFT = np.array([1.0, 0.0]), np.array([0.0, 1.0])


@dataclass(frozen=True)
class File:
    """An honest file: (M, 6, 2) waypoints, NaN where there is no answer, and the families by sample."""

    source: Array
    edited: Array
    family: NDArray[np.integer[Any]]

    def all_edited(self, path: Array) -> "File":
        """The same honest sources, and one path in every edited scene."""
        return replace(self, edited=np.broadcast_to(path, self.edited.shape))

    def both(self, change: Callable[[Array], Array]) -> "File":
        """The same change of every trajectory."""
        return replace(self, source=change(self.source), edited=change(self.edited))


def _with_origin(paths: Array) -> Array:
    return np.concatenate([np.zeros((len(paths), 1, 2)), paths], axis=1)


def slower(paths: Array, times: float) -> Array:
    """The first waypoints of a file of a shorter time step: `times` too slow."""
    points, at = _with_origin(paths), np.arange(1, 7) / times
    before = np.floor(at).astype(int)
    share = (at - before)[:, None]
    after = np.minimum(before + 1, 6)
    path: Array = points[:, before] * (1 - share) + points[:, after] * share
    return path


def always_brake(file: File, brake_mps2: float = 8.0) -> File:
    """Brake straight ahead from the speed of the source, whatever is in sight."""
    speed = np.linalg.norm(file.source[:, 0], axis=1)[:, None] / TIME_STEP_S
    time_s = np.minimum(np.arange(1, 7) * TIME_STEP_S, speed / brake_mps2)
    driven = speed * time_s - brake_mps2 * time_s**2 / 2
    return replace(file, edited=driven[..., None] * AHEAD)


def rarest_frozen(file: File, share: float = 0.2) -> File:
    """Stand in the rarest families, up to this share of the samples."""
    sizes = np.bincount(file.family)
    edited, n_left = file.edited.copy(), share * len(file.family)
    for family in np.argsort(sizes, kind="stable"):
        if sizes[family] and (n_left := n_left - sizes[family]) >= 0:
            edited[file.family == family] = 0.0
    return replace(file, edited=edited)


def circle(radius_m: float, step_m: float) -> Array:
    """A circle to the left, driven at a steady speed."""
    angle = STEPS[:, 0] * step_m / radius_m
    return np.stack([radius_m * np.sin(angle), radius_m * (1 - np.cos(angle))], axis=1)


def teleporting(file: File) -> File:
    """Be where the source is at every other waypoint, and 12 m aside in between."""
    return replace(file, edited=file.source + 12.0 * (STEPS % 2) * LEFT)


def one_for_all(file: File) -> File:
    """The middle trajectory of all, everywhere."""
    middle = np.nanmedian(file.source, axis=0)
    return replace(file, source=np.broadcast_to(middle, file.source.shape)).all_edited(middle)


CHEATS: Mapping[str, Callable[[File], File]] = {
    "zeros everywhere": lambda f: f.both(np.zeros_like),
    "zeros in edited scenes": lambda f: f.all_edited(0 * STEPS * AHEAD),
    "creep 0.51 m": lambda f: f.all_edited(0.085 * STEPS * AHEAD),
    "always brake": always_brake,
    "always brake gently": lambda f: always_brake(f, 5.0),
    "back 0.51 m": lambda f: f.all_edited(-0.085 * STEPS * AHEAD),
    "back 90 m": lambda f: f.all_edited(-15.0 * STEPS * AHEAD),
    "still but for the last step": lambda f: f.all_edited(-0.51 * (STEPS == 6) * AHEAD),
    "sideways 12 m": lambda f: f.all_edited(2.0 * STEPS * LEFT),
    "the rarest families frozen": rarest_frozen,
    "teleporting between waypoints": teleporting,
    "spinning in place": lambda f: f.all_edited(circle(0.4, 0.5)),
    "huge arcs": lambda f: f.all_edited(circle(40.0, 25.0)),
    "one trajectory for all": one_for_all,
}
"""What gains by the rules alone."""

OF_CONTROLS_ALONE = ("always brake gently",)
"""Which only a split with controls tells from driving."""

MISTAKES: Mapping[str, Callable[[File], File]] = {
    "increments": lambda f: f.both(lambda p: np.diff(_with_origin(p), axis=1)),
    "time step x2": lambda f: f.both(lambda p: slower(p, 2)),
    "time step x5": lambda f: f.both(lambda p: slower(p, 5)),
    "time step x10": lambda f: f.both(lambda p: slower(p, 10)),
    "mirrored": lambda f: f.both(lambda p: p * [1, -1]),
    "x and y exchanged": lambda f: f.both(lambda p: p[..., ::-1]),
    "time reversed": lambda f: f.both(lambda p: p[:, ::-1]),
    "source and edited exchanged": lambda f: replace(f, source=f.edited, edited=f.source),
}
"""What goes wrong on the way to a file."""


def document(file: File, sample_ids: tuple[str, ...], split: str) -> dict[str, Any]:
    """The file as JSON; NaN is null."""

    def path(waypoints: Array) -> Any:
        return None if np.isnan(waypoints).any() else np.round(waypoints, 4).tolist()

    return {
        "schema": "exceptiondrive.planning/1",
        "split": split,
        "predictions": [
            {"sample_id": key, "source": path(source), "edited": path(edited)}
            for key, source, edited in zip(sample_ids, file.source, file.edited, strict=True)
        ],
    }
