"""Where labels go in a chart: greedily beside their point, never on top of another one."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from exceptiondrive_server.pages.scales import px

CHARACTER_WIDTH = 7.4
LINE_HEIGHT = 16.0
MAX_CHARACTERS = 24


@dataclass(frozen=True)
class Box:
    """A rectangle in SVG coordinates."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, other: "Box") -> bool:
        """Whether two rectangles share area."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )

    def holds(self, other: "Box") -> bool:
        """Whether `other` lies inside this rectangle."""
        return (
            self.left <= other.left
            and other.right <= self.right
            and self.top <= other.top
            and other.bottom <= self.bottom
        )


Anchor = Literal["start", "middle", "end"]


@dataclass(frozen=True)
class Label:
    """A placed label."""

    x: str
    y: str
    anchor: Anchor
    text: str
    leader: tuple[str, str, str, str] | None
    """From the point to a label that stands far from it."""


_OFFSETS: tuple[tuple[float, float, Anchor], ...] = (
    (10, -9, "start"),
    (10, 18, "start"),
    (-10, 18, "end"),
    (-10, -9, "end"),
    (0, 27, "middle"),
    (-34, 34, "end"),
    (34, 34, "start"),
    (34, -26, "start"),
    (-40, 56, "end"),
    (40, 56, "start"),
    (40, -48, "start"),
    (-46, 80, "end"),
    (46, -72, "start"),
)
FAR = 30.0


def place_labels(
    anchors: Sequence[tuple[str, float, float]], frame: Box, obstacles: Sequence[Box]
) -> tuple[Label, ...]:
    """Place the labels that fit; a label without room is left out (its point has a title).

    Args:
        anchors: Text and position of each point, most important first.
        frame: Labels stay inside it.
        obstacles: Rectangles that labels keep off, besides the points themselves.
    """
    taken = [Box(x - 7, y - 7, x + 7, y + 7) for _, x, y in anchors] + list(obstacles)
    placed: list[Label] = []
    for text, x, y in anchors:
        short = text if len(text) <= MAX_CHARACTERS else text[: MAX_CHARACTERS - 1] + "…"
        for dx, dy, anchor in _OFFSETS:
            box = _text_box(short, x + dx, y + dy, anchor)
            if frame.holds(box) and not any(box.meets(other) for other in taken):
                taken.append(box)
                leader = _leader(x, y, dx, dy)
                placed.append(Label(px(x + dx), px(y + dy), anchor, short, leader))
                break
    return tuple(placed)


def _text_box(text: str, x: float, y: float, anchor: Anchor) -> Box:
    width = len(text) * CHARACTER_WIDTH
    left = {"start": x, "middle": x - width / 2, "end": x - width}[anchor]
    return Box(left, y - LINE_HEIGHT + 4, left + width, y + 4)


def _leader(x: float, y: float, dx: float, dy: float) -> tuple[str, str, str, str] | None:
    if abs(dy) < FAR and abs(dx) < FAR:
        return None
    side = math.copysign(3, dx)
    return (px(x), px(y), px(x + dx - side), px(y + dy - 4))
