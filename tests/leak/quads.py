"""Reads whole regions from published sheets alone: of one sample of each task, or of one or two by the totals.

The attacker knows the labels, answers nothing but the samples that are read, and searches the
rectangles that say what was published (differential evolution); the next path is the one about
which the rectangles found so far differ most. Who knows other regions of a task looks near these
first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.drawing import tube_pieces_m
from exceptiondrive_scoring.grade import clearance_compliance, proximity_response
from exceptiondrive_worker.splits.store import load_split, read_split

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

FloatArray = NDArray[np.float64]
METRICS = ("ur", "hpr", "hcc")
N_GUESSES, N_PATHS, N_GENERATIONS, N_LAST = 48, 40, 25, 300
LEAST = np.array([3.0, -14.0, 0.4, 0.4, -np.pi / 2])
"""Of a rectangle: middle ahead and to the left, half its sides in metres, its heading."""
MOST = np.array([60.0, 14.0, 6.0, 3.0, np.pi / 2])
NEAR = np.array([4.0, 1.0, 0.5, 0.5, 0.2])
"""How far a region lies from one that was foreseen."""
Known = Literal["nothing", "regions", "regions and path"]
"""What of a task is known besides: its other regions, and the recorded paths of its samples."""


def quads(guesses: FloatArray) -> Any:
    """Return rectangles (..., 5) as polygons (...)."""
    x, y, length, width, heading = np.moveaxis(guesses, -1, 0)[..., None]
    ahead = np.array([1, 1, -1, -1]) * np.abs(length)
    left = np.array([1, -1, -1, 1]) * np.abs(width)
    cos, sin = np.cos(heading), np.sin(heading)
    corners = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], -1)
    return shapely.polygons(corners)


def foreseen(arrays: SplitArrays, row: int, known: Known) -> FloatArray:
    """Return the regions of the other samples of a task as rectangles (P, 5), laid along the path of `row`."""
    others = np.flatnonzero(arrays.task_index == arrays.task_index[row])
    others = others[others != row]
    if known == "nothing":
        return np.empty((0, 5))
    rectangles = np.array([_rectangle(region) for region in arrays.regions_m[others]])
    if known == "regions" or arrays.recorded_m is None:
        return rectangles
    for rectangle, path in zip(rectangles, arrays.recorded_m[others], strict=True):
        along_m = _line(path).project(shapely.Point(rectangle[:2]))
        (x, y), turn = _place(path, along_m)
        aside_m = (rectangle[1] - y) * np.cos(turn) - (rectangle[0] - x) * np.sin(turn)
        (x, y), heading = _place(arrays.recorded_m[row], along_m)
        rectangle[:2] = x - aside_m * np.sin(heading), y + aside_m * np.cos(heading)
        rectangle[4] += heading - turn
    return rectangles


def _rectangle(region: FloatArray) -> FloatArray:
    """The least rectangle (5,) about a region (4, 2), with a heading of at most an eighth of a turn."""
    box: Any = shapely.Polygon(region).minimum_rotated_rectangle
    corners = np.array(box.exterior.coords)
    sides = np.diff(corners, axis=0)[:2]
    length, width = sides if abs(sides[0, 0]) > abs(sides[0, 1]) else sides[::-1]
    halves = np.linalg.norm([length, width], axis=1) / 2
    return np.array([*box.centroid.coords[0], *halves, np.arctan(length[1] / length[0])])


def _line(path: FloatArray) -> shapely.LineString:
    """A recorded path from (0, 0) on, and straight ahead after its end."""
    points = np.concatenate([np.zeros((1, 2)), path])
    step = points[-1] - points[-2]
    step = step / np.linalg.norm(step) if np.linalg.norm(step) > 0.2 else np.array([1.0, 0.0])
    return shapely.LineString([*points, points[-1] + 100 * step])


def _place(path: FloatArray, along_m: float) -> tuple[FloatArray, float]:
    """The place (2,) so far along a path, and its heading there."""
    line = _line(path)
    here, ahead = (np.array(line.interpolate(at).coords[0]) for at in (along_m, along_m + 0.5))
    return here, float(np.arctan2(*(ahead - here)[::-1]))


@dataclass
class Victims:
    """K regions that are read together: what was asked of them, what was said, what they may be.

    Attributes:
        rows: Their samples.
        d_safe_m: (K,).
        factors: Of the required clearances under which HCC is told; the first is 1.
        shares: (M, K) what of each sample's value is in each of M means, in roundings.
        foreseen: (K, P, 5) rectangles that each region may be like; P may be 0.
    """

    rows: Sequence[int]
    d_safe_m: FloatArray
    factors: tuple[float, ...]
    shares: FloatArray
    foreseen: FloatArray
    chance: np.random.Generator
    tubes: list[Any] = field(default_factory=list)
    seen: list[FloatArray] = field(default_factory=list)
    guesses: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.guesses = self._any(4 * N_GUESSES)

    def told(self, guesses: FloatArray, tubes: Any) -> FloatArray:
        """What rectangles (N, K, 5) would say, in roundings: (N, M, 3 or more), as `Attack` reads it."""
        clearance_m = shapely.distance(quads(guesses), tubes)
        hit = clearance_m <= 0
        required_m = np.broadcast_to(self.d_safe_m, hit.shape)
        values = [~hit, proximity_response(clearance_m, hit, required_m)]
        values += [clearance_compliance(clearance_m, hit, f * required_m) for f in self.factors]
        told: FloatArray = np.einsum("mk,qnk->nmq", self.shares, np.array(values, dtype=np.float64))
        return told

    def errors(self, guesses: FloatArray) -> FloatArray:
        """How much what was published contradicts each guess, in roundings."""
        sides_m = guesses[..., 2:4]  # of two that say the same, the usual one
        total: FloatArray = 1e-3 * np.abs(sides_m - 1.0).sum(axis=(1, 2))
        for tubes, said in zip(self.tubes, self.seen, strict=True):
            gap = np.abs(self.told(guesses, tubes) - said)
            total += np.log1p(np.maximum(gap - 0.5, 0.0)).sum(axis=(1, 2))
        if self.foreseen.size:
            far = np.abs((guesses[:, :, None] - self.foreseen) / NEAR).sum(axis=3)
            total += 0.02 * far.min(axis=2).sum(axis=1)
        return total

    def search(self, n_generations: int) -> None:
        """Let guesses that contradict what was published give way to ones that do less."""
        self.guesses = np.concatenate([self.guesses, self._any(N_GUESSES)])
        errors = self.errors(self.guesses)
        for _ in range(n_generations):
            one, two, three = (self.chance.permutation(len(errors)) for _ in range(3))
            best = self.guesses[np.argmin(errors)]
            is_best = self.chance.random((len(errors), 1, 1)) < 0.3
            base = np.where(is_best, best, self.guesses[one])
            factor = self.chance.uniform(0.3, 0.9, (len(errors), 1, 1))
            tried = base + factor * (self.guesses[two] - self.guesses[three])
            tried += self.chance.normal(0, 1e-3, tried.shape)
            keeps = self.chance.random(tried.shape) < 0.3
            tried = np.clip(np.where(keeps, self.guesses, tried), LEAST, MOST)
            found = self.errors(tried)
            is_better = found < errors
            self.guesses[is_better], errors[is_better] = tried[is_better], found[is_better]
        order = np.argsort(errors)[: 2 * N_GUESSES]
        self.guesses = self.guesses[order]

    def best(self) -> Any:
        """The rectangles that contradict least, (K,)."""
        return quads(self.guesses[0])

    def _any(self, n: int) -> FloatArray:
        shape = n, len(self.rows), 5
        if not self.foreseen.size:
            return self.chance.uniform(LEAST, MOST, shape)
        drawn = self.chance.integers(self.foreseen.shape[1], size=shape[:2])
        like = self.foreseen[np.arange(shape[1]), drawn]
        return np.clip(like + self.chance.normal(0, NEAR, shape), LEAST, MOST)


@dataclass
class Attack:
    """Uploads one file after the other about the samples of `rows`.

    Attributes:
        oracle: Publishes as the server does.
        rows: Samples that are read at once: each of a task of its own, where tasks are shown.
    """

    oracle: "Oracle"
    rows: Sequence[int]
    seed: int = 0
    known: Known = "nothing"
    victims: list[Victims] = field(init=False)

    def __post_init__(self) -> None:
        smallest = np.bincount(self.oracle.split.arrays.task_index).min()
        self.by_task = smallest >= self.oracle.protocol.publication.min_samples_per_cell
        self.chance = np.random.default_rng(self.seed)
        together = [[row] for row in self.rows] if self.by_task else [list(self.rows)]
        self.victims = [self._victims(rows) for rows in together]

    def upload(self) -> None:
        """Send one file, read what is published of it, and search on."""
        edited = np.full((self.oracle.split.arrays.n_samples, 6, 2), np.nan)
        for victims in self.victims:
            paths = self._paths(victims)
            edited[victims.rows] = paths
            victims.tubes.append(self._tubes(paths))
        sheet = self.oracle.ask(edited)
        for victims in self.victims:
            victims.seen.append(self._said(sheet, victims.rows[0]))
            victims.search(N_GENERATIONS)

    def found(self) -> list[tuple[float, float]]:
        """How well each region is known: IoU with the true one, and the farthest place between them in metres."""
        pairs = []
        for victims in self.victims:
            victims.search(N_LAST)
            regions: Any = shapely.polygons(self.oracle.split.arrays.regions_m[victims.rows])
            pairs += list(zip(victims.best(), regions, strict=True))
        return [
            (a.intersection(b).area / a.union(b).area, a.hausdorff_distance(b)) for a, b in pairs
        ]

    def _victims(self, rows: list[int]) -> Victims:
        arrays, protocol = self.oracle.split.arrays, self.oracle.protocol
        tasks, families = (np.bincount(each) for each in (arrays.task_index, arrays.family_index))
        factors: tuple[float, ...] = ()
        sizes = [tasks[arrays.task_index[rows]]]
        if not self.by_task:
            of_families = len(families) * families[arrays.family_index[rows]]
            sizes = [np.full(len(rows), arrays.n_samples), of_families]
            factors = protocol.grading.sensitivity_factors
        shares = 1 / (np.array(sizes) * self.oracle.cells.step)
        near = np.stack([foreseen(arrays, row, self.known) for row in rows])
        return Victims(rows, arrays.d_safe_m[rows], (1.0, *factors), shares, near, self.chance)

    def _said(self, sheet: ScoreSheet, row: int) -> FloatArray:
        """Each mean in roundings: not hit, HPR, HCC, HCC of other clearances. What is missing adds nothing."""
        if self.by_task:
            task = self.oracle.protocol.tasks[self.oracle.split.arrays.task_index[row]].id
            means = [[sheet.tasks[task].metrics[key] for key in METRICS]]
        else:
            further, totals = sheet.extra.values(), (sheet.micro, sheet.macro_family)
            means = [[total[key] for key in METRICS] for total in totals]
            for mean, key in zip(means, ("hcc_micro", "hcc_macro_family"), strict=True):
                mean += [row[key] for row in further]
        said = np.array(means, dtype=np.float64)
        said[:, 0] = 1 - said[:, 0]
        return said / self.oracle.cells.step

    def _tubes(self, paths: FloatArray) -> Any:
        """Collision tubes (K,) of paths (K, 6, 2)."""
        geometry = self.oracle.protocol.geometry
        tubes = [
            tube_pieces_m(np.concatenate([np.zeros((1, 2)), path]), geometry) for path in paths
        ]
        return np.array([shapely.union_all([*map(shapely.Polygon, pieces)]) for pieces in tubes])

    def _paths(self, victims: Victims) -> FloatArray:
        """The paths (K, 6, 2) about which the guesses differ most, in roundings."""
        guesses = victims.guesses[:N_GUESSES]
        best, most = np.zeros((len(victims.rows), 6, 2)), -1.0
        for _ in range(N_PATHS):
            paths = np.array([self._path(each[:, :2]) for each in guesses.swapaxes(0, 1)])
            said = np.round(victims.told(guesses, self._tubes(paths))).reshape(len(guesses), -1)
            told = float(sum(len(np.unique(column)) for column in said.T))
            if told > most:
                best, most = paths, told
        return best

    def _path(self, middles: FloatArray) -> FloatArray:
        """A path (6, 2) that ends near the middle of one of the guesses."""
        toward = middles[self.chance.integers(len(middles))] + self.chance.normal(0, 4, 2)
        toward[0] = np.clip(toward[0], 0.5, 80)
        aside = toward[1] + self.chance.normal(0, 2) * self.chance.integers(0, 2)
        x = np.linspace(1, 6, 6) / 6 * toward[0]
        y = np.minimum(np.arange(1, 7) / 2, 1) * aside
        y[-1] = toward[1]
        return np.stack([x, y], -1)


def main() -> None:
    """Print how well regions are read; the figures of docs/leakage.md."""
    from tests.leak.oracle import SAMPLE, Oracle

    split = read_split(SAMPLE)
    of_tasks = load_split(split, packaged_protocol()).arrays.task_index
    rows = np.unique(of_tasks, return_index=True)[1].tolist()
    alone = [[row] for row in rows]
    pairs = [[rows[i], rows[i + 12]] for i in range(9)]  # of families of 80 and of 60
    attempts: list[tuple[str, int, Known, list[list[int]], tuple[int, ...]]] = [
        ("1.1", 2, "nothing", [rows], (8, 22)),
        (NEWEST_WITHHELD, 2, "nothing", alone, (8, 12, 20)),
        (NEWEST_WITHHELD, 2, "regions", alone, (4, 8, 12, 20)),
        (NEWEST_WITHHELD, 2, "regions and path", alone, (2, 4, 8, 12, 20)),
        (NEWEST_WITHHELD, 2, "nothing", pairs, (8, 12, 20)),
        (NEWEST_WITHHELD, 2, "regions and path", pairs, (4, 8, 12, 20)),
        (NEWEST_WITHHELD, 1, "regions and path", alone, (4, 8, 12, 20)),
    ]
    for version, decimals, known, together, counts in attempts:
        usual = packaged_protocol(version)
        coarse = usual.publication.model_copy(update={"percent_decimals": decimals})
        protocol = usual.model_copy(update={"publication": coarse})
        oracle = Oracle(load_split(split, protocol), protocol)
        attacks = [Attack(oracle, each, known=known) for each in together]
        for before, count in pairwise((0, *counts)):
            for attack in attacks:
                for _ in range(count - before):
                    attack.upload()
            ious, farthest_m = np.array([each for attack in attacks for each in attack.found()]).T
            read = np.median(ious).round(2), (ious > 0.5).sum(), np.median(farthest_m).round(2)
            print(version, decimals, known, len(together[0]), count, *read, len(ious))  # noqa: T201


if __name__ == "__main__":
    main()
