"""Protocol documents that are valid by the schema but cannot be intended.

Checked when an organizer adds or checks a document, never for a recorded one: scores made under it
stay readable.
"""

from collections import Counter
from collections.abc import Iterator

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument, RankingSection

FOOTPRINT_LENGTH_M = (0.5, 55.0)
"""From a delivery robot to a road train."""
FOOTPRINT_WIDTH_M = (0.3, 5.0)
LEAST_D_SAFE_M = 0.01
"""No sensor measures less, and every sample without contact would get the full score."""


def nonsense(protocol: ProtocolDocument) -> list[str]:
    """Return a line for each value that cannot be intended: its place, the value, and why not."""
    return [
        *_changes(protocol),
        *_footprint(protocol.geometry),
        *_clearances(protocol),
        *_orders(protocol.ranking),
    ]


def _changes(protocol: ProtocolDocument) -> Iterator[str]:
    if not protocol.changes.strip():
        yield "changes: is empty; say to readers what this version changes"


def _footprint(geometry: GeometrySection) -> Iterator[str]:
    for name, (least_m, most_m) in (
        ("footprint_length_m", FOOTPRINT_LENGTH_M),
        ("footprint_width_m", FOOTPRINT_WIDTH_M),
    ):
        value_m = getattr(geometry, name)
        if not least_m <= value_m <= most_m:
            yield (
                f"geometry.{name}: no vehicle is {value_m:g} m; should be from {least_m:g} to "
                f"{most_m:g}"
            )


def _clearances(protocol: ProtocolDocument) -> Iterator[str]:
    for number, task in enumerate(protocol.tasks):
        d_safe_m = task.d_safe_m * protocol.grading.d_safe_scale
        if d_safe_m < LEAST_D_SAFE_M:
            yield (
                f"tasks.{number} ({task.id}).d_safe_m: {d_safe_m:g} m, scaled, is no clearance; "
                f"should be at least {LEAST_D_SAFE_M:g}"
            )


def _orders(ranking: RankingSection) -> Iterator[str]:
    for challenge_id, keys in ranking.order.items():
        place = f"ranking.order.{challenge_id}"
        for metric, count in Counter(key.metric for key in keys).items():
            if count > 1:
                yield f"{place}: {metric} stands {count} times; once is enough"
        better_first = {key.metric: key.order for key in CHALLENGES[challenge_id].primary_order}
        for key in keys:
            if key.order != better_first[key.metric]:
                yield (
                    f"{place}: {key.order} puts the worst {key.metric} first; should be "
                    f"{better_first[key.metric]}"
                )
