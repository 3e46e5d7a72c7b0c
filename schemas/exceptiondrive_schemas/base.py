"""The one model base, canonical JSON, and content digests. Readers are lenient, writers strict.

Everything that is stored, compared or signed is identified by the SHA-256 of its canonical JSON:
sorted keys, no blanks, UTF-8, shortest round-trip floats, never NaN or infinity.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from exceptiondrive_schemas.forgiving import FORGIVING, read_newer
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.short import html, short

_Read = TypeVar("_Read")


class _Bare(str):
    """A text that is represented without quotes."""

    def __repr__(self) -> str:
        return str(self)


class Document(BaseModel):
    """Immutable and strict: an unknown key is an error, a number never comes from a string."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, populate_by_name=True, ser_json_inf_nan="null"
    )

    decides_scores: ClassVar[bool] = False
    """Whether scores follow from it: then every word and number of an answer has to be known here."""

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """Yield the parts of the short form: non-default values, long ones counted or cut."""
        for name, value in self:
            field = type(self).model_fields.get(name)
            if (
                field is not None
                and not field.is_required()
                and value == field.get_default(call_default_factory=True, validated_data={})
            ):
                continue
            yield name, short(value) if isinstance(value, str) else _Bare(short(value))

    def _repr_html_(self) -> str:
        """Return tables for a notebook."""
        return html(self)

    @classmethod
    def read(cls, answer: str | bytes) -> Self:
        """Read an answer or a stored document of a server that may be newer; ignore unknown fields.

        Unknown words and numbers out of bounds are kept as they are. Files from participants and
        organizers are read by `model_validate_json`, which is strict. Validators that require known
        names look for `FORGIVING` in their context.

        Raises:
            ValidationError: A known field is missing, or of another type.
        """
        try:
            return cls.model_validate_json(answer)
        except ValidationError:
            return cls._read(TypeAdapter(cls), answer)

    @classmethod
    def read_all(cls, answer: str | bytes) -> tuple[Self, ...]:
        """Read a list of them, each like `read`."""
        many: TypeAdapter[tuple[Self, ...]] = TypeAdapter(tuple[cls, ...])  # type: ignore[valid-type]
        return cls._read(many, answer)

    @classmethod
    def _read(cls, kind: TypeAdapter[_Read], answer: str | bytes) -> _Read:
        read = partial(kind.validate_json, extra="allow", context=FORGIVING)
        return read(answer) if cls.decides_scores else read_newer(read, answer)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy; cached properties are computed again from the copy's fields."""
        copied = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


def faults_in(error: ValidationError) -> list[str]:
    """Return each fault with its place, without values: `samples.0.task: Field required`."""
    found = error.errors(include_url=False, include_input=False, include_context=False)
    places = (".".join(map(str, each["loc"])) for each in found)
    words = (fault_words(each["msg"]) for each in found)
    return [f"{at}: {said}" if at else said for at, said in zip(places, words, strict=True)]


def fault_words(said: str) -> str:
    """Return pydantic's message, with our own words for frequent ones."""
    said = said.removeprefix("Value error, ")
    return _OUR_WORDS.get(said, said)


NO_OBJECT = "must be a JSON object"
_OUR_WORDS = {
    "String should have at least 1 character": "must not be empty",
    "Input should be a valid dictionary or object to extract fields from": NO_OBJECT,
    "Input should be a valid dictionary": NO_OBJECT,
    "Input should be a valid tuple": "must be a list",
    "Input should be a valid list": "must be a list",
    "List should have at least 1 item after validation, not 0": "must hold at least one",
}
"""Replacements for frequent messages that use terms of Python, for people who send JSON."""


def in_words(words: str) -> WrapValidator:
    """Return an annotation for a type that reports invalid values with these words."""

    def read_or_say(value: Any, read: ValidatorFunctionWrapHandler) -> Any:
        try:
            return read(value)
        except ValidationError:
            raise ValueError(words) from None

    return WrapValidator(read_or_say)


def canonical_json(value: Any) -> bytes:
    """Return the canonical byte string of a JSON value, or of a `Document`.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json", by_alias=True)
    text = json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8")


def content_digest(value: Any) -> str:
    """Return `sha256:` and the hex digest of the canonical JSON of `value`."""
    return bytes_digest(canonical_json(value))


def bytes_digest(data: bytes) -> str:
    """Return `sha256:` and the hex digest of bytes."""
    return pieces_digest([data])


def pieces_digest(pieces: Iterable[bytes]) -> str:
    """Return `sha256:` and the hex digest of bytes given in pieces."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return "sha256:" + digest.hexdigest()
