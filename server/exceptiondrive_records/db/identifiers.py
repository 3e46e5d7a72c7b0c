"""Random public ids and checked names."""

import re
import secrets
import unicodedata
from urllib.parse import urlsplit

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.references import is_reserved

_LETTERS = "0123456789abcdefghjkmnpqrstvwxyz"  # Crockford base 32: nothing looks like another
_SLUG = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")


def random_id(length: int = 16) -> str:
    """Return a random id of 5 bits per letter that cannot be guessed or misread."""
    return "".join(secrets.choice(_LETTERS) for _ in range(length))


def checked_slug(kind: str, slug: str) -> str:
    """Return `slug` if it may stand in an address.

    Raises:
        InvalidRecord: It may not.
    """
    if _SLUG.fullmatch(slug) is None:
        raise InvalidRecord(
            f"The {kind} id {slug!r} must be 1 to 64 lower-case letters, digits and hyphens, "
            "and begin with a letter or digit."
        )
    return slug


def checked_text(
    kind: str,
    text: str,
    *,
    max_length: int,
    may_be_empty: bool = False,
    may_have_lines: bool = False,
) -> str:
    """Return `text` in Unicode form NFC, without surrounding blanks, if it can be shown safely.

    Control, zero-width and direction characters are refused: they make two names look alike.

    Raises:
        InvalidRecord: Empty, too long, or with characters that cannot be shown.
    """
    text = unicodedata.normalize("NFC", text).strip()
    if not text and not may_be_empty:
        raise InvalidRecord(f"The {kind} must not be empty.")
    if len(text) > max_length:
        raise InvalidRecord(f"The {kind} is longer than {max_length} characters.")
    if may_have_lines:
        text = text.replace("\r\n", "\n")
    if any(not (c.isprintable() or (may_have_lines and c == "\n")) for c in text):
        raise InvalidRecord(f"The {kind} holds characters that cannot be shown.")
    return text


def checked_name(kind: str, name: str) -> str:
    """Return the name of a team or method, as `checked_text` does.

    Raises:
        InvalidRecord: It cannot be used, or reads as the name of a reference row.
    """
    name = checked_text(kind, name, max_length=80)
    if is_reserved(name):
        raise InvalidRecord(f"The {kind} {name!r} is reserved for the reference rows of boards.")
    return name


def checked_reason(reason: str) -> str:
    """Return a reason that can be kept.

    Raises:
        InvalidRecord: It is empty, too long, or cannot be shown.
    """
    return checked_text("reason", reason, max_length=1000, may_have_lines=True)


def checked_link(kind: str, url: str | None) -> str | None:
    """Return `url` if it is an https address, or None.

    Raises:
        InvalidRecord: It is neither.
    """
    if url is None or url == "":
        return None
    if not _is_plain_https(url):
        raise InvalidRecord(f"The {kind} link must be an https:// address of at most 500 letters.")
    return url


def _is_plain_https(url: str) -> bool:
    if len(url) > 500 or not url.isascii() or any(c in ' "<>\\^`{|}' for c in url):
        return False
    try:
        parts = urlsplit(url)
        is_named = parts.scheme == "https" and bool(parts.hostname) and parts.port is None
    except ValueError:
        return False
    return is_named and url.isprintable() and "@" not in parts.netloc
