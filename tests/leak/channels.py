"""Everything that is published of one unknown clearance, channel by channel, and the bounds of it.

Two uploads differ in one sample. Whatever is published is a function of that sample's clearance, in
steps: each channel parts the line of clearances at so many places, and all together at no more than
the sum of these. So the bounds of channels are added, and what an attacker reads is counted.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument, PublicationSection
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.bootstrap import (
    SceneSums,
    bootstrap,
    fewest_scenes,
    resample,
    scene_counts,
    scene_sums,
    scene_weights,
    scenes_by_freedom,
    where_enough,
)
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_scoring.compare import scenes_that_differ
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.interval import percentile_intervals
from exceptiondrive_scoring.rank import rank_intervals, told_rank_intervals
from exceptiondrive_worker.boards.rounding import Rounding

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

FloatArray = NDArray[np.float64]
METRICS = PLANNING.interval_metrics
OF_REGIONS = ("hcc", "ur", "hpr")
CHANNELS = (
    "means of the totals",
    "means of families and tasks",
    "sensitivities",
    "outcome shares",
    "clearance curve",
    "intervals",
    "pair intervals",
    "discordant shares",
    "rank intervals",
    "progress, CTS, Source L2, flags",
)
TURNS = {"hcc": 1, "ur": 1, "hpr": 2}
"""Pieces on which a metric of one sample rises or falls with its clearance."""
N_COMPANIONS = 9
"""Entries of other teams that a board of ten compares with each upload."""
WHOLE_PER_CENT = 0.01
Answers = dict[str, list[Any]]
"""Channel to what it says, for each clearance that was tried."""


@dataclass(frozen=True)
class Exact:
    """What scoring finds for each of K clearances of one sample; nothing is rounded.

    Attributes:
        clearance_m: (K,).
        sheets: K exact sheets.
        own: K uncertainties of the upload itself.
        pairs: Companion to K intervals (M, 2) of the headline and (F, M, 2) of families.
        discordant: Companion to K shares of the samples that differ in the first metric.
        beside: Uncertainties of the companions.
    """

    clearance_m: FloatArray
    sheets: list[ScoreSheet]
    own: list[Any]
    pairs: list[list[tuple[FloatArray, FloatArray]]]
    discordant: list[list[float]]
    beside: list[Any]


def tried(oracle: "Oracle", sample: int, clearance_m: FloatArray, seed: int = 0) -> Exact:
    """Score an upload whose answer about one sample has each of these clearances.

    Every other answer is the same; companions answer a twentieth of them otherwise.
    """
    scoring, arrays, protocol = scoring_of(PLANNING.id), oracle.split.arrays, oracle.protocol
    still = np.zeros((arrays.n_samples, 6, 2))
    base = oracle.measured(still)
    chance = np.random.default_rng(seed)

    def moved(rows: NDArray[np.integer], values: FloatArray) -> dict[str, NDArray[np.generic]]:
        clearances = np.array(base["clearance_m"], dtype=np.float64)
        clearances[rows] = values
        return base | {"clearance_m": clearances, "intrusion": clearances <= 0}

    def scores_of(measured: Mapping[str, NDArray[np.generic]]) -> SampleScores:
        return scoring.grade(dict(measured), arrays, protocol).only(METRICS)

    def sums_of(scores: SampleScores) -> SceneSums:
        return scene_sums(scores, arrays, protocol.taxonomy)

    def bootstrapped(sums: Sequence[SceneSums]) -> list[Any]:
        return list(bootstrap(sums, PLANNING, protocol.ranking, protocol.grading.headline))

    all_rows = np.arange(arrays.n_samples)
    start = moved(all_rows, chance.uniform(0, 3, arrays.n_samples))
    base = start
    columns = [moved(np.array([sample]), np.array([each])) for each in clearance_m]
    scores = [scores_of(each) for each in columns]
    others = []
    for _ in range(N_COMPANIONS):
        rows = chance.choice(np.delete(all_rows, sample), arrays.n_samples // 20, replace=False)
        others.append(scores_of(moved(rows, chance.uniform(0, 3, len(rows)))))
    own = bootstrapped([sums_of(each) for each in scores])
    beside = bootstrapped([sums_of(each) for each in others])
    ref = oracle.split.manifest.ref
    return Exact(
        clearance_m=clearance_m,
        sheets=[exact_sheet(scoring, each, arrays, ref, protocol) for each in columns],
        own=own,
        pairs=[list(_pairs(scores, other, sums_of, protocol)) for other in others],
        discordant=[
            [float((each.values[:, 0] != other.values[:, 0]).mean()) for each in scores]
            for other in others
        ],
        beside=beside,
    )


def _pairs(
    scores: Sequence[SampleScores],
    other: SampleScores,
    sums_of: Callable[[SampleScores], SceneSums],
    protocol: ProtocolDocument,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Intervals of the differences, as `exceptiondrive_scoring.compare` has them."""
    gaps = [replace(each, values=each.values - other.values) for each in scores]
    ranking, headline = protocol.ranking, protocol.grading.headline
    drawn = resample([sums_of(each) for each in gaps], ranking, METRICS)
    for entry, draws in drawn:
        n, n_differing = scene_counts(entry), scenes_that_differ(entry)
        free, fewest = scenes_by_freedom(n), fewest_scenes(n)
        of_headline = np.minimum(free.headline(headline), n_differing.headline(headline))
        of_families = np.minimum(free.families, n_differing.families)
        yield (
            where_enough(
                percentile_intervals(draws.headline(headline), of_headline, ranking.confidence),
                fewest.headline(headline),
                ranking,
            ),
            where_enough(
                percentile_intervals(draws.families, of_families, ranking.confidence),
                n.families,
                ranking,
            ),
        )


