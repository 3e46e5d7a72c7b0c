"""One table of strings that do harm somewhere: in HTML, spreadsheets, LaTeX, mail or a terminal."""

NASTY: dict[str, str] = {
    "script": "<script>alert(1)</script>",
    "image": '"><img src=x onerror=alert(2)>',
    "attribute": "' onmouseover='alert(3)' x='",
    "closing": "</title></svg></style><svg/onload=alert(4)>",
    "comment": "--><!-- ]]> <![CDATA[ &#x3C;b&#x3E;",
    "template": "{{ 7*191 }}{% raw %}${7*191}",
    "formula": "=1+1",
    "command": "=cmd|'/C calc'!A1",
    "plus": "+1+1",
    "minus": "-2+3",
    "at": "@SUM(1)",
    "full-width": "\uff1d1+1",
    "parted": "x;=1+2; @SUM(1)",
    "latex": r"\input{/etc/passwd} & % $ # _ ^ ~ { }",
    "markup": "[bold red]x[/] **b** `c`",
    "link": "[a](javascript:alert(5))",
}
"""Intake takes these: they can be shown, and have to be inert everywhere."""

UNSHOWABLE: dict[str, str] = {
    "tab": "\t=1+1",
    "return": "a\r=2+2",
    "header": "a\r\nBcc: victim@example.org\r\n\r\nbody",
    "lines": "a\nb: c",
    "null": "a\x00b",
    "escape": "a\x1b[31mred\x1b]0;title\x07\x1b[2J",
    "csi": "a\x9b31mred\x9d0;title\x9c",
    "bell": "a\x07\x08b",
    "right-to-left": "a\u202egnp.exe",
    "isolate": "a\u2066b\u2069",
    "zero-width": "a\u200bb",
    "separator": "a\u2028b",
    "byte-order": "\ufeff=1+1",
}
"""Intake refuses these; an older row or a hand-made record could hold one all the same."""

BAD_LINKS = (
    "javascript:alert(6)",
    "JaVaScRiPt:alert(7)",
    "data:text/html,<script>alert(8)</script>",
    "https://u:p@evil.example/",
    "https://a.example/\r\nSet-Cookie: x=1",
    'https://a.example/"onmouseover="alert(9)',
    "https://a.example/\u202e",
    "//evil.example/",
    "file:///etc/passwd",
)

ALL = {**NASTY, **UNSHOWABLE}
_CONTROLS = [*range(0x20), *range(0x7F, 0xA0)]
_TURNING = "\u061c\u200b\u200e\u200f\u2028\u2029\u202a\u202b\u202d\u202e\u2066\u2069\ufeff"
STEERING = tuple(chr(code) for code in _CONTROLS if chr(code) not in "\t\n\r") + tuple(_TURNING)
"""What no output may hold bare."""


def steering_in(text: str) -> list[str]:
    """Return the steering characters in a text."""
    return [character for character in STEERING if character in text]
