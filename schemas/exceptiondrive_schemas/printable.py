"""Text that reaches a screen: counted nouns, and the last line of defence against unsafe signs.

Uploads are refused names that cannot be shown (`checked_text`). Outputs do not rely on it: older
rows, hand-made records and foreign servers are cleaned here once more, just before they are shown.
"""

import math
import re
import unicodedata
from collections.abc import Sequence

REPLACEMENT = "\ufffd"
MINUS = "\u2212"
_UNSAFE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters; ESC and CSI steer terminals
    "\u061c\u200b-\u200f\u202a-\u202e\u2060-\u2069\ufeff"  # invisible, or turning the direction
    "\u2028\u2029\ufff9-\ufffb\ud800-\udfff]"  # line separators, annotations, lone surrogates
)
_FORMULA = "=+-@\uff1d\uff0b\uff0d\uff20"  # and their full-width forms
_CELL_START = rf"(^|;\s*)(?=[{re.escape(_FORMULA)}{REPLACEMENT}])"
"""Where a formula would begin: a spreadsheet of many a country parts cells at `;`, quoted or not."""
_QUOTED_START = _CELL_START.replace("(?=", "'(?=")


def shown_text(
    kind: str,
    text: str,
    *,
    max_length: int,
    may_be_empty: bool = False,
    may_have_lines: bool = False,
) -> str:
    """Return `text` in Unicode form NFC, without surrounding blanks, if it can be shown safely.

    A line ends with one character, as browsers count it that send two. Control, zero-width and
    direction characters are refused: they make two names look alike.

    Raises:
        ValueError: It is empty, too long, or with characters that cannot be shown.
    """
    text = unicodedata.normalize("NFC", text).strip()
    if may_have_lines:
        text = text.replace("\r\n", "\n")
    if not text and not may_be_empty:
        raise ValueError(f"The {kind} must not be empty.")
    if len(text) > max_length:
        raise ValueError(f"The {kind} is longer than {max_length} characters.")
    unseen = (c for c in text if not (c.isprintable() or (may_have_lines and c == "\n")))
    if (first := next(unseen, None)) is not None:
        named = f"U+{ord(first):04X}"
        raise ValueError(
            f"The {kind} holds characters that cannot be shown by themselves, such as {named}."
        )
    return text


def printable(text: str) -> str:
    """Return `text` in which each unsafe character became a replacement sign.

    Lines are kept, and end with one character; browsers send two, and a refused form shows them.
    """
    return _UNSAFE.sub(REPLACEMENT, text.replace("\r\n", "\n"))


def one_line(text: str) -> str:
    """Return `text` on one line: a mail header, a CSV cell, a comment can hold no break."""
    return printable(" ".join(text.split()))


def spreadsheet_text(text: str) -> str:
    """Return a cell that no spreadsheet runs as a formula."""
    return re.sub(_CELL_START, r"\1'", one_line(text))


def from_spreadsheet(text: str) -> str:
    """Return the text of which `spreadsheet_text` made a cell."""
    return re.sub(_QUOTED_START, r"\1", text)


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """Return `1 value`, `1,000 values`, `3 entries`."""
    return f"{count:,} {noun if count == 1 else plural or noun + 's'}"


def duration_words(seconds: float) -> str:
    """Write a length of time in its largest unit: `12 s`, `5 minutes`, `3 hours`, `2 days`."""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    if seconds < 90 * 60:
        return counted(round(seconds / 60), "minute")
    if seconds < 36 * 3600:
        return counted(round(seconds / 3600), "hour")
    return counted(round(seconds / 86400), "day")


def percent_of(n: int, of: int) -> str:
    """Return a share in per cent, to two places; a dash where nothing came in."""
    return f"{100 * n / of:.2f} %" if of else "–"


def share_past(share: float, limit: float, decimals: int = 0) -> str:
    """Return a share as `19.6%`: to more decimals where these do not tell on which side of a limit it lies."""
    side = 1 if share > limit else -1
    for digits in range(decimals, 6):
        text = f"{share:.{digits}%}"
        if side * (float(text[:-1]) - round(100 * limit, 9)) > 0:
            return text
    return f"{'more' if side > 0 else 'less'} than {100 * limit:g}%"


def decimal_text(value: float, decimals: int, minus: str = "-") -> str:
    """Return a number with so many decimals, never as minus zero.

    A half is rounded away from zero as it reads in decimals: 47.15 is 47.2, whatever its bits are.
    """
    nudged = value + math.copysign(1e-9, value)
    text = f"{round(nudged, decimals) + 0.0:.{decimals}f}"  # adding zero turns -0.0 into 0.0
    return text.replace("-", minus)


def first_of(names: Sequence[str]) -> str:
    """Return `a, b`, or `a, b, c, d, e and 3 more`."""
    more = len(names) - 5
    return ", ".join(names[:5]) + (f" and {more:,} more" if more > 0 else "")
