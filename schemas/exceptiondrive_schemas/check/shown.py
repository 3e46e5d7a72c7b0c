"""How a value of an uploaded file is shown in a report: short, on one line, escaped."""

import json
import math
from typing import Any

from exceptiondrive_schemas.printable import counted

MAX_SHOWN_CHARACTERS = 60

JSON_KINDS = {bool: "a boolean", int: "a number", float: "a number", str: "text"}


def escaped(text: str) -> str:
    r"""Return at most 60 characters of `text`, all of them printable.

    Control characters, lone surrogates and invisible or direction-turning marks become `\uXXXX`:
    what the reader sees is what the file holds, and it can be printed anywhere.
    """
    shown = "".join(
        character if character.isprintable() else f"\\u{ord(character):04x}"
        for character in text[:MAX_SHOWN_CHARACTERS]
    )
    return shown if len(shown) <= MAX_SHOWN_CHARACTERS else shown[:MAX_SHOWN_CHARACTERS]


def quoted(text: str) -> str:
    """Return `text` in quotes; a long one is cut, and its length told."""
    if len(text) <= MAX_SHOWN_CHARACTERS:
        return f'"{escaped(text)}"'
    return f'"{escaped(text)}..." ({len(text):,} characters)'


def shown(value: Any) -> str:
    """Describe one decoded JSON value in a few words.

    Args:
        value: None, bool, int, float, str, list or dict, as the JSON decoder gave it.
    """
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, dict):
        return f"an object with {counted(len(value), 'key')}"
    if isinstance(value, list):
        return f"a list of {counted(len(value), 'value')}"
    if isinstance(value, float) and math.isinf(value):
        return f"{'-' if value < 0 else ''}Infinity, or a number too large to hold"
    return json.dumps(value)


def kind(value: Any) -> str:
    """Return the JSON kind of a value with an article, to stand after "got"."""
    return JSON_KINDS.get(type(value), shown(value))


def json_path(parts: tuple[str | int, ...]) -> str:
    """Return the JSON path of a place: `$.predictions[3].edited[2][0]`."""
    return "$" + "".join(_step(part) for part in parts)


def _step(part: str | int) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    is_plain = part.isidentifier() and part.isascii() and len(part) <= MAX_SHOWN_CHARACTERS
    return f".{part}" if is_plain else f"[{quoted(part)}]"
