"""Text for display: counted nouns, and the last line of defence against unsafe characters.

Uploads with names that cannot be shown are refused (`checked_text`). Outputs do not rely on it:
older rows, hand-made records and foreign servers are sanitized here again, just before display.
"""

import math
import re
import unicodedata
from collections.abc import Sequence

REPLACEMENT = "\ufffd"
MINUS = "\u2212"
_UNSAFE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters; ESC and CSI steer terminals
    "\u061c\u200b-\u200f\u202a-\u202e\u2060-\u2069\ufeff"  # invisible, or changing the direction
    "\u2028\u2029\ufff9-\ufffb\ud800-\udfff]"  # line separators, annotations, lone surrogates
)
_FORMULA = "=+-@\uff1d\uff0b\uff0d\uff20"  # and their full-width forms
_CELL_START = rf"(^|;\s*)(?=[{re.escape(_FORMULA)}{REPLACEMENT}])"
"""Where a formula would begin: spreadsheets in many countries split cells at `;`, quoted or not."""
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

    Line breaks become one character, as browsers count them although they send two. Control,
    zero-width and direction characters are refused: they make two names look alike.

    Raises:
        ValueError: It is empty, too long, or has characters that cannot be shown.
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
    """Return `text` with each unsafe character replaced by a replacement sign.

    Line breaks are kept as one character; browsers send two, and a refused form shows them.
    """
    return _UNSAFE.sub(REPLACEMENT, text.replace("\r\n", "\n"))


def one_line(text: str) -> str:
    """Return `text` on one line: a mail header, a CSV cell, a comment cannot contain a break."""
    return printable(" ".join(text.split()))


def spreadsheet_text(text: str) -> str:
    """Return a cell that no spreadsheet runs as a formula."""
    return re.sub(_CELL_START, r"\1'", one_line(text))


def from_spreadsheet(text: str) -> str:
    """Return the text from which `spreadsheet_text` made a cell."""
    return re.sub(_QUOTED_START, r"\1", text)


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """Return `1 value`, `1,000 values`, `3 entries`."""
    return f"{count:,} {noun if count == 1 else plural or noun + 's'}"


def duration_words(seconds: float) -> str:
    """Write a duration in its largest unit: `12 s`, `5 minutes`, `3 hours`, `2 days`."""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    if seconds < 90 * 60:
        return counted(round(seconds / 60), "minute")
    if seconds < 36 * 3600:
        return counted(round(seconds / 3600), "hour")
    return counted(round(seconds / 86400), "day")


def percent_of(n: int, of: int) -> str:
    """Return a share in per cent, to two places; a dash if the total is 0."""
    return f"{100 * n / of:.2f} %" if of else "–"


def share_past(share: float, limit: float, decimals: int = 0) -> str:
    """Return a share as `19.6%`, with as many decimals as show on which side of a limit it is."""
    side = 1 if share > limit else -1
    for digits in range(decimals, 6):
        text = f"{share:.{digits}%}"
        if side * (float(text[:-1]) - round(100 * limit, 9)) > 0:
            return text
    return f"{'more' if side > 0 else 'less'} than {100 * limit:g}%"


def decimal_text(value: float, decimals: int, minus: str = "-") -> str:
    """Return a number with this many decimals, never as minus zero.

    Halves in decimal notation are rounded away from zero: 47.15 is 47.2, whatever its bits are.
    """
    nudged = value + math.copysign(1e-9, value)
    text = f"{round(nudged, decimals) + 0.0:.{decimals}f}"  # adding zero turns -0.0 into 0.0
    return text.replace("-", minus)


def first_of(names: Sequence[str]) -> str:
    """Return `a, b`, or `a, b, c, d, e and 3 more`."""
    more = len(names) - 5
    return ", ".join(names[:5]) + (f" and {more:,} more" if more > 0 else "")
