"""What no required clearance changes is kept; a sheet that is put together of it has the same bits."""

import numpy as np
import pytest

from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.challenge import Settled, exact_sheet, graded_sheet, scoring_of, settle
from exceptiondrive_scoring.measure import Measurements

N = 900
REF = SplitRef(name="made-up", revision="sha256:" + "0" * 64)
PLANNER = scoring_of(PLANNING.id)


def measured(seed: int, *, has_drives: bool) -> Columns:
    """Measurements of a made-up planner, some trajectories missing."""
    rng = np.random.default_rng(seed)
    edited, source = rng.random(N) > 0.1, rng.random(N) > 0.05
    columns: dict[str, np.ndarray] = {
        name: np.where(edited & source, rng.gamma(2.0, 1.5, N), np.nan)
        for name in Measurements.__dataclass_fields__
        if name not in ("intrusion", "edited_given", "source_given", "source_behind")
        and (has_drives or not name.startswith("source_l2"))
    }
    clearance_m = np.where(edited, np.maximum(rng.normal(1.0, 1.5, N), 0.0), np.nan)
    return columns | {
        "clearance_m": clearance_m,
        "intrusion": ~(clearance_m > 0),
        "edited_given": edited,
        "source_given": source,
        "source_behind": source & (rng.random(N) < 0.1),
    }


def split_of(protocol: ProtocolDocument, seed: int) -> SplitArrays:
    rng = np.random.default_rng(seed)
    taxonomy = protocol.taxonomy
    family = {each.id: index for index, each in enumerate(taxonomy.families)}
    task_index = np.sort(rng.integers(0, len(taxonomy.tasks), N))[rng.permutation(N)]
    tasks = [taxonomy.tasks[index] for index in task_index]
    return SplitArrays(
        regions_m=np.zeros((N, 4, 2)),
        task_index=task_index,
        family_index=np.array([family[task.family] for task in tasks]),
        scene_index=rng.integers(0, 200, N),
        n_scenes=200,
        d_safe_m=np.array([task.d_safe_m for task in tasks]) * rng.uniform(0.5, 1.5, N),
        acceptable=np.ones((N, 5), dtype=np.bool_),
    )


def scaled(protocol: ProtocolDocument, factor: float) -> ProtocolDocument:
    """The protocol with all required clearances multiplied, and other factors beside."""
    changes = {"d_safe_scale": factor, "sensitivity_factors": (0.3, 1.0, 4.0)}
    grading = protocol.grading.model_copy(update=changes)
    return protocol.model_copy(update={"grading": grading, "version": "9.9"})


@pytest.mark.parametrize("has_drives", [False, True], ids=["no drives", "drives"])
@pytest.mark.parametrize("factor", [0.1, 1.0, 1.7, 10.0])
def test_a_regraded_sheet_has_the_bits_of_one_that_is_graded_from_all(
    factor: float, has_drives: bool
) -> None:
    first = packaged_protocol("1.1")
    columns, split = measured(7, has_drives=has_drives), split_of(first, 7)
    settled = settle(PLANNER, columns, split, REF, first)
    kept = Settled.from_columns(settled.columns())
    then = scaled(first, factor)
    regraded = graded_sheet(PLANNER, kept, split, REF, then)
    assert canonical_json(regraded) == canonical_json(
        exact_sheet(PLANNER, columns, split, REF, then)
    )


def test_the_metrics_of_regrading_alone_are_those_among_all_metrics(
    protocol: ProtocolDocument,
) -> None:
    columns, split = measured(8, has_drives=True), split_of(protocol, 8)
    regrading = PLANNER.regrading
    assert regrading is not None
    few = {name: columns[name] for name in regrading.columns}
    alone = regrading.grade(few, split, protocol)
    among_all = PLANNER.grade(columns, split, protocol).only(alone.metrics)
    assert alone.metrics == regrading.metrics
    assert alone.values.tobytes() == among_all.values.tobytes()


def test_other_metrics_read_no_required_clearance(protocol: ProtocolDocument) -> None:
    columns, split = measured(9, has_drives=True), split_of(protocol, 9)
    regrading = PLANNER.regrading
    assert regrading is not None
    others = [metric for metric in PLANNING.metrics if metric not in regrading.metrics]
    a, b = (
        PLANNER.grade(columns, split, each).only(others).values
        for each in (protocol, scaled(protocol, 3.0))
    )
    assert a.tobytes() == b.tobytes()


def test_what_is_kept_holds_nothing_that_a_required_clearance_decided(
    protocol: ProtocolDocument,
) -> None:
    columns, split = measured(10, has_drives=False), split_of(protocol, 10)
    a, b = (
        settle(PLANNER, columns, split, REF, each) for each in (protocol, scaled(protocol, 3.0))
    )
    assert a.means.tobytes() == b.means.tobytes()
    assert a.sheet.plausibility == b.sheet.plausibility
