"""Floors of a withheld split: limits to what is published of it, whatever a phase or protocol says.

They are in `floors.toml` beside the split file, which only workers read and no organizer, API or
server writes. A worker that is asked for more publishes nothing and writes that to the audit log.
Missing values, or a missing file, have advised defaults: protocol `1.1-withheld` passes, and
smaller cells do not. A public split needs no floors.
"""

import json
from collections.abc import Iterator
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, Self

import tomllib
from pydantic import Field, ValidationError, model_validator

from exceptiondrive_schemas.api.confirmation import PublicKey
from exceptiondrive_schemas.base import Document, faults_in
from exceptiondrive_schemas.protocol import ProtocolDocument

FLOORS_FILE = "floors.toml"

NEEDED = 2
"""Number of organizers who must confirm if a split asks for a second one."""
Bounds = tuple[float, float]
Count = Annotated[int, Field(ge=1)]
Decimals = Annotated[int, Field(ge=0, le=4)]
_GEOMETRY = (
    "footprint_length_m",
    "footprint_width_m",
    "footprint_centre_ahead_m",
    "waypoints",
    "max_step_m",
    "max_coordinate_m",
    "min_region_area_m2",
    "max_region_distance_m",
)
"""Fields of a protocol that have bounds of the same name."""


class SplitFloors(Document):
    """Limits to what a worker publishes of a withheld split.

    Bounds are the least and the largest allowed value; those of `d_safe_m` apply to every required
    clearance of the protocol, including those from its sensitivity factors.
    """

    min_samples_per_cell: Count = 100
    max_percent_decimals: Decimals = 2
    max_metre_decimals: Decimals = 2
    max_compared_entries: Annotated[int, Field(ge=0)] = 10
    max_sensitivity_factors: Annotated[int, Field(ge=0)] = 2
    max_curve_points: Count = 21
    shows: tuple[Literal["clearance_curve", "outcome_cells"], ...] = ()
    """What a protocol may publish of all splits, and so of this one."""
    footprint_length_m: Bounds = (4.0, 6.0)
    footprint_width_m: Bounds = (1.6, 2.2)
    footprint_centre_ahead_m: Bounds = (1.0, 2.0)
    collision_tubes: tuple[Literal["hulls", "footprints"], ...] = ("hulls",)
    d_safe_m: Bounds = (0.25, 4.0)
    waypoints: Bounds = (6, 6)
    max_step_m: Bounds = (30.0, 30.0)
    max_coordinate_m: Bounds = (200.0, 200.0)
    min_region_area_m2: Bounds = (0.01, 0.01)
    max_region_distance_m: Bounds = (100.0, 100.0)
    """This and the two before limit what a protocol may refuse: refusals would sort the samples."""
    max_protocols: Count = 3
    """Number of protocols under which the split may ever be scored."""
    max_scored_per_day: Count = 100
    """Submissions that may get their first sheet within 24 hours, over all phases and teams."""
    private_part_from: datetime | None = None
    """The private part is not scored before this time; with a time zone."""
    second_organizer: bool = False
    """Whether two of `organizers` must sign that a revision is scored under a protocol."""
    organizers: dict[str, PublicKey] = Field(default_factory=dict)
    """Name to public key, as `exceptiondrive organizer protocols key` prints it."""

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        for name in ("d_safe_m", *_GEOMETRY):
            least, most = getattr(self, name)
            if not 0 <= least <= most:
                raise ValueError(f"{name}: the least comes first, and none is negative")
        n_keys = len(set(self.organizers.values()))
        if n_keys < len(self.organizers):
            raise ValueError("organizers: each has a key of their own")
        if self.second_organizer and n_keys < NEEDED:
            raise ValueError(f"second_organizer needs {NEEDED} organizers with their keys")
        if self.private_part_from is not None and self.private_part_from.tzinfo is None:
            raise ValueError("private_part_from needs a time zone, such as Z")
        return self


class FloorsUnreadableError(ValueError):
    """The floors of a split cannot be read: nothing of it is scored until they can be."""


class FloorHeldError(ValueError):
    """A request exceeds the floors of a withheld split; `asked` says how, in words."""

    def __init__(self, *asked: str) -> None:
        self.asked = asked
        super().__init__("; ".join(asked))


