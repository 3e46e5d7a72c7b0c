"""An SVG badge of one entry, for a README."""

from dataclasses import dataclass

from exceptiondrive_server.pages.entry_facts import challenge_of
from exceptiondrive_server.pages.entry_page import EntryReading
from exceptiondrive_server.pages.numbers import Digits
from exceptiondrive_server.pages.scales import px

CHARACTER_WIDTH = 6.6
PADDING = 18
NAME = "ExceptionDrive"


@dataclass(frozen=True)
class Badge:
    """Widths and words of a badge."""

    width: str
    name_width: str
    name_middle: str
    words_middle: str
    name: str
    words: str


def badge_of(reading: EntryReading) -> Badge:
    """Say rank and the first metric, or that the entry is reported or not ranked."""
    metric = challenge_of(reading.board).metrics[0]
    digits = Digits.of(reading.protocol.publication)
    text = digits.text(metric, reading.entry.metrics.get(metric.key))
    score = f"{metric.label} {text} %" if text else "no score"
    rank = f"rank {reading.entry.rank}" if reading.entry.rank else reading.entry.source
    words = f"{rank}, {score}"
    name_width = len(NAME) * CHARACTER_WIDTH + PADDING
    words_width = len(words) * CHARACTER_WIDTH + PADDING
    return Badge(
        width=px(name_width + words_width),
        name_width=px(name_width),
        name_middle=px(name_width / 2),
        words_middle=px(name_width + words_width / 2),
        name=NAME,
        words=words,
    )
