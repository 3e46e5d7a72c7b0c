"""An SVG badge of one entry, for a README."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_server.pages.entry_facts import challenge_of
from exceptiondrive_server.pages.entry_readings import EntryReading
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


def _place(entry: BoardEntry) -> str:
    if entry.is_late:
        return "late"
    return f"rank {entry.rank}" if entry.rank else entry.source


def badge_of(reading: EntryReading) -> Badge:
    """Say rank and the first metric, or that the entry is reported or not ranked."""
    metric = challenge_of(reading.board).metrics[0]
    digits = Digits.of(reading.protocol.publication)
    text = digits.text(metric, reading.entry.metrics.get(metric.key))
    score = f"{metric.label} {text} %" if text else "no score"
    words = f"{_place(reading.entry)}, {score}"
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
