"""The plus before a time zone, which addresses read as a blank."""

import re

_BLANK_ZONE = re.compile(r"(T[0-9:.]+) ([0-9]{2}:?[0-9]{2})$")


def with_zone_sign(text: str) -> str:
    """Return a time from an address with the plus of its zone, where it was not sent as %2B."""
    return _BLANK_ZONE.sub(r"\1+\2", text)