class SplitDayFullError(FloorHeldError):
    """As many submissions as the floors allow were scored within a day."""


def read_floors(folder: Path) -> SplitFloors:
    """Return the floors in the folder of a split; the advised ones if it has none.

    Raises:
        FloorsUnreadableError: The file is invalid, each problem is named; or there is no split, for
            example because the folder is not mounted.
    """
    try:
        return _floors_of((folder / FLOORS_FILE).read_text("utf-8"))
    except FileNotFoundError:
        if not any(folder.glob("split*.json*")):
            raise FloorsUnreadableError(f"there is no split in {folder.absolute()}") from None
        return SplitFloors()
    except ValidationError as error:
        lines = "\n".join(faults_in(error))
        raise FloorsUnreadableError(f"{FLOORS_FILE} of {folder.name}:\n{lines}") from None
    except (OSError, ValueError) as error:
        raise FloorsUnreadableError(
            f"{FLOORS_FILE} of {folder.name} cannot be read ({type(error).__name__})"
        ) from None


@lru_cache(maxsize=64)
def _floors_of(text: str) -> SplitFloors:
    """Parse the text, cached: every score reads the file, which rarely changes."""
    document = tomllib.loads(text)
    return SplitFloors.model_validate_json(json.dumps(document, default=str))


def breaches(floors: SplitFloors, protocol: ProtocolDocument) -> Iterator[str]:
    """Yield, in words, each way in which a protocol exceeds the floors."""
    publication, geometry = protocol.publication, protocol.geometry
    least = floors.min_samples_per_cell
    if publication.min_samples_per_cell < least:
        yield f"min_samples_per_cell is {publication.min_samples_per_cell}, the floor is {least}"
    numbers = (
        ("percent_decimals", publication.percent_decimals, floors.max_percent_decimals),
        ("metre_decimals", publication.metre_decimals, floors.max_metre_decimals),
        ("compared_entries", publication.compared_entries, floors.max_compared_entries),
        (
            "the number of sensitivity_factors",
            len(protocol.grading.sensitivity_factors),
            floors.max_sensitivity_factors,
        ),
        (
            "the number of points of a clearance_curve",
            _curve_points(protocol),
            floors.max_curve_points,
        ),
    )
    for name, value, most in numbers:
        if value > most:
            yield f"{name} is {value}, at most {most} may be"
    for name in ("clearance_curve", "outcome_cells"):
        if getattr(publication, name) == "all_splits" and name not in floors.shows:
            yield f'{name} is "all_splits", which the floors do not show'
    if geometry.collision_tube not in floors.collision_tubes:
        yield f'collision_tube is "{geometry.collision_tube}", which the floors do not allow'
    ranges = (
        *((name, getattr(geometry, name)) for name in _GEOMETRY),
        *(("d_safe_m", value) for value in _required_clearances_m(protocol)),
    )
    told = set()
    for name, number in ranges:
        low, high = getattr(floors, name)
        if not low <= number <= high and name not in told:
            told.add(name)
            yield f"{name} is {number:g}, it must lie from {low:g} to {high:g}"


def unconfirmed(floors: SplitFloors, keys: set[str]) -> Iterator[str]:
    """Yield, in words, whose confirmation is missing.

    `keys` are the public keys with a valid signature on the request; unlisted ones do not count.
    """
    names = sorted(name for name, key in floors.organizers.items() if key in keys)
    if floors.second_organizer and len(names) < NEEDED:
        who = f"{' and '.join(names)} alone" if names else "nobody"
        yield f"it is confirmed by {who}, and {NEEDED} of {len(floors.organizers)} organizers must"


def _curve_points(protocol: ProtocolDocument) -> int:
    """Return the number of points of a withheld split's clearance curve; 0 if none is published."""
    grading = protocol.grading
    if not protocol.publication.shows_curve(is_public_split=False):
        return 0
    return 1 + round(grading.clearance_curve_until / grading.clearance_curve_step)


def _required_clearances_m(protocol: ProtocolDocument) -> list[float]:
    grading = protocol.grading
    d_safe_m = [task.d_safe_m * grading.d_safe_scale for task in protocol.tasks]
    return [each * factor for each in d_safe_m for factor in (1.0, *grading.sensitivity_factors)]
