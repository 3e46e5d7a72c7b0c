"""Line breaks of a template are layout: they show a reader the elements, and are not sent.

The rules are those of Vue's templates. Between two tags a line break is nothing; behind an opening
and before a closing tag it is nothing; anywhere else, in running text, it is one space. A space that
is to be seen between two tags stands between them on one line. A call, `{{ icon("up") }}`, writes
markup and counts as a tag; `{% if %}` and its like are looked through.
"""

import re

from jinja2.ext import Extension

_JINJA = r"\{%.*?%\}|\{\{.*?\}\}|\{\#.*?\#\}"
_TOKEN = re.compile(
    rf"""(?P<raw> <(?P<name>pre|textarea|script|style)\b.*?</(?P=name)> )
    | (?P<closing> </\w+\s*> )
    | (?P<tag> <[a-zA-Z!](?: {_JINJA} | "(?:{_JINJA}|[^"])*" | [^>"] )*> )
    | (?P<call> \{{\{{\s*\w+\(.*?\}}\}} )
    | (?P<value> \{{\{{.*?\}}\}} )
    | (?P<statement> \{{[%\#].*?[%\#]\}} )
    | (?P<layout> \s*\n\s* )
    | (?P<text> [^<{{\s]+ | . )""",
    re.DOTALL | re.VERBOSE,
)
_MARKUP = {"raw", "closing", "tag", "call"}
_VOID = re.compile(r"<(!|(area|br|col|hr|img|input|link|meta|source|wbr)\b)|.*/>$", re.DOTALL)
_BEGINS = re.compile(r"\{%\s*(if|for|macro|block|call|filter)\b")
_ENDS = re.compile(r"\{%\s*end(if|for|macro|block|call|filter)\b")
_ELSE = re.compile(r"\{%\s*(else|elif)\b")
_LAST = re.compile(r"\{%\s*end(macro|block|call|set)\b")


class Condensed(Extension):
    """Takes the layout out of every template that is loaded."""

    def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
        """Return what Jinja compiles."""
        return condensed(source)


def condensed(source: str) -> str:
    """Return a template without its layout; every line keeps its number in messages of Jinja."""
    tokens = [(match.lastgroup, match[0]) for match in _TOKEN.finditer(source)]
    parts = []
    for index, (kind, text) in enumerate(tokens):
        if kind == "layout":
            parts.append((" " if _is_seen(tokens, index) else "") + _unseen_lines(text))
        elif kind == "tag":
            parts.append(re.sub(r"\s*\n\s*", lambda gap: " " + _unseen_lines(gap[0]), text))
        else:
            parts.append(text)
    return "".join(parts)


def _is_seen(tokens: list[tuple[str | None, str]], index: int) -> bool:
    """Whether a line break stands in running text."""
    before, after = tokens[index - 1] if index else None, _next_shown(tokens, index + 1)
    if before is None or after is None or before[0] == "statement" or after[0] == "closing":
        return False
    is_behind_opening = before[0] == "tag" and not _VOID.match(before[1])
    return not is_behind_opening and not (before[0] in _MARKUP and after[0] in _MARKUP)


def _next_shown(tokens: list[tuple[str | None, str]], index: int) -> tuple[str | None, str] | None:
    """Return what is shown next, if every condition on the way holds."""
    depth = 0
    while index < len(tokens):
        kind, text = tokens[index]
        if depth or _ELSE.match(text):
            depth += bool(_ELSE.match(text)) if not depth else bool(_BEGINS.match(text))
            depth -= bool(_ENDS.match(text))
        elif _LAST.match(text):
            return None
        elif kind != "statement" and not text.isspace():
            return kind, text
        index += 1
    return None


def _unseen_lines(text: str) -> str:
    return "{#" + "\n" * text.count("\n") + "#}"
