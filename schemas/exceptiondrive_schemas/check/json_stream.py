"""Reads a JSON document value by value, in bounded memory and with strict rules.

The standard decoder builds a whole document at once, which takes about twelve times the memory of
its text, and it keeps the last of two equal keys. Here the caller walks the two outer levels of a
submission file itself, and the standard decoder parses one short value at a time.
"""

import codecs
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, TypeVar

from exceptiondrive_schemas.check.fault_list import escaped
from exceptiondrive_schemas.faults import FaultCode

MAX_VALUE_CHARACTERS = 256 * 1024
"""A prediction with 200 waypoints of full precision and with blanks stays below a third of this."""
CHUNK_BYTES = 1024 * 1024
LONGEST_TOKEN_START = 16
"""A decoder error this close to the end of the buffered text may be due to that end."""
SAFE_INTEGER_DIGITS = 19
MAX_SKIPPED = 100_000
"""Maximum number of skipped values of a list or object; no split has so many samples."""

BLANKS = " \t\n\r"
_BLANK = re.compile(r"[ \t\n\r]*")
_NEXT_WORD = re.compile(r"\S{0,20}")


class RepeatedKeys(dict[str, Any]):
    """An object with repeated keys, which `repeated` names."""

    repeated: tuple[str, ...] = ()


class JsonStreamError(Exception):
    """The document cannot be read beyond this position."""

    def __init__(self, code: FaultCode, expected: str, got: str) -> None:
        self.code, self.expected, self.got = code, expected, got
        super().__init__(f"expected {expected}, got {got}")


def _integer(digits: str) -> int | float:
    return int(digits) if len(digits) < SAFE_INTEGER_DIGITS else float(digits)


