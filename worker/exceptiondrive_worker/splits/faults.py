"""What makes a split unusable (docs/protocol.md section 2), found for all samples in one pass.

Faults name sample ids and reveal nothing else that is withheld; they are for the operator's
terminal and the worker's own log.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_schemas.split import Split, SplitSample
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.clearance import touches_start
from exceptiondrive_scoring.region import crosses_itself, is_far, is_small, prepare_regions

Found = tuple[str, list[str]]
"""What is wrong, and the ids of the affected samples."""


@dataclass(frozen=True)
class SplitFault:
    """One kind of fault, with every sample that has it."""

    what: str
    sample_ids: tuple[str, ...]


class SplitRefusedError(ValueError):
    """The split cannot be scored under this protocol; every offending sample is listed."""

    def __init__(self, split_name: str, faults: tuple[SplitFault, ...]) -> None:
        self.faults = faults
        lines = [
            f"{fault.what} ({len(fault.sample_ids)}): {', '.join(fault.sample_ids)}"
            for fault in faults
        ]
        super().__init__(f"split {split_name} is refused:\n" + "\n".join(lines))


def split_faults(split: Split, protocol: ProtocolDocument) -> tuple[SplitFault, ...]:
    """Return every fault of a split under a protocol; without faults it can be scored.

    Task and region of a withdrawn sample are not checked: they may be the reason of its withdrawal.
    """
    left = [sample for sample in split.samples if sample.withdrawn is None]
    ids = [sample.sample_id for sample in split.samples]
    repeated = [sample_id for sample_id, count in Counter(ids).items() if count > 1]
    known = {task.id for task in protocol.tasks}
    strangers = [sample.sample_id for sample in left if sample.task not in known]
    found = (
        ("sample ids that occur more than once", repeated),
        (f"samples of a task that protocol {protocol.version} does not know", strangers),
        *_part_faults(split),
        *_count_faults(split),
        *_recorded_faults(split, protocol.geometry),
        *_region_faults(left, protocol.geometry),
    )
    return tuple(SplitFault(what, tuple(sorted(ids))) for what, ids in found if ids)


def _part_faults(split: Split) -> Iterator[Found]:
    """Require that there are no parts, or that every sample has one and neither part is empty."""
    if split.has_parts:
        yield "samples of no part, though others have one", _ids_of(split, None)
        parts = {sample.part for sample in split.samples} - {None}
        for part in parts if len(parts) == 1 else ():
            yield f"all samples are {part}", [sample.sample_id for sample in split.samples]


def _count_faults(split: Split) -> Iterator[Found]:
    """Require that some sample counts, in the split and in each of its parts."""
    parts = {sample.part for sample in split.samples}
    for part in sorted(parts - {sample.part for sample in split.counted}, key=str):
        where = f" in the {part} part" if part else ""
        yield f"no sample counts: all are controls or withdrawn{where}", _ids_of(split, part)


def _ids_of(split: Split, part: str | None) -> list[str]:
    return [sample.sample_id for sample in split.samples if sample.part == part]


def _recorded_faults(split: Split, geometry: GeometrySection) -> Iterator[Found]:
    told = {each.sample_id: each.recorded for each in split.samples if each.recorded is not None}
    wrong = [name for name, path in told.items() if len(path) != geometry.waypoints]
    limit_m = geometry.max_coordinate_m
    far = [name for name, path in told.items() if any(abs(c) > limit_m for at in path for c in at)]
    yield f"recorded paths of other than {geometry.waypoints} waypoints", wrong
    yield f"recorded paths beyond {limit_m:g} m", far


def _region_faults(samples: Sequence[SplitSample], geometry: GeometrySection) -> list[Found]:
    """Return the faults of regions; each check takes only regions that passed earlier ones."""
    ids = np.array([sample.sample_id for sample in samples])
    regions_m = np.array([it.region for it in samples], dtype=np.float64).reshape(-1, 4, 2)
    sound = np.asarray(np.isfinite(regions_m).all(axis=(1, 2)), dtype=np.bool_)
    faults = [("hazard regions with a corner that is not finite", ids[~sound].tolist())]

    def ask(what: str, question: Callable[[FloatArray], BoolArray]) -> None:
        has_it = np.zeros(len(ids), dtype=np.bool_)
        has_it[sound] = question(regions_m[sound])
        faults.append((what, ids[has_it].tolist()))
        sound[has_it] = False

    limit_m, least_m2 = geometry.max_region_distance_m, geometry.min_region_area_m2
    ask(
        f"hazard regions with a corner more than {limit_m:g} m away",
        lambda regions: is_far(regions, geometry),
    )
    ask("hazard regions that cross or touch themselves", crosses_itself)
    ask(
        f"hazard regions smaller than {least_m2:g} m2",
        lambda regions: is_small(regions, geometry),
    )
    ask(
        "hazard regions that touch the footprint at t = 0",
        lambda regions: touches_start(prepare_regions(regions), geometry),
    )
    return faults
