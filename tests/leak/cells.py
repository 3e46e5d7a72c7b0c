"""How much published numbers can tell about a withheld split: bounds from a phase's settings.

A participant knows everything but the regions and the labels of samples, and may submit what they
like. Two submissions that differ in one sample show, by the difference of a published mean over n
samples, that sample's value to +-n times the rounding step. The bounds here hold for every such
attack; docs/leakage.md says in words what they leave open.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from exceptiondrive_schemas.protocol import PublicationSection

BITS_OF_FLIP = 1.0
"""By UR: whether one sample is hit. Coarse rounding hides a flip only until others are moved so that
the mean lies at a rounding threshold, which costs a few submissions once."""


@dataclass(frozen=True)
class PublishedCells:
    """What a phase publishes: sizes of families and tasks, and how it rounds.

    Attributes:
        publication: Decimals, and the fewest samples of a cell that is shown.
        family_sizes: Samples of each family.
        task_sizes: Samples of each task.
    """

    publication: PublicationSection
    family_sizes: Mapping[str, int]
    task_sizes: Mapping[str, int]

    @property
    def n(self) -> int:
        """Samples of the split."""
        return sum(self.family_sizes.values())

    @property
    def step(self) -> float:
        """Smallest difference of two published fractions."""
        return 10.0 ** -(self.publication.percent_decimals + 2)

    def resolution(self, n: int) -> float:
        """Uncertainty of one sample's value in [0, 1], seen through a cell of n samples.

        A cell that is too small to be shown still moves the mean of families and the overall
        mean, which are shown: one withheld cell alone can be told from them, only more coarsely.
        """
        if n >= self.publication.min_samples_per_cell:
            return n * self.step
        return min(n * len(self.family_sizes), self.n) * self.step

    def outcomes(self, n: int) -> int:
        """Different answers about one sample's value that one submission can get from a cell."""
        return math.floor(1 / self.resolution(n) + 1e-9) + 2

    def bits_of_sample(self, n: int) -> float:
        """Most bits about one sample that one more submission yields by HCC and HPR of a cell."""
        return math.log2(self.outcomes(n))

    def bits_per_submission(self) -> float:
        """Most bits of one submission that changes one sample in each of the finest cells.

        HCC and HPR tell the clearance of the sample on either side of the required one, UR whether
        it is hit: both together are one value each of HCC and HPR, and UR follows from them.
        """
        return sum(2 * self.bits_of_sample(n) for n in self.task_sizes.values() if n)

    def bits_of_any_submission(self) -> float:
        """Most bits of any submission at all: every mean of HCC, HPR and UR of a task at its finest.

        Weighing many samples at once comes nearer to it than differencing one sample does.
        """
        return self.bits_of_more_means(3)

    def bits_of_more_means(self, n_means: int) -> float:
        """Most bits of a submission by so many means in every task."""
        n_cells = sum(1 for n in self.task_sizes.values() if n)
        return n_cells * self.bits_of_means(n_means)

    def bits_of_means(self, n_means: int) -> float:
        """Most bits of a submission by so many means of one cell."""
        return n_means * math.log2(1 / self.step + 1)

    def clearance_error_m(self, clearance_m: float, d_safe_m: float, n: int) -> float:
        """Typical error (mean of the rounding's) of a clearance that is read from HPR.

        Args:
            clearance_m: True clearance, at least d_safe_m.
            d_safe_m: Required clearance.
            n: Samples of the cell.

        Returns:
            The error in metres; HPR = d_safe / d there, so it grows with the square of d.
        """
        return self.resolution(n) / 3 * clearance_m**2 / d_safe_m


def least_width_m(range_m: float, bits_per_submission: float, n_submissions: int) -> float:
    """Least width to which any search can narrow one coordinate, in the worst case.

    Args:
        range_m: Where the coordinate may lie at first.
        bits_per_submission: What one submission tells about the sample.
        n_submissions: Submissions spent on it.
    """
    return range_m / math.exp2(bits_per_submission * n_submissions)
