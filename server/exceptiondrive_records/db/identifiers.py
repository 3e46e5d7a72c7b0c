"""Random public ids and checked names."""

import hashlib
import re
import secrets
import unicodedata
from functools import cache
from urllib.parse import urlsplit

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.printable import shown_text
from exceptiondrive_schemas.references import RESERVED_NAMES, is_reserved

_LETTERS = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford base 32: no two letters look alike. 32 divides 256, so bytes map without bias."""
_UNSEEN = frozenset(
    chr(code)
    for first, last in (
        (0x034F, 0x034F), (0x115F, 0x1160), (0x17B4, 0x17B5), (0x180B, 0x180F), (0x2065, 0x2065),
        (0x2800, 0x2800), (0x3164, 0x3164), (0xFE00, 0xFE0F), (0xFFA0, 0xFFA0), (0xFFF0, 0xFFF8),
        (0xE0000, 0xE0FFF),
    )
    for code in range(first, last + 1)
)  # fmt: skip
"""Default_Ignorable_Code_Point of Unicode's DerivedCoreProperties.txt as far as `str.isprintable`
accepts it, and the blank braille pattern."""
_SMALL_CAPITALS = str.maketrans("ᴀʙᴄᴅᴇꜰɢʜɪᴊᴋʟᴍɴᴏᴘꞯʀꜱᴛᴜᴠᴡʏᴢ", "ABCDEFGHIJKLMNOPQRSTUVWYZ")
_FRAMED = {first + n: ord("A") + n for first in (0x1F150, 0x1F170, 0x1F1E6) for n in range(26)}
"""Latin letters for letters in black circles and squares, and for regional indicators (flags)."""
_PILE = re.compile("mmm")
_PSEUDONYM = re.compile(r"team *[0-9a-z]{3} *[^0-9a-z ]+ *[0-9a-z]{3}|former +team\b.*")
"""Names of teams in an anonymous phase (`phases.policy`), and of forgotten teams."""
_WORD = re.compile(r"\w+")
_SLUG = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")
_WORDS_OF_PAGES = {"phase": {"new"}, "team": {"import"}}
"""Words that some addresses have in the place of the id of a phase or team."""


def random_id(length: int = 16) -> str:
    """Return a random id of 5 bits per letter that cannot be guessed or misread."""
    return "".join(_LETTERS[byte % len(_LETTERS)] for byte in secrets.token_bytes(length))


def secret_digest(secret: str) -> str:
    """Return the digest that is stored in place of a secret."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def checked_slug(kind: str, slug: str) -> str:
    """Return `slug` if it can be part of an address.

    Raises:
        InvalidRecord: It cannot.
    """
    if _SLUG.fullmatch(slug) is None:
        raise InvalidRecord(
            f"The {kind} id {slug!r} must be 1 to 64 lower-case letters, digits and hyphens, "
            "and begin with a letter or digit."
        )
    if slug in _WORDS_OF_PAGES.get(kind, ()):
        raise InvalidRecord(f"The {kind} id {slug!r} stands for a page of its own; choose another.")
    return slug


def checked_text(
    kind: str,
    text: str,
    *,
    max_length: int,
    may_be_empty: bool = False,
    may_have_lines: bool = False,
) -> str:
    """Return `text` as `shown_text` does.

    Raises:
        InvalidRecord: Empty, too long, or with characters that cannot be shown.
    """
    try:
        return shown_text(
            kind,
            text,
            max_length=max_length,
            may_be_empty=may_be_empty,
            may_have_lines=may_have_lines,
        )
    except ValueError as error:
        raise InvalidRecord(str(error)) from None


def checked_name(kind: str, name: str) -> str:
    """Return the name of a team or method, as `checked_text` does.

    Raises:
        InvalidRecord: It cannot be used, has no readable character, stacks accents, holds invisible
            characters, or reads as the name of a reference row or of the paper's rows.
    """
    name = checked_text(kind, name, max_length=80)
    if not any(c.isalnum() and c not in _UNSEEN for c in name):
        raise InvalidRecord(f"The {kind} must hold a letter or digit.")
    if not _UNSEEN.isdisjoint(name) or _PILE.search(_marks_of(name)) is not None:
        raise InvalidRecord(f"The {kind} holds characters that cannot be shown.")
    if is_reserved(name) or skeleton(name) in _reserved():
        raise InvalidRecord(
            f"The {kind} {name!r} is reserved for the reference rows of boards and what the paper reports."
        )
    return name