class JsonStream:
    """A position in a JSON document that only moves forward."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._next_byte = 0
        self._utf8 = codecs.getincrementaldecoder("utf-8")("strict")
        self._text = ""
        self._at = 0
        self._lines_before = 0
        self._columns_before = 0
        self._decoder = json.JSONDecoder(object_pairs_hook=self._object, parse_int=_integer)
        self.has_repeated_keys = False
        """Whether an object in the last value had a repeated key."""

    def peek(self) -> str:
        """Skip blanks and return the next character, "" at the end of the document."""
        if self._at < len(self._text) and self._text[self._at] not in BLANKS:
            return self._text[self._at]
        while True:
            self._look_ahead(1)
            blank = _BLANK.match(self._text, self._at)
            self._at = blank.end() if blank else self._at
            if self._at < len(self._text):
                return self._text[self._at]
            if self._next_byte >= len(self._data):
                return ""

    def take(self, character: str) -> bool:
        """Skip blanks, and the character if it comes next; return whether it did."""
        is_next = self.peek() == character
        self._at += is_next
        return is_next

    def value(self) -> Any:
        """Decode the next value.

        Returns:
            None, bool, int, float (NaN and infinities included), str, list or dict; an object with
            a repeated key comes as `RepeatedKeys`.

        Raises:
            JsonStreamError: Not JSON, nested too deeply, too long, or not UTF-8.
        """
        self.peek()
        self.has_repeated_keys = False
        self._look_ahead(MAX_VALUE_CHARACTERS)
        try:
            value, self._at = self._decoder.raw_decode(self._text, self._at)
        except json.JSONDecodeError as error:
            raise self._not_decoded(error) from None
        except RecursionError:
            raise JsonStreamError(
                FaultCode.NESTED_TOO_DEEPLY, "at most a few levels", f"more, {self.place()}"
            ) from None
        return value

    def place(self) -> str:
        """Return line and column of the next character, counted from 1."""
        newlines = self._text.count("\n", 0, self._at)
        column = self._at - (self._text.rfind("\n", 0, self._at) + 1)
        column += 0 if newlines else self._columns_before
        return f"line {self._lines_before + newlines + 1:,} column {column + 1:,}"

    def not_json(self, expected: str) -> JsonStreamError:
        """Return the error that names what was expected in place of what comes next."""
        word = _NEXT_WORD.match(self._text, self._at)
        found = f'"{escaped(word.group())}"' if word and word.group() else "the end of the file"
        return JsonStreamError(FaultCode.NOT_JSON, expected, f"{found} at {self.place()}")

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) == len(pairs):
            return found
        self.has_repeated_keys = True
        times = Counter(key for key, _ in pairs)
        repeated = RepeatedKeys(found)
        repeated.repeated = tuple(key for key, n in times.items() if n > 1)
        return repeated

    def _look_ahead(self, n_characters: int) -> None:
        if len(self._text) - self._at >= n_characters or self._next_byte >= len(self._data):
            return
        kept = [self._drop_read_text()]
        n_kept = len(kept[0])
        while n_kept < n_characters and self._next_byte < len(self._data):
            kept.append(self._next_chunk())
            n_kept += len(kept[-1])
        self._text = "".join(kept)

    def _drop_read_text(self) -> str:
        read = self._text[: self._at]
        newlines = read.count("\n")
        self._lines_before += newlines
        in_line = len(read) - (read.rfind("\n") + 1)
        self._columns_before = in_line if newlines else self._columns_before + in_line
        rest, self._at = self._text[self._at :], 0
        return rest

    def _next_chunk(self) -> str:
        chunk = self._data[self._next_byte : self._next_byte + CHUNK_BYTES]
        first = self._next_byte - len(self._utf8.getstate()[0])
        self._next_byte += len(chunk)
        try:
            return self._utf8.decode(chunk, final=self._next_byte >= len(self._data))
        except UnicodeDecodeError as error:
            self._next_byte = len(self._data)
            at = first + error.start
            got = f"byte 0x{self._data[at]:02x} at position {at:,}"
            raise JsonStreamError(FaultCode.NOT_UTF8, "UTF-8 text", got) from None

    def _not_decoded(self, error: json.JSONDecodeError) -> JsonStreamError:
        is_cut = self._next_byte < len(self._data) and (
            error.pos > len(self._text) - LONGEST_TOKEN_START
            or error.msg.startswith("Unterminated string")
        )
        if is_cut:
            limit = f"at most {MAX_VALUE_CHARACTERS:,} characters"
            return JsonStreamError(FaultCode.VALUE_TOO_LONG, limit, f"more, from {self.place()}")
        self._at = min(error.pos, len(self._text))
        return self.not_json(_EXPECTED.get(error.msg, "valid JSON"))


def members(stream: JsonStream) -> Iterator[str]:
    """Walk the next object: yield each key; the caller takes each value."""
    yield from _items(stream, "{", "}", _key)


def elements(stream: JsonStream) -> Iterator[int]:
    """Walk the next list: yield each index; the caller takes each value."""
    numbers = count()
    yield from _items(stream, "[", "]", lambda _: next(numbers))


def skip(
    stream: JsonStream, on_value: Callable[[str | int, Any], None] = lambda _key, _value: None
) -> None:
    """Skip the next value, a list or object of any length.

    `on_value` gets the index or key, and the value, of each item.
    """
    first = stream.peek()
    if first not in ("{", "["):
        stream.value()
        return
    items: Iterator[str | int] = members(stream) if first == "{" else elements(stream)
    for number, item in enumerate(items):
        if number == MAX_SKIPPED:
            what = "an object" if first == "{" else "a list"
            expected = f"{what} of at most {MAX_SKIPPED:,} values"
            raise JsonStreamError(FaultCode.VALUE_TOO_LONG, expected, "a longer one")
        on_value(item, stream.value())


Item = TypeVar("Item")


def _items(
    stream: JsonStream, opening: str, closing: str, item: Callable[[JsonStream], Item]
) -> Iterator[Item]:
    if not stream.take(opening):
        raise stream.not_json(opening)
    if stream.take(closing):
        return
    yield item(stream)
    while not stream.take(closing):
        if not stream.take(","):
            raise stream.not_json(f"a comma or {closing}")
        yield item(stream)


def _key(stream: JsonStream) -> str:
    if stream.peek() != '"':
        raise stream.not_json("a key in double quotes")
    key = stream.value()
    if not stream.take(":"):
        raise stream.not_json("a colon")
    return str(key)


_EXPECTED = {
    "Expecting value": "a value",
    "Expecting ',' delimiter": "a comma",
    "Expecting ':' delimiter": "a colon",
    "Expecting property name enclosed in double quotes": "a key in double quotes",
    "Illegal trailing comma before end of object": "no comma before the end of an object",
    "Illegal trailing comma before end of array": "no comma before the end of a list",
    "Unterminated string starting at": "the closing quote of this text",
    "Invalid control character at": "no raw control character in a text (escape it)",
    "Invalid \\escape": "a legal escape",
    "Invalid \\uXXXX escape": "four hexadecimal digits",
}