def published(exact: Exact, protocol: ProtocolDocument, *, is_public: bool = False) -> Answers:
    """Return what each channel publishes for each clearance."""
    rounding = Rounding(PLANNING, protocol.publication, is_public=is_public)
    headline, families = protocol.grading.headline, [family.id for family in protocol.families]
    sheets = [rounding.sheet(sheet) for sheet in exact.sheets]
    shown = {
        name: row.n is not None and row.n >= protocol.publication.min_samples_per_cell
        for name, row in sheets[0].families.items()
    }

    def means(sheet: ScoreSheet, *groups: str) -> list[Any]:
        rows = [sheet.micro, sheet.macro_family] if not groups else []
        rows += [row.metrics for group in groups for row in getattr(sheet, group).values()]
        return [row[key] for row in rows for key in OF_REGIONS]

    def ends(overall: FloatArray, by_family: FloatArray) -> list[Any]:
        keys = [metric.key for metric in METRICS]
        told = [rounding.interval(key, _ends(overall[keys.index(key)])) for key in OF_REGIONS]
        told += [
            rounding.interval(key, _ends(by_family[index, keys.index(key)]))
            for index, family in enumerate(families)
            if shown.get(family)
            for key in OF_REGIONS
        ]
        return told

    def ranks(own: Any) -> list[int]:
        """The places that are left open among the companions, by HCC."""
        board = [own, *exact.beside]
        if is_public:
            confidence = protocol.ranking.confidence
            return [int(end) for end in rank_intervals(board, "descending", confidence)[0]]
        first = [metric.key for metric in METRICS].index("hcc")
        told = [
            rounding.interval("hcc", _ends(getattr(each, headline)[first])) or (-np.inf, np.inf)
            for each in board
        ]
        return [int(end) for end in told_rank_intervals(np.array(told), "descending")[0]]

    outcomes = ("clear", "close", "hit_reacting", "hit_unmoved")
    answers: Answers = {
        "means of the totals": [means(sheet) for sheet in sheets],
        "means of families and tasks": [means(sheet, "families", "tasks") for sheet in sheets],
        "sensitivities": [
            [value for row in sheet.extra.values() for key, value in row.items() if key != "n"]
            for sheet in sheets
        ],
        "outcome shares": [
            [row[key] for row in (sheet.micro, sheet.macro_family) for key in outcomes]
            for sheet in sheets
        ],
        "clearance curve": [sheet.clearance_curve for sheet in sheets],
        "intervals": [ends(getattr(each, headline), each.families) for each in exact.own],
        "pair intervals": [
            [ends(*pairs[number]) for pairs in exact.pairs] for number in range(len(sheets))
        ],
        "discordant shares": [
            [rounding.fraction(shares[number]) for shares in exact.discordant] if is_public else []
            for number in range(len(sheets))
        ],
        "rank intervals": [ranks(each) for each in exact.own],
        "progress, CTS, Source L2, flags": [
            [sheet.plausibility, *(sheet.micro[key] for key in ("progress", "cts", "source_l2_m"))]
            for sheet in sheets
        ],
    }
    together = [list(row) for row in zip(*answers.values(), strict=True)]
    return answers | {"together": together}


def _ends(interval: FloatArray) -> tuple[float, float] | None:
    return None if np.isnan(interval).any() else (float(interval[0]), float(interval[1]))


