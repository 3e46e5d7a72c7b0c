"""Shared by all fast readers: strict decoding into a fixed shape, unique keys, alignment.

No parser reports a repeated key; the last one wins. But a fixed shape fixes the number of strings
in a file, and without backslashes every string has exactly two quotation marks. So counting those
marks proves that no key is repeated.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import msgspec

from exceptiondrive_schemas.check.json_stream import MAX_VALUE_CHARACTERS
from exceptiondrive_schemas.split import Manifest

ROOT_TEXTS = 5
"""Keys `schema`, `split`, `predictions`, and the values of the first two."""


class DecodedFile(Protocol):
    """The outer object of all files."""

    schema: str
    split: str
    predictions: list[Any]


def prediction_type(name: str, fields: Sequence[Any]) -> type[msgspec.Struct]:
    """Return the type of an object with exactly these fields."""
    return msgspec.defstruct(name, fields, forbid_unknown_fields=True, gc=False)


def submission_decoder(prediction: type[Any]) -> msgspec.json.Decoder[Any]:
    """Return the decoder of a whole file with predictions of this type."""
    submission = msgspec.defstruct(
        "Submission",
        [("schema", str), ("split", str), ("predictions", list[prediction])],  # type: ignore[valid-type]
        forbid_unknown_fields=True,
    )
    return msgspec.json.Decoder(submission, strict=True)


WHOLE_PREDICTIONS = submission_decoder(msgspec.Raw)


def are_short(text: bytes) -> bool:
    """Whether no prediction of a decodable file is longer than the precise checker accepts.

    Blanks are included.
    """
    return len(text) <= MAX_VALUE_CHARACTERS or all(
        len(each) <= MAX_VALUE_CHARACTERS for each in WHOLE_PREDICTIONS.decode(text).predictions
    )


def decode(text: bytes, decoder: msgspec.json.Decoder[Any], file_schema: str) -> DecodedFile | None:
    """Decode a file of this schema; None if it does not fit, or needs the precise checker."""
    if b"\\" in text or not text.isascii():
        return None
    try:
        submission: DecodedFile = decoder.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return None
    return submission if submission.schema == file_schema else None


def n_texts(text: bytes) -> float:
    """Return the number of JSON strings, keys included, of a document without a backslash."""
    return text.count(b'"') / 2


def rows_of(sample_ids: Sequence[str], manifest: Manifest) -> Sequence[int] | None:
    """Return the position of each prediction in the manifest's order; None unless one-to-one."""
    if tuple(sample_ids) == manifest.sample_ids:
        return range(len(sample_ids))
    row_of_id = {sample_id: row for row, sample_id in enumerate(manifest.sample_ids)}
    try:
        rows = [row_of_id[sample_id] for sample_id in sample_ids]
    except KeyError:
        return None
    is_complete = len(rows) == len(row_of_id) == len(set(rows))
    return rows if is_complete else None