def checked_team(slug: str, name: str) -> str:
    """Return the name of a team, as `checked_name` does.

    Raises:
        InvalidRecord: As `checked_slug` and `checked_name`; or id or name looks like the ones that
            the site gives to anonymous or forgotten teams.
    """
    checked_slug("team", slug)
    name = checked_name("team name", name)
    if slug.startswith("former-") or _PSEUDONYM.fullmatch(_as_read(name).replace("rn", "m")):
        raise InvalidRecord("Such ids and names are given to teams that are not named.")
    return name


def skeleton(name: str) -> str:
    """Return the skeleton of a name: two names with the same skeleton look alike.

    It follows UTS 39, section 4, with the library's table of confusables. In addition it drops
    case, accents and width, merges i, l, 1 and I, and turns punctuation and symbols into blanks.
    """
    letters = _as_read(name).replace("i", "l")
    seen = (" " if unicodedata.category(c)[0] in "PSZ" else c for c in letters)
    return " ".join("".join(seen).split())


def _as_read(name: str) -> str:
    """Fold letters that look alike, case, accents and width.

    A word that looks Latin is mapped to Latin before its case is folded: many capitals of other
    scripts look like Latin ones, while their small letters do not.
    """
    plain = _without_accents(unicodedata.normalize("NFKC", name.translate(_FRAMED)))
    plain = plain.translate(_SMALL_CAPITALS)
    folded = _without_accents(_WORD.sub(_as_latin, plain).casefold())
    dashed = ("-" if unicodedata.category(c) == "Pd" else c for c in folded)
    read = _without_accents("".join(map(_prototype, dashed)))  # drops bars through letters, too
    return read.casefold().replace("vv", "w")


def _without_accents(text: str) -> str:
    decomposed = unicodedata.normalize("NFKD", text)
    return "".join(c for c in decomposed if not unicodedata.combining(c))


def _as_latin(word: re.Match[str]) -> str:
    seen = "".join(map(_prototype, word[0]))
    return seen if seen.isascii() else word[0]


def _prototype(letter: str) -> str:
    """Return the letter that represents all that look like it; of two, the smaller one."""
    alike = _confusables().get(letter, [])
    if len(alike) != 1:
        return letter
    return min(letter, *alike) if _confusables().get(alike[0]) == [letter] else alike[0]


@cache
def _confusables() -> dict[str, list[str]]:
    """Return the library's table, loaded on first use: it takes longer to load than most modules.

    Hebrew and Arabic letters in it are wrapped in directional marks.
    """
    from confusable_homoglyphs import confusables  # type: ignore[import-untyped]

    return {
        letter.strip("\u200e"): [each["c"].strip("\u200e") for each in alike]
        for letter, alike in confusables.confusables_data.items()
    }


@cache
def _reserved() -> frozenset[str]:
    return frozenset(map(skeleton, RESERVED_NAMES))


def _marks_of(name: str) -> str:
    """Return one letter per character that says whether it combines with the previous one."""
    decomposed = unicodedata.normalize("NFD", name)
    return "".join("m" if unicodedata.category(c)[0] == "M" else "." for c in decomposed)


def checked_reason(reason: str) -> str:
    """Return a valid reason.

    Raises:
        InvalidRecord: It is empty, too long, or cannot be shown.
    """
    return checked_text("reason", reason, max_length=1000, may_have_lines=True)


def checked_link(kind: str, url: str | None, *, may_have_port: bool = False) -> str | None:
    """Return `url` if it is an https address, or None.

    Raises:
        InvalidRecord: It is neither.
    """
    if url is None or url == "":
        return None
    if not _is_plain_https(url, may_have_port=may_have_port):
        raise InvalidRecord(f"The {kind} link must be an https:// address of at most 500 letters.")
    return url


def _is_plain_https(url: str, *, may_have_port: bool) -> bool:
    if len(url) > 500 or not url.isascii() or any(c in ' "<>\\^`{|}' for c in url):
        return False
    try:
        parts = urlsplit(url)
        is_named = parts.scheme == "https" and bool(parts.hostname)
        is_named = is_named and (parts.port is None or may_have_port)
    except ValueError:
        return False
    return is_named and url.isprintable() and "@" not in parts.netloc
