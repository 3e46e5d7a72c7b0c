"""Words in a picture: SVG text neither wraps nor ends by itself."""

_NARROW = frozenset("iljtfrI.,:;|!'()[]/ -·")
_WIDE = frozenset("mwMWO@%&QG+")
_WIDTHS = {"narrow": 0.34, "wide": 0.86, "capital": 0.68, "digit": 0.62, "other": 0.57}
ELLIPSIS = "…"


def width_of(text: str, size: float) -> float:
    """Estimate the width of `text`, rather too wide; characters beyond Latin count one em."""
    return size * sum(_em(character) for character in text)


def _em(character: str) -> float:
    if character in _NARROW:
        return _WIDTHS["narrow"]
    if character in _WIDE:
        return _WIDTHS["wide"]
    if ord(character) > 0x2FF and character not in "\u2009\u202f\u2013\u2019\u2026\u2212":
        return 1.0
    if character.isupper():
        return _WIDTHS["capital"]
    return _WIDTHS["digit"] if character.isdigit() else _WIDTHS["other"]


def fitted(text: str, size: float, width: float) -> str:
    """Return `text`, cut with an ellipsis where it is too wide; without control characters."""
    text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    if width_of(text, size) <= width:
        return text
    while text and width_of(text + ELLIPSIS, size) > width:
        text = text[:-1]
    return text.rstrip() + ELLIPSIS


def in_lines(text: str, size: float, width: float, n_lines: int) -> tuple[str, ...]:
    """Break `text` between words into at most `n_lines` of about one length; cut what is too long."""
    lines = _broken(text, size, width, n_lines)
    for share in (0.9, 0.8, 0.7, 0.6):
        narrower = _broken(text, size, width * share, n_lines)
        if len(narrower) > len(lines) or any(line.endswith(ELLIPSIS) for line in narrower):
            break
        lines = narrower
    return lines


def _broken(text: str, size: float, width: float, n_lines: int) -> tuple[str, ...]:
    lines: list[str] = []
    words = text.split()
    while words and len(lines) < n_lines - 1:
        taken = 1
        while taken < len(words) and width_of(" ".join(words[: taken + 1]), size) <= width:
            taken += 1
        lines.append(fitted(" ".join(words[:taken]), size, width))
        words = words[taken:]
    return (*lines, fitted(" ".join(words), size, width)) if words else tuple(lines)


def is_latin(text: str) -> bool:
    """Whether the fonts of this package can set `text`."""
    return all(ord(c) < 0x250 or 0x2000 <= ord(c) < 0x2300 for c in text)
