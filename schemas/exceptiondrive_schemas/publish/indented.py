"""JSON for readers: indented, but short lists of plain values stay on one line."""

import json
import re

_PLAIN_LIST = re.compile(r"\[[^\[\]{}]*\]")
_LIST_OF_LISTS = re.compile(r"\[\s*(\[[^\[\]{}\n]*\](?:,\s*\[[^\[\]{}\n]*\])*)\s*\]")
_BLANKS = re.compile(r"\s+")
LINE_LENGTH = 100


def indented(text: str) -> str:
    """Return the same JSON document, laid out for reading, with a final newline."""
    text = json.dumps(json.loads(text), indent=2, ensure_ascii=False)
    return _LIST_OF_LISTS.sub(_on_one_line, _PLAIN_LIST.sub(_on_one_line, text)) + "\n"


def _on_one_line(match: re.Match[str]) -> str:
    flat = _BLANKS.sub(" ", match.group()).replace("[ ", "[").replace(" ]", "]")
    return flat if len(flat) <= LINE_LENGTH and '"' not in flat else match.group()