def n_answers(answers: Sequence[Any]) -> int:
    """Different answers."""
    return len({repr(each) for each in answers})


@dataclass(frozen=True)
class Places:
    """Bounds: at how many places each channel can part the clearances of a sample."""

    oracle: "Oracle"
    sample: int

    @property
    def _publication(self) -> PublicationSection:
        return self.oracle.protocol.publication

    @property
    def _shown_sizes(self) -> tuple[int | None, int | None]:
        """Sizes of the sample's family and task, where these are shown."""
        arrays, least = self.oracle.split.arrays, self._publication.min_samples_per_cell
        found = []
        for index in (arrays.family_index, arrays.task_index):
            size = int(np.count_nonzero(index == index[self.sample]))
            found.append(size if size >= least else None)
        return found[0], found[1]

    @property
    def _weights(self) -> tuple[float, float]:
        """What the sample weighs in the mean of all samples, and in the mean of families."""
        arrays, protocol = self.oracle.split.arrays, self.oracle.protocol
        n_family = np.count_nonzero(arrays.family_index == arrays.family_index[self.sample])
        n_families = len(np.unique(arrays.family_index))
        assert n_families <= len(protocol.families)
        return 1 / arrays.n_samples, 1 / float(n_family * n_families)

    @property
    def _step(self) -> float:
        return self.oracle.cells.step

    def of_channels(self, *, is_public: bool = False) -> dict[str, int]:
        """Places of each channel, under the names of `published`."""
        micro, macro = self._weights
        cells = [1 / size for size in self._shown_sizes if size]
        factors = len(self.oracle.protocol.grading.sensitivity_factors)
        draw, draw_family = self.most_in_a_draw()
        family = [draw_family] if self._shown_sizes[0] else []
        step = self._step if is_public else WHOLE_PER_CENT
        ends = sum(2 * _places(key, w, step, 1) for w in (draw, *family) for key in OF_REGIONS)
        return {
            "means of the totals": self._of_means(micro, macro),
            "means of families and tasks": self._of_means(*cells),
            "sensitivities": factors
            * sum(_places(key, w, self._step) for w in (micro, macro) for key in ("hcc",)),
            "outcome shares": 4,  # hit, close, clear: two edges, once for each aggregate
            "clearance curve": 0,
            "intervals": ends,
            "pair intervals": N_COMPANIONS * ends,
            "discordant shares": 2 * N_COMPANIONS if is_public else 0,
            "rank intervals": 2 * (N_COMPANIONS if is_public else _places("hcc", draw, step, 1)),
            "progress, CTS, Source L2, flags": 0,
        }

    def together(self, *, is_public: bool = False) -> int:
        """Different answers of all channels together, at most."""
        channels = self.of_channels(is_public=is_public)
        if not is_public:
            del channels["rank intervals"]  # what intervals tell, told again
        return 1 + sum(channels.values())

    def bits(self, *, is_public: bool = False) -> float:
        """Bits of one sample and submission, at most."""
        return math.log2(self.together(is_public=is_public))

    def _of_means(self, *weights: float) -> int:
        return sum(_places(key, w, self._step) for w in weights for key in OF_REGIONS)

    def most_in_a_draw(self) -> tuple[float, float]:
        """What the sample weighs at most in the headline of a draw, and in that of its family."""
        arrays, protocol = self.oracle.split.arrays, self.oracle.protocol
        weights = scene_weights(arrays.n_scenes, protocol.ranking).astype(np.float64)
        taken = weights[arrays.scene_index[self.sample]]
        family = arrays.family_index == arrays.family_index[self.sample]
        of_family = np.bincount(arrays.scene_index[family], minlength=arrays.n_scenes) @ weights
        in_family = float((taken / of_family).max())
        if protocol.grading.headline == "macro_family":
            return in_family / len(np.unique(arrays.family_index)), in_family
        everything = np.bincount(arrays.scene_index, minlength=arrays.n_scenes) @ weights
        return float((taken / everything).max()), in_family


def _places(metric: str, weight: float, step: float, slack: int = 0) -> int:
    """Places where a rounded mean can change while one sample's value runs over all it may be.

    Args:
        metric: UR changes at one clearance alone; HPR rises and falls.
        weight: Of the sample in the mean.
        step: Of rounding.
        slack: For what is no plain mean: an interval's end leaps where Wilson's takes its place.
    """
    if metric == "ur":
        return 1 + slack
    return TURNS[metric] * (math.floor(weight / step + 1e-9) + 1) + slack
