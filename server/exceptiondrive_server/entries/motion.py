"""Scenes in motion: the drawings of one or more entries, overlaid and animated step by step.

All numbers come from the drawings, which the worker makes with the scoring code; nothing is measured
here. Between two time steps the picture is interpolated linearly, while the numbers do not change.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

from markupsafe import Markup

from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_schemas.drawing import (
    DrawnSample,
    Outline,
    SampleDrawing,
    View,
    grid,
    hazard,
    outcome,
)
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.taxonomy import Task
from exceptiondrive_server.web.numbers import Scale, nice_scale, px

WIDTH, HEIGHT = 430.0, 230.0
LINE_HEIGHT = 128.0
PLOT = (54.0, WIDTH - 12, 12.0, LINE_HEIGHT - 26)
"""Left, right, top and bottom of the clearance line."""
TIMES_SHOWN = 4.0
"""The line shows clearances up to so many times the required one; further away is further up."""
Level = Literal["clear", "close", "hit"]
LEVEL_WORDS: dict[Level, str] = {"clear": "clear", "close": "too close", "hit": "hit"}


@dataclass(frozen=True)
class Stretch:
    """A part of a clearance line between two crossings, and its level."""

    level: Level
    points: str


@dataclass(frozen=True)
class Mark:
    """The clearance at one time step, where the line has it."""

    level: Level
    x: str
    y: str


@dataclass(frozen=True)
class Run:
    """One entry in one scene."""

    method: str
    sample: SampleDrawing
    view: View
    axes: tuple[Scale, Scale]

    def boxes(self, outlines: Sequence[Outline]) -> str:
        """Return outlines as a script reads them: corners apart by blanks, time steps by `;`."""
        return ";".join(self.view.points(outline) for outline in outlines)

    def level(self, clearance_m: float) -> Level:
        """Say what a clearance is worth."""
        if clearance_m == 0:
            return "hit"
        return "close" if clearance_m < self.sample.d_safe_m else "clear"

    @property
    def levels(self) -> str:
        """The level at each time step."""
        return " ".join(self.level(value) for value in self.sample.clearances_m)

    @property
    def numbers(self) -> str:
        """The clearance at each time step in metres, to the centimetre."""
        return " ".join(f"{value:.2f}" for value in self.sample.clearances_m)

    @property
    def at_the_end(self) -> tuple[Level, str]:
        """The level at the end, and the words that tell it."""
        if self.sample.clearance_m is None:
            return "hit", "no answer: counts as a hit"
        level = self.level(self.sample.clearances_m[-1])
        return level, f"{self.sample.clearances_m[-1]:.2f} m, {LEVEL_WORDS[level]}"

    @property
    def marks(self) -> tuple[Mark, ...]:
        """The measured clearances: one at each time step."""
        x, y = self.axes
        return tuple(
            Mark(self.level(value), px(x.at(k)), px(y.clamped(value)))
            for k, value in enumerate(self.sample.clearances_m)
        )

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """The line that joins them, cut where it passes the required clearance or meets 0."""
        x, y = self.axes
        found: list[tuple[Level, list[str]]] = []
        for level, pieces in self._pieces():
            points = [f"{px(x.at(at))},{px(y.clamped(value))}" for at, value in pieces]
            if found and found[-1][0] == level:
                found[-1][1].append(points[1])
            else:
                found.append((level, points))
        return tuple(Stretch(level, " ".join(points)) for level, points in found)

    def _pieces(self) -> Iterator[tuple[Level, list[tuple[float, float]]]]:
        """Straight pieces of one level each, as (time step, clearance) pairs."""
        values, required = self.sample.clearances_m, self.sample.d_safe_m
        top = self.axes[1].domain[1]
        for k, (before, after) in enumerate(pairwise(values)):
            ends = [(float(k), before), (float(k + 1), after)]
            crossed = [c for c in (top, required) if before > c > after]
            ends[1:1] = [(k + (before - c) / (before - after), c) for c in crossed]
            for (at, high), (until, low) in pairwise(ends):
                yield self.level((high + low) / 2), [(at, high), (until, low)]


@dataclass(frozen=True)
class Motion:
    """One scene with those who drive it."""

    family: str
    task: Task
    url: str | None
    runs: tuple[Run, ...]
    time_step_s: float
    pictures: tuple[SamplePictureRow, ...] = ()
    """What cameras saw, and what it was edited into, where the licence lets it be shown."""

    @property
    def first(self) -> SampleDrawing:
        """The drawing of the first entry."""
        return self.runs[0].sample

    @property
    def ground(self) -> Markup:
        """The grid in metres."""
        return Markup("".join(grid(self.runs[0].view)))

    @property
    def hazard(self) -> Markup:
        """The hazard region with the band of required clearance."""
        return Markup("".join(hazard(self.first, self.runs[0].view)))

    @property
    def words(self) -> str:
        """What the picture shows, for those who do not see it."""
        each = "; ".join(f"{run.method}: {outcome(run.sample)}" for run in self.runs)
        return f"{self.task.label}, seen from above: {self.first.hazard}. {each}."

    @property
    def line_words(self) -> str:
        """What the clearance line says, for those who do not see it."""
        each = "; ".join(
            f"{run.method} {', '.join(run.numbers.split()) or 'no answer'}" for run in self.runs
        )
        return (
            f"Clearance in metres every {self.time_step_s:g} s from 0 to {self.end_s:g} s, "
            f"{self.first.d_safe_m:g} m required. {each}."
        )

    @property
    def axes(self) -> tuple[Scale, Scale]:
        """Time steps along x, metres along y."""
        return self.runs[0].axes

    @property
    def end_s(self) -> float:
        """Time of the last waypoint."""
        return self.axes[0].domain[1] * self.time_step_s

    @property
    def seconds(self) -> list[tuple[str, str]]:
        """Ticks along x: position and text."""
        scale = nice_scale([0.0, self.end_s], (PLOT[0], PLOT[1]), n_ticks=4)
        return [(px(scale.at(tick)), f"{tick:g} s") for tick in scale.ticks]

    @property
    def required_y(self) -> str:
        """Where the required clearance stands."""
        return px(self.axes[1].at(self.first.d_safe_m))


def motion(
    runs: Sequence[tuple[str, SampleDrawing]],
    protocol: ProtocolDocument,
    url: str | None = None,
    pictures: tuple[SamplePictureRow, ...] = (),
) -> Motion:
    """Lay the drawings of one sample over each other.

    `runs` are name and drawing of each entry, all of the same sample; `url` is the first one's own
    page.
    """
    first = runs[0][1]
    left, right, top, bottom = PLOT
    axes = (
        Scale((0.0, float(protocol.geometry.waypoints)), (left, right), ()),
        Scale((0.0, TIMES_SHOWN * first.d_safe_m), (bottom, top), ()),
    )
    view = View.of([sample for _, sample in runs], WIDTH, HEIGHT)
    families = {family.id: family.title for family in protocol.families}
    return Motion(
        family=families[first.family],
        task=protocol.taxonomy.task(first.task),
        url=url,
        runs=tuple(Run(name, sample, view, axes) for name, sample in runs),
        time_step_s=protocol.geometry.time_step_s,
        pictures=pictures,
    )


def scene_of_family(samples: Sequence[DrawnSample], family: str) -> SampleDrawing | None:
    """Return the drawing of the scene that every entry of a split shares."""
    found = (each.drawing for each in samples if each.chosen_as == "scene")
    return next((drawing for drawing in found if drawing.family == family), None)
