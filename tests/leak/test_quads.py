"""Regions are read from published sheets: many at once by usual settings, a few by advised ones."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from tests.leak.quads import Attack, quads

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

N_UPLOADS = 8
"""As many days with the advised quota of one a day."""


def test_eight_uploads_read_several_regions_at_once_by_usual_settings(oracle: "Oracle") -> None:
    first = np.unique(oracle.split.arrays.task_index, return_index=True)[1]
    attack = Attack(replace(oracle, protocol=packaged_protocol("1.1")), first[:8].tolist())
    for _ in range(N_UPLOADS):
        attack.upload()
    assert sum(iou > 0.3 for iou, _ in attack.found()) >= 3


def test_eight_uploads_read_one_region_by_advised_settings(oracle: "Oracle") -> None:
    """Nothing else is answered, so that the totals are those of one sample."""
    advised = replace(oracle, protocol=packaged_protocol(NEWEST_WITHHELD))
    first = np.unique(oracle.split.arrays.task_index, return_index=True)[1]
    attack = Attack(advised, first[1:2].tolist())
    for _ in range(N_UPLOADS):
        attack.upload()
    assert attack.found()[0][0] > 0.3


def test_who_knows_other_regions_of_the_task_reads_one_with_four_uploads(oracle: "Oracle") -> None:
    advised = replace(oracle, protocol=packaged_protocol(NEWEST_WITHHELD))
    first = np.unique(oracle.split.arrays.task_index, return_index=True)[1]
    attack = Attack(advised, first[1:2].tolist(), known="regions and path")
    regions = quads(attack.victims[0].foreseen[0])
    true: Any = shapely.Polygon(oracle.split.arrays.regions_m[first[1]])
    alike = shapely.area(shapely.intersection(regions, true))
    assert max(alike / shapely.area(shapely.union(regions, true))) < 0.5, "what is known is not it"
    for _ in range(N_UPLOADS // 2):
        attack.upload()
    assert attack.found()[0][0] > 0.5


def test_two_regions_are_read_at_once_by_advised_settings(oracle: "Oracle") -> None:
    """The two totals weigh a sample of 80 and one of 60 otherwise."""
    advised = replace(oracle, protocol=packaged_protocol(NEWEST_WITHHELD))
    first = np.unique(oracle.split.arrays.task_index, return_index=True)[1]
    attack = Attack(advised, [int(first[5]), int(first[17])])
    for _ in range(N_UPLOADS):
        attack.upload()
    assert min(iou for iou, _ in attack.found()) > 0.3
