"""Reads whole regions from published sheets alone: one sample of each task, or one after the other.

The attacker knows the labels, answers nothing but the samples that are read, and searches the
rectangle that says what was published (differential evolution); the next path is the one about
which the rectangles found so far differ most.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.drawing import tube_pieces_m
from exceptiondrive_scoring.grade import clearance_compliance, proximity_response
from exceptiondrive_worker.splits.store import load_split, read_split

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

FloatArray = NDArray[np.float64]
METRICS = ("hcc", "ur", "hpr")
N_GUESSES, N_PATHS, N_GENERATIONS, N_LAST = 48, 40, 25, 300
LEAST = np.array([3.0, -14.0, 0.4, 0.4, -np.pi / 2])
"""Of a rectangle: middle ahead and to the left, half its sides in metres, its heading."""
MOST = np.array([60.0, 14.0, 6.0, 3.0, np.pi / 2])


def quads(guesses: FloatArray) -> Any:
    """Return rectangles (N, 5) as polygons (N,)."""
    x, y, length, width, heading = guesses.T[..., None]
    ahead = np.array([1, 1, -1, -1]) * np.abs(length)
    left = np.array([1, -1, -1, 1]) * np.abs(width)
    cos, sin = np.cos(heading), np.sin(heading)
    corners = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], -1)
    return shapely.polygons(corners)


@dataclass
class Victim:
    """One region that is read: what was asked of it, what was said, what it may be."""

    row: int
    d_safe_m: float
    chance: np.random.Generator
    tubes: list[Any] = field(default_factory=list)
    seen: list[FloatArray] = field(default_factory=list)
    guesses: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.guesses = self.chance.uniform(LEAST, MOST, (4 * N_GUESSES, 5))

    def values(self, polygons: Any, tube: Any) -> FloatArray:
        """What each rectangle would say; (3, N) in the order of `METRICS`."""
        clearance_m = shapely.distance(polygons, tube)
        hit = clearance_m <= 0
        required_m = np.full(len(hit), self.d_safe_m)
        hcc = clearance_compliance(clearance_m, hit, required_m)
        return np.array([hcc, hit, proximity_response(clearance_m, hit, required_m)])

    def errors(self, guesses: FloatArray, tolerance: float) -> FloatArray:
        """How much what was published contradicts each rectangle, in roundings."""
        polygons = quads(guesses)
        sides_m = guesses[:, 2:4]  # of two that say the same, the usual one
        total: FloatArray = 1e-3 * np.abs(sides_m - 1.0).sum(axis=1)
        for tube, said in zip(self.tubes, self.seen, strict=True):
            gap = np.abs(self.values(polygons, tube) - said[:, None]) / tolerance
            total += np.log1p(np.maximum(gap - 0.5, 0.0)).sum(0)
        return total

    def search(self, tolerance: float, n_generations: int) -> None:
        """Let rectangles that contradict what was published give way to ones that do less."""
        fresh = self.chance.uniform(LEAST, MOST, (N_GUESSES, 5))
        self.guesses = np.concatenate([self.guesses, fresh])
        errors = self.errors(self.guesses, tolerance)
        for _ in range(n_generations):
            one, two, three = (self.chance.permutation(len(errors)) for _ in range(3))
            best = self.guesses[np.argmin(errors)]
            base = np.where(self.chance.random((len(errors), 1)) < 0.3, best, self.guesses[one])
            factor = self.chance.uniform(0.3, 0.9, (len(errors), 1))
            tried = base + factor * (self.guesses[two] - self.guesses[three])
            tried += self.chance.normal(0, 1e-3, tried.shape)
            keeps = self.chance.random(tried.shape) < 0.3
            tried = np.clip(np.where(keeps, self.guesses, tried), LEAST, MOST)
            found = self.errors(tried, tolerance)
            is_better = found < errors
            self.guesses[is_better], errors[is_better] = tried[is_better], found[is_better]
        order = np.argsort(errors)[: 2 * N_GUESSES]
        self.guesses = self.guesses[order]

    def iou(self, region_m: FloatArray) -> float:
        """Of the rectangle that contradicts least, with the true region."""
        guess, true = quads(self.guesses[:1])[0], shapely.Polygon(region_m)
        return float(guess.intersection(true).area / guess.union(true).area)


@dataclass
class Attack:
    """Uploads one file after the other about the samples of `rows`.

    Attributes:
        oracle: Publishes as the server does.
        rows: Samples that are read at once, one of a task; where tasks are not shown, one sample.
    """

    oracle: "Oracle"
    rows: Sequence[int]
    seed: int = 0
    victims: list[Victim] = field(init=False)

    def __post_init__(self) -> None:
        arrays = self.oracle.split.arrays
        smallest = np.bincount(arrays.task_index).min()
        self.by_task = smallest >= self.oracle.protocol.publication.min_samples_per_cell
        if not self.by_task and len(self.rows) > 1:
            raise ValueError("the totals part no two: they are read of one sample")
        self.chance = np.random.default_rng(self.seed)
        self.victims = [Victim(row, float(arrays.d_safe_m[row]), self.chance) for row in self.rows]

    def upload(self) -> None:
        """Send one file, read what is published of it, and search on."""
        arrays, protocol = self.oracle.split.arrays, self.oracle.protocol
        edited = np.full((arrays.n_samples, 6, 2), np.nan)
        for victim in self.victims:
            path = self._path(victim)
            edited[victim.row] = path
            pieces = tube_pieces_m(np.concatenate([np.zeros((1, 2)), path]), protocol.geometry)
            victim.tubes.append(shapely.union_all([shapely.Polygon(piece) for piece in pieces]))
        sheet = self.oracle.ask(edited)
        for victim in self.victims:
            victim.seen.append(self._said(sheet, victim.row))
            victim.search(self._tolerance(victim.row), N_GENERATIONS)

    def ious(self) -> list[float]:
        """How well each region is known."""
        for victim in self.victims:
            victim.search(self._tolerance(victim.row), N_LAST)
        regions_m = self.oracle.split.arrays.regions_m
        return [victim.iou(regions_m[victim.row]) for victim in self.victims]

    def _n(self, row: int) -> int:
        arrays = self.oracle.split.arrays
        if not self.by_task:
            return int(arrays.n_samples)
        return int(np.count_nonzero(arrays.task_index == arrays.task_index[row]))

    def _tolerance(self, row: int) -> float:
        return self._n(row) * 10.0 ** -(2 + self.oracle.protocol.publication.percent_decimals)

    def _said(self, sheet: ScoreSheet, row: int) -> FloatArray:
        """The sample's own values: those of all others are missing, so they are known."""
        n = self._n(row)
        task = self.oracle.protocol.tasks[self.oracle.split.arrays.task_index[row]].id
        cell = sheet.tasks[task].metrics if self.by_task else sheet.micro
        means = np.array([cell[key] for key in METRICS], dtype=np.float64)
        own: FloatArray = n * means - (n - 1) * np.array([0.0, 1.0, 0.0])
        return own

    def _path(self, victim: Victim) -> FloatArray:
        """The path about which the guesses differ most, in roundings."""
        polygons = quads(victim.guesses[:N_GUESSES])
        middles = victim.guesses[:N_GUESSES, :2]
        best, most = np.zeros((6, 2)), -1.0
        for _ in range(N_PATHS):
            toward = middles[self.chance.integers(len(middles))] + self.chance.normal(0, 4, 2)
            toward[0] = np.clip(toward[0], 0.5, 80)
            aside = toward[1] + self.chance.normal(0, 2) * self.chance.integers(0, 2)
            x = np.linspace(1, 6, 6) / 6 * toward[0]
            y = np.minimum(np.arange(1, 7) / 2, 1) * aside
            y[-1] = toward[1]
            path = np.stack([x, y], -1)
            geometry = self.oracle.protocol.geometry
            pieces = tube_pieces_m(np.concatenate([np.zeros((1, 2)), path]), geometry)
            tube = shapely.union_all([shapely.Polygon(piece) for piece in pieces])
            values = victim.values(polygons, tube) / self._tolerance(victim.row)
            told = float(sum(len(np.unique(np.round(row))) for row in values))
            if told > most:
                best, most = path, told
        return best


def main() -> None:
    """Print how well 21 regions are read; the figures of docs/leakage.md."""
    from tests.leak.oracle import SAMPLE, Oracle

    for version, counts in (("1.1", (8, 22)), (NEWEST_WITHHELD, (8, 20))):
        protocol = packaged_protocol(version)
        oracle = Oracle(load_split(read_split(SAMPLE), protocol), protocol)
        rows = np.unique(oracle.split.arrays.task_index, return_index=True)[1].tolist()
        attacks = (
            [Attack(oracle, rows)] if version == "1.1" else [Attack(oracle, [r]) for r in rows]
        )
        for before, count in pairwise((0, *counts)):
            for attack in attacks:
                for _ in range(count - before):
                    attack.upload()
            ious = np.array([iou for attack in attacks for iou in attack.ious()])
            print(version, count, np.median(ious).round(2), (ious > 0.5).sum())  # noqa: T201


if __name__ == "__main__":
    main()
