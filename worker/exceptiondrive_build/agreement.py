"""The result of two blind readings of a region, a third if they differ, and how well readers agree.

Two regions agree by their intersection over union and by the greatest distance of their corners;
two verdicts, accepted or rejected, by Krippendorff's alpha (K. Krippendorff, Content Analysis,
chapter on reliability; nominal data), as the package `krippendorff` computes it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal

import krippendorff
import numpy as np
import shapely

from exceptiondrive_build.records import Record, person_key
from exceptiondrive_build.settings import VerifySection
from exceptiondrive_build.values import Corners, Verified
from exceptiondrive_schemas.datasheet import Agreement
from exceptiondrive_scoring.aliases import FloatArray

N_BLIND = 2
State = Literal["open", "third", "verified", "rejected"]


@dataclass(frozen=True)
class Outcome:
    """The result of the readings of one candidate.

    Attributes:
        state: `open`: a blind reading is missing; `third`: two differ, and a third reader decides.
        corners: The region, if verified; the same list whoever read first, and whichever corner
            theirs began with.
    """

    state: State
    corners: Corners | None = None


def readings(records: Sequence[Record]) -> list[tuple[str, Verified]]:
    """Return the newest reading of each person, in the order of the records."""
    newest = {person_key(it.by.person): it for it in records if it.value is not None}
    return [
        (str(record.by.person), Verified.model_validate(record.value, strict=False))
        for record in sorted(newest.values(), key=lambda record: record.id or 0)
    ]


def blind_pair(records: Sequence[Record]) -> tuple[tuple[str, Verified], ...]:
    """Return the first two blind readings, or fewer."""
    return tuple(one for one in readings(records) if one[1].blind)[:N_BLIND]


def outcome(records: Sequence[Record], limits: VerifySection) -> Outcome:
    """Return the result of the standing verifications of one candidate, given oldest first.

    The region of two that agree is the middle between theirs; a third reader's decision is final,
    unless one of the two has decided again since.
    """
    words = readings(records)
    pair = blind_pair(records)
    if len(pair) < N_BLIND:
        return Outcome("open")
    (_, first), (_, second) = pair
    if not first.accepted and not second.accepted:
        return Outcome("rejected")
    if first.accepted and second.accepted:
        between = middle(first.corners, second.corners, limits)
        if between is not None:
            return Outcome("verified", between)
    for _, word in reversed(words[words.index(pair[-1]) :]):
        if not word.blind:
            corners = word.corners and in_order(word.corners)
            return Outcome("verified", corners) if word.accepted else Outcome("rejected")
    return Outcome("third")


def readings_left(records: Sequence[Record], limits: VerifySection) -> int:
    """Return how many more readings a region needs, by its candidate's standing verifications."""
    state = outcome(records, limits).state
    return {"open": N_BLIND - len(blind_pair(records)), "third": 1}.get(state, 0)


def middle(one: Corners | None, other: Corners | None, limits: VerifySection) -> Corners | None:
    """Return the region between two that agree, to the centimetre; None if too far apart."""
    if one is None or other is None:
        return None
    one, other = sorted((in_order(one), in_order(other)))
    if one == other:
        return one
    between: FloatArray = ((np.array(one) + aligned(one, other)) / 2).round(2) + 0.0
    agree = (
        iou(one, other) >= limits.min_iou
        and corner_distance_m(one, other) <= limits.max_corner_distance_m
        and bool(shapely.is_valid(shapely.polygons(between)))
    )
    return in_order(tuple((float(x), float(y)) for x, y in between)) if agree else None  # type: ignore[arg-type]


def iou(one: Corners, other: Corners) -> float:
    """Return the intersection over union of two quadrilaterals; 0 if one of them crosses itself."""
    a, b = (shapely.Polygon(it) for it in sorted((in_order(one), in_order(other))))
    if not (a.is_valid and b.is_valid):
        return 0.0
    return float(a.intersection(b).area / a.union(b).area)


def corner_distance_m(one: Corners, other: Corners) -> float:
    """Return the greatest distance of corresponding corners, wherever each list begins."""
    return float(np.hypot(*(np.array(one) - aligned(one, other)).T).max())


def aligned(one: Corners, other: Corners) -> FloatArray:
    """Return the corners of the other, (4, 2), ordered so that they are nearest to those of one."""
    return min(
        map(np.array, orders(other)),
        key=lambda corners: float(np.hypot(*(np.array(one) - corners).T).max()),
    )


def in_order(corners: Corners) -> Corners:
    """Return the canonical corner list of a quadrilateral, whatever its start and orientation."""
    return min(orders(corners))


def orders(corners: Corners) -> list[Corners]:
    """Return all corner lists of the same quadrilateral."""
    a, b, c, d = corners
    ahead = [(a, b, c, d), (b, c, d, a), (c, d, a, b), (d, a, b, c)]
    return [*ahead, *((z, y, x, w) for w, x, y, z in ahead)]


def agreement(verifications: Mapping[str, Sequence[Record]], limits: VerifySection) -> Agreement:
    """Measure how blind readers agree, from each candidate's verifications, oldest first.

    Returns:
        Over all candidates with two blind readings; intersection over union, and the greatest
        distance of two corners, of the regions that both accepted.
    """
    pairs = [
        pair for records in verifications.values() if len(pair := blind_pair(records)) == N_BLIND
    ]
    words = [(first, second) for (_, first), (_, second) in pairs]
    accepted = [
        (first.corners, second.corners)
        for first, second in words
        if first.accepted and second.accepted and first.corners and second.corners
    ]
    overlaps = [iou(*corners) for corners in accepted]
    same_word = sum(first.accepted == second.accepted for first, second in words)
    near = sum(middle(*corners, limits) is not None for corners in accepted)
    return Agreement(
        n=len(pairs),
        both_accepted=len(accepted),
        same_word=same_word,
        beyond=len(pairs) - near - sum(not (a.accepted or b.accepted) for a, b in words),
        iou_mean=fmean(overlaps) if overlaps else None,
        iou_median=float(np.median(overlaps)) if overlaps else None,
        corner_m_max=max((corner_distance_m(*corners) for corners in accepted), default=None),
        alpha=_alpha(pairs),
    )


def _alpha(pairs: Iterable[tuple[tuple[str, Verified], ...]]) -> float | None:
    given = [{person: float(word.accepted) for person, word in pair} for pair in pairs]
    people = sorted({person for words in given for person in words})
    table = np.array([[words.get(person, np.nan) for words in given] for person in people])
    if len(np.unique(table[~np.isnan(table)])) < 2:
        return None
    return float(krippendorff.alpha(reliability_data=table, level_of_measurement="nominal"))
