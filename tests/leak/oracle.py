"""An oracle that publishes as the server does."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.leak.cells import PublishedCells

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.store import LoadedSplit

SAMPLE = Path(__file__).parents[2] / "hidden_splits" / "sample" / "split.json.gz"
FloatArray = NDArray[np.float64]


@dataclass
class Oracle:
    """Answers a submission with its published sheet; the attacker sees nothing else."""

    split: LoadedSplit
    protocol: ProtocolDocument
    n_asked: int = 0
    is_rounded: bool = field(default=True)

    def ask(self, edited: FloatArray) -> ScoreSheet:
        """Publish the score of edited trajectories (N, T, 2); NaN is a missing one."""
        self.n_asked += 1
        exact = self.exact(edited)
        drives = self.split.manifest.recorded is not None
        rounding = Rounding(PLANNING, self.protocol.publication, has_public_drives=drives)
        return rounding.sheet(exact) if self.is_rounded else exact

    def exact(self, edited: FloatArray) -> ScoreSheet:
        """Score as the worker does; nothing is rounded."""
        scoring = scoring_of(PLANNING.id)
        measured = self.measured(edited)
        split = self.split
        return exact_sheet(scoring, measured, split.arrays, split.manifest.ref, self.protocol)

    def measured(self, edited: FloatArray) -> dict[str, NDArray[np.generic]]:
        """Withheld: what each sample measures. Only for comparing a finding with the truth."""
        answers = {"source": np.zeros_like(edited), "edited": edited}
        scoring = scoring_of(PLANNING.id)
        columns = scoring.measure(answers, self.split.arrays, self.protocol.geometry)
        return dict(columns)

    @property
    def cells(self) -> PublishedCells:
        arrays, protocol = self.split.arrays, self.protocol
        families = np.bincount(arrays.family_index, minlength=len(protocol.families))
        tasks = np.bincount(arrays.task_index, minlength=len(protocol.tasks))
        return PublishedCells(
            protocol.publication,
            {key.id: int(n) for key, n in zip(protocol.families, families, strict=True)},
            {key.id: int(n) for key, n in zip(protocol.tasks, tasks, strict=True)},
        )
