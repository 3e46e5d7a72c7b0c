"""Trajectories of many samples, column by column: loops then run in C, without numpy."""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import sub
from typing import NamedTuple

Column = Sequence[float]
"""One number of each of n samples, metres."""
Whole = tuple["array[float] | None", "array[float] | None"]
"""Source and edited trajectory of a sample, flat; None where incomplete or missing."""


class Steps(NamedTuple):
    """One step of each trajectory."""

    x_m: Column
    y_m: Column
    length_m: Column


@dataclass(frozen=True)
class Tracks:
    """Trajectories of n samples with T waypoints each: T columns of x, and of y."""

    x_m: Sequence[Column]
    y_m: Sequence[Column]

    @classmethod
    def of(cls, trajectories: Sequence[Iterable[float]], n_waypoints: int) -> Tracks:
        """Arrange complete trajectories, each flat (x1, y1, x2, y2, ...), in columns.

        Raises:
            ValueError: They differ in the number of waypoints.
        """
        width, joined = 2 * n_waypoints, array("d")
        for flat in trajectories:
            joined.extend(flat)
        if len(joined) != width * len(trajectories):
            raise ValueError("the trajectories have different numbers of waypoints")
        return cls.cut(joined, n_waypoints)

    @classmethod
    def cut(cls, joined: array[float], n_waypoints: int) -> Tracks:
        """Arrange complete trajectories, given one after the other, in columns."""
        width = 2 * n_waypoints
        columns = [joined[start::width] for start in range(width)]
        return cls(columns[::2], columns[1::2])

    def first(self, n: int) -> Tracks:
        """Return the first n of them; all of them is this same object, with its cached lengths."""
        if n == self.n:
            return self
        return Tracks([x[:n] for x in self.x_m], [y[:n] for y in self.y_m])

    @cached_property
    def step_lengths_m(self) -> tuple[Column, ...]:
        """Lengths of the T steps, the first one from the origin."""
        return tuple(list(map(math.hypot, x, y)) for x, y in self._steps_of())

    @property
    def steps(self) -> Iterator[Steps]:
        """Yield these steps."""
        for (x, y), length_m in zip(self._steps_of(), self.step_lengths_m, strict=True):
            yield Steps(list(x), list(y), length_m)

    def _steps_of(self) -> Iterator[tuple[Iterable[float], Iterable[float]]]:
        origin = [0.0] * self.n
        for x, x_before, y, y_before in zip(
            self.x_m, (origin, *self.x_m), self.y_m, (origin, *self.y_m), strict=False
        ):
            yield map(sub, x, x_before), map(sub, y, y_before)

    @cached_property
    def lengths_m(self) -> Column:
        """Length of each path."""
        return list(map(sum, zip(*self.step_lengths_m, strict=True)))

    @property
    def n(self) -> int:
        """Number of trajectories."""
        return len(self.x_m[0])

    @cached_property
    def ends_m(self) -> Column:
        """Distance of each end from the origin."""
        return list(map(math.hypot, self.x_m[-1], self.y_m[-1]))

    def gaps_m(self, others: Tracks) -> Iterator[tuple[float, ...]]:
        """Yield the T distances between each trajectory and another one, waypoint by waypoint."""
        columns = [
            map(math.hypot, map(sub, x, other_x), map(sub, y, other_y))
            for x, other_x, y, other_y in zip(
                self.x_m, others.x_m, self.y_m, others.y_m, strict=True
            )
        ]
        return zip(*columns, strict=True)


def both_first(pairs: Iterable[Whole]) -> tuple[list[array[float]], list[array[float]], int]:
    """Return source and edited trajectories, pairs with both first, and the number of these."""
    both, sources, edited = [], [], []
    for source, of_edit in pairs:
        if source is not None and of_edit is not None:
            both.append((source, of_edit))
        elif source is not None:
            sources.append(source)
        elif of_edit is not None:
            edited.append(of_edit)
    return (
        [source for source, _ in both] + sources,
        [of_edit for _, of_edit in both] + edited,
        len(both),
    )


class PairTracks(NamedTuple):
    """Complete trajectories of a file; those of the `n_both` pairs with both come first."""

    source: Tracks
    edited: Tracks
    n_both: int

    @classmethod
    def of(cls, pairs: Iterable[Whole], n_waypoints: int) -> PairTracks:
        """Arrange the trajectories of pairs in columns.

        Raises:
            ValueError: One has another number of waypoints.
        """
        sources, edited, n_both = both_first(pairs)
        return cls(Tracks.of(sources, n_waypoints), Tracks.of(edited, n_waypoints), n_both)
