"""The Jinja2 environment: autoescape, strict undefined, filters, and removal of layout whitespace.

Line breaks in templates are layout and are not sent, by the rules of Vue's templates: between two
tags, after an opening tag and before a closing tag a line break is dropped; anywhere else, in running
text, it becomes one space. A visible space between two tags is written between them on one line. A
call, `{{ icon("up") }}` or `{% call %}`, writes markup and counts as a tag; `{% if %}` and the like
are transparent. `{%-` and `{{-` remove the space before them.
"""

import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from jinja2 import Environment, FileSystemLoader, PrefixLoader, StrictUndefined
from jinja2.ext import Extension
from markupsafe import Markup, escape

from exceptiondrive_schemas.api.rescoring import page_of
from exceptiondrive_schemas.formulas import over_families
from exceptiondrive_schemas.printable import counted, printable
from exceptiondrive_server.web import numbers
from exceptiondrive_server.web.glossary import TERMS
from exceptiondrive_server.web.markdown import first_paragraph, markdown
from exceptiondrive_server.web.numbers import px
from exceptiondrive_server.web.static_files import asset

F = TypeVar("F", bound=Callable[..., Any])
FOLDER = Path(__file__).parent
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
_ASKED_TERM = re.compile(r'popovertarget="t-([a-z0-9_]+)"')
_VOID = re.compile(r"<(!|(area|br|col|hr|img|input|link|meta|source|wbr)\b)|.*/>$", re.DOTALL)
_BEGINS = re.compile(r"\{%\s*(if|for|macro|block|call|filter)\b")
_ENDS = re.compile(r"\{%\s*end(if|for|macro|block|call|filter)\b")
_ELSE = re.compile(r"\{%\s*(else|elif)\b")
_OPTION = re.compile(r"(?<=[\s>])(--?\w[\w-]*)")
_LAST = re.compile(r"\{%\s*end(macro|block|call|set)\b")


def marked(text: str, mark: str, tag: str) -> Markup:
    """Wrap text between two marks in an element; everything is escaped."""
    parts = str(escape(text)).split(mark)
    set_parts = [f"<{tag}>{part}</{tag}>" if i % 2 else part for i, part in enumerate(parts)]
    return Markup("".join(set_parts))


def breakable(code: str) -> Markup:
    """Let a code break after its underscores, and nowhere else; everything is escaped."""
    return Markup("_<wbr>").join(code.split("_"))


def https_only(url: str | None) -> str:
    """Return a link that readers may follow; anything but an https address is left out."""
    return url if url is not None and url.startswith("https://") else ""


def with_article(noun: str) -> str:
    """Return `a planner`, `an agent`."""
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


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
    """Whether a line break is within running text."""
    before, after = tokens[index - 1] if index else None, _next_shown(tokens, index + 1)
    if before is None or after is None or before[0] == "statement" or after[0] == "closing":
        return False
    if tokens[index + 1][1].startswith(("{%-", "{{-")):
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
        elif text.startswith("{% call"):
            return "call", text
        elif kind != "statement" and not text.isspace():
            return kind, text
        index += 1
    return None


def _unseen_lines(text: str) -> str:
    return "{#" + "\n" * text.count("\n") + "#}"


def unbroken(commands: str) -> Markup:
    """Return commands as markup in which no option is parted at the end of a line."""
    return Markup(_OPTION.sub(r"<i>\1</i>", str(escape(commands))))


@cache
def environment() -> Environment:
    """Return the template environment of the site."""
    made = Environment(
        loader=PrefixLoader(
            {
                folder.parent.name: FileSystemLoader(folder)
                for folder in sorted(FOLDER.parent.glob("*/templates"))
            }
        ),
        autoescape=True,
        undefined=StrictUndefined,
        extensions=[Condensed],
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(asset=asset, THIN_SPACE=numbers.THIN_SPACE, terms=TERMS)
    made.filters.update(
        day=numbers.day,
        minute=numbers.minute,
        iso=numbers.iso,
        short=numbers.short_digest,
        grouped=numbers.grouped,
        fixed=numbers.fixed,
        percent=numbers.percent,
        counted=counted,
        px=px,
        size=numbers.size_text,
        https=https_only,
        ticks=partial(marked, mark="`", tag="code"),
        stars=partial(marked, mark="**", tag="b"),
        breakable=breakable,
        markdown=markdown,
        first_paragraph=first_paragraph,
        a=with_article,
        over_families=over_families,
        unbroken=unbroken,
        unit=numbers.unit_of,
        heading=numbers.heading,
        page_of=page_of,
    )
    return made


def macro(template: str, name: str) -> Callable[..., Markup]:
    """Return a macro of a template, for a part of a page that is made once."""
    found: Callable[..., Markup] = getattr(environment().get_template(template).module, name)
    return found


def template_filter(function: F) -> F:
    """Let templates use a function of a noun as a filter of the same name."""
    environment().filters[function.__name__] = function
    return function


def render(template: str, **values: object) -> str:
    """Fill a template, and clean it of what turns, hides or steers, whatever the records let in.

    The meanings of the words that ask for one (`term`, `what`) are added once.
    """
    text = environment().get_template(template).render(**values)
    asked = dict.fromkeys(_ASKED_TERM.findall(text))
    if asked:
        body, end, rest = text.rpartition("</body>")
        text = f"{body}{macro('web/macros/icons.html', 'meanings')(asked)}{end}{rest}"
    return printable(text)
