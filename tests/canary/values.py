"""The canary: a coordinate that withheld splits of the tests have, and every way to write it."""

import re
import struct

CANARY_M = 72.7194836
"""Far corner of withheld regions: behind all that a planner of the tests reaches, so no score knows
it. Above 60, so no second of a time looks like it; nor do the last digits of a longer number, such
as a broker's seconds since 1970."""

_TEXTS_AFTER_7 = (
    rb"2[.,]7194(?:8|9(?![0-9]))",  # rounded to five decimals or more, or cut; decimal comma
    rb"[.,]2719[45]?[0-9]*[eE]\+?0?1",
    rb"2719[.,](?:48|5)",  # millimetres
    rb"271[.,]9(?:48|5)",  # centimetres
)


def _bits(*forms: str) -> tuple[bytes, ...]:
    """Return the canary as numbers of these forms: as they are, and in hex of either case."""
    bits = [struct.pack(form, CANARY_M) for form in forms]
    return (*bits, *(b.hex().encode() for b in bits), *(b.hex().upper().encode() for b in bits))


_DOUBLES, _SINGLES = _bits("<d", ">d"), _bits("<f", ">f")
_FLOAT_HEX = CANARY_M.hex().removeprefix("0x").encode()
PATTERN = re.compile(
    b"|".join(
        [
            rb"7(?<![0-9]7)(?:%b)" % b"|".join(_TEXTS_AFTER_7),
            re.escape(_FLOAT_HEX),
            *(re.escape(bits) for bits in _DOUBLES),
            *(rb"%b.{0,24}?%b" % (re.escape(bits), re.escape(bits)) for bits in _SINGLES),
        ]
    ),
    re.DOTALL,
)
"""A single of four bytes counts where it stands twice, as in every region: alone it comes up by
chance in the gigabytes of files and the million digests of a run. Each alternative begins with a
character: these are looked for ten times as fast as a condition on what stands before."""
REACH_BYTES = 64
"""No spelling is longer: so much of a stream is looked at again with what follows."""


def spellings(value_m: float = CANARY_M) -> list[bytes]:
    """Ways in which a leak would show the canary, for testing that they are found."""
    texts = [repr(value_m), f"{value_m:.5f}", f"{value_m:.6f}", f"{value_m:.4e}", f"{value_m:.6e}"]
    texts += [f"-{value_m}", str(value_m).replace(".", ","), f"{value_m * 1000:.1f}"]
    texts += [f"{value_m * 100:.2f}", value_m.hex(), f"[{value_m},1.0]", f"%5B{value_m}"]
    twice = [single + b"-1.0" + single for single in _SINGLES]
    return [text.encode() for text in texts] + [*_DOUBLES, *twice]
