"""What both fast readers share: strict decoding into a fixed shape, unique keys, alignment.

No parser reports that a key stands twice; the last one wins. But a fixed shape fixes how many texts
a file holds, and where no backslash occurs every text has exactly two quotation marks. So counting
those marks proves that every key stands once.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.split import Manifest

QUOTES_PER_TEXT = 2
ROOT_TEXTS = 5
"""Keys `schema`, `split`, `predictions`, and the values of the first two."""


class DecodedFile(Protocol):
    """The outer object of both files."""

    schema: str
    split: str
    predictions: list[Any]


def prediction_type(name: str, fields: Sequence[Any]) -> type[msgspec.Struct]:
    """Return the type of an object with exactly these fields."""
    return msgspec.defstruct(name, fields, forbid_unknown_fields=True, gc=False)


def submission_decoder(prediction: type[msgspec.Struct]) -> msgspec.json.Decoder[Any]:
    """Return the decoder of a whole file with predictions of this type."""
    submission = msgspec.defstruct(
        "Submission",
        [("schema", str), ("split", str), ("predictions", list[prediction])],  # type: ignore[valid-type]
        forbid_unknown_fields=True,
    )
    return msgspec.json.Decoder(submission, strict=True)


def decode(
    text: bytes, decoder: msgspec.json.Decoder[Any], file_schema: str, manifest: Manifest
) -> DecodedFile | None:
    """Decode a file that is for this schema and split and has the right number of predictions.

    Returns:
        None where the text does not fit, or holds anything that calls for the precise checker.
    """
    if b"\\" in text or not text.isascii():
        return None
    try:
        submission: DecodedFile = decoder.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return None
    is_wanted = (
        submission.schema == file_schema
        and submission.split == manifest.name
        and len(submission.predictions) == len(manifest.sample_ids)
    )
    return submission if is_wanted else None


def n_texts(text: bytes) -> float:
    """Number of JSON texts, keys included, of a document without a backslash."""
    return text.count(b'"') / QUOTES_PER_TEXT


def rows_of(predictions: Sequence[Any], manifest: Manifest) -> NDArray[np.intp] | None:
    """Return where each prediction belongs in the manifest's order; None unless it is one-to-one."""
    row_of_id = {sample_id: row for row, sample_id in enumerate(manifest.sample_ids)}
    try:
        rows = [row_of_id[prediction.sample_id] for prediction in predictions]
    except KeyError:
        return None
    if len(set(rows)) != len(manifest.sample_ids):
        return None
    return np.array(rows, dtype=np.intp)
