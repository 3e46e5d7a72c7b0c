"""Fast decoding of `exceptiondrive.planning/1` for client and worker: whole columns, or "not sure".

Decoding leaves each trajectory as a piece of JSON text. All pieces stripped of digits prove the
shape of every trajectory at once; stripped of brackets they are one flat list of numbers. No object
is created per waypoint, which is the main cost of JSON.
"""

from collections.abc import Sequence
from itertools import compress
from typing import NamedTuple

import msgspec

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.fast_decode import (
    ROOT_TEXTS,
    are_short,
    decode,
    n_texts,
    prediction_type,
    submission_decoder,
)
from exceptiondrive_schemas.check.json_stream import MAX_VALUE_CHARACTERS

TEXTS_PER_PREDICTION = 4
"""Keys `sample_id`, `source`, `edited`, and the id."""
BARE_PREDICTION = '{"sample_id":"","source":,"edited":}'
NULL = b"null"
NO_NUMBERS_NO_BLANKS = b"+-.0123456789Ee \t\n\r"
BRACKETS_TO_BLANKS = bytes.maketrans(b"[]", b"  ")
NUMBERS = msgspec.json.Decoder(list[float], strict=True)
DECODER = submission_decoder(
    prediction_type(
        "PlanningPrediction",
        [("sample_id", str), ("source", msgspec.Raw), ("edited", msgspec.Raw)],
    )
)


class Side(NamedTuple):
    """The source or the edited trajectories of a file of N predictions with T waypoints each.

    Attributes:
        is_given: (N,) False for null.
        numbers: Coordinates of the given ones, one after the other: x1, y1, x2, y2, ...
    """

    is_given: Sequence[bool]
    numbers: list[float]


class PlanningColumns(NamedTuple):
    """A file whose trajectories all have the right shape, in file order; bounds are not checked."""

    split: str
    sample_ids: Sequence[str]
    source: Side
    edited: Side


def planning_columns(text: bytes, n_waypoints: int) -> PlanningColumns | None:
    """Decode an inflated planning file; None if it is faulty or not certainly sound."""
    submission = decode(text, DECODER, PLANNING.file_schema)
    if submission is None:
        return None
    predictions = submission.predictions
    if n_texts(text) != ROOT_TEXTS + TEXTS_PER_PREDICTION * len(predictions):
        return None
    sample_ids = [each.sample_id for each in predictions]
    sources = [each.source for each in predictions]
    edits = [each.edited for each in predictions]
    if not _are_short(text, sample_ids, sources, edits):
        return None
    source, edited = _side(sources, n_waypoints), _side(edits, n_waypoints)
    if source is None or edited is None:
        return None
    return PlanningColumns(submission.split, sample_ids, source, edited)


def _are_short(
    text: bytes,
    sample_ids: Sequence[str],
    sources: Sequence[msgspec.Raw],
    edits: Sequence[msgspec.Raw],
) -> bool:
    """Whether no prediction is longer than the precise checker accepts, blanks included."""
    parts = (sample_ids, sources, edits)
    longest = len(BARE_PREDICTION) + sum(max(map(len, part), default=0) for part in parts)
    n_bare = len(BARE_PREDICTION) * len(sample_ids) + sum(sum(map(len, part)) for part in parts)
    blanks_in_one = longest + len(text) - n_bare  # if all blanks were in one prediction
    return blanks_in_one <= MAX_VALUE_CHARACTERS or are_short(text)


def _side(texts: Sequence[msgspec.Raw], n_waypoints: int) -> Side | None:
    """Return N JSON texts as numbers; None if one is neither null nor `[[x, y] x T]`."""
    given, is_given, joined = texts, [True] * len(texts), b",".join(texts)
    if not _are_trajectories(joined, len(given), n_waypoints):
        is_given = [bytes(text) != NULL for text in texts]
        given = list(compress(texts, is_given))
        joined = b",".join(given)
        if not _are_trajectories(joined, len(given), n_waypoints):
            return None
    try:
        numbers = NUMBERS.decode(b"[" + joined.translate(BRACKETS_TO_BLANKS) + b"]")
    except msgspec.DecodeError:
        return None
    return Side(is_given, numbers)


def _are_trajectories(joined: bytes, n: int, n_waypoints: int) -> bool:
    """Whether texts, joined by commas, have the shape of N trajectories, whatever their numbers."""
    one = b"[" + b",".join([b"[,]"] * n_waypoints) + b"]"
    return joined.translate(None, NO_NUMBERS_NO_BLANKS) == b",".join([one] * n)
