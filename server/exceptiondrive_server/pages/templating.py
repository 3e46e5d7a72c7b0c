"""Jinja2 set up once: autoescape, strict, with addresses of static files that may be cached."""

import hashlib
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from exceptiondrive_schemas.printable import printable
from exceptiondrive_server.pages import numbers
from exceptiondrive_server.pages.condense import Condensed
from exceptiondrive_server.pages.entry_facts import board_name
from exceptiondrive_server.pages.scales import px

FOLDER = Path(__file__).parent
STATIC = FOLDER / "static"


@cache
def asset(name: str) -> str:
    """Return the address of a static file; it changes whenever the content does."""
    digest = hashlib.sha256((STATIC / name).read_bytes()).hexdigest()[:10]
    return f"/static/{name}?v={digest}"


def ticks(text: str) -> Markup:
    """Set what stands between back-ticks as code; everything is escaped."""
    parts = str(escape(text)).split("`")
    return Markup(
        "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))
    )


def stars(text: str) -> Markup:
    """Set what stands between double stars bold; everything is escaped."""
    parts = str(escape(text)).split("**")
    return Markup("".join(f"<b>{part}</b>" if i % 2 else part for i, part in enumerate(parts)))


def shown(value: object) -> object:
    """Clean a text of what turns, hides or steers, whatever was let into the records."""
    return printable(value) if type(value) is str else value


def https_only(url: str | None) -> str:
    """Return a link that readers may follow; anything but an https address is left out."""
    return url if url is not None and url.startswith("https://") else ""


def with_article(noun: str) -> str:
    """Return `a planner`, `an agent`."""
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


@cache
def environment() -> Environment:
    """Return the template environment of the site."""
    made = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown,
        extensions=[Condensed],
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(asset=asset, THIN_SPACE=numbers.THIN_SPACE)
    made.filters.update(
        day=numbers.day,
        minute=numbers.minute,
        iso=numbers.iso,
        short=numbers.short_digest,
        grouped=numbers.grouped,
        px=px,
        size=numbers.size_text,
        slug=numbers.slug,
        https=https_only,
        ticks=ticks,
        stars=stars,
        a=with_article,
        board_name=board_name,
    )
    return made


def render(template: str, **values: object) -> str:
    """Fill a template."""
    return environment().get_template(template).render(**values)
