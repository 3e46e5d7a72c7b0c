"""Counts over decisions: the funnel, families and tasks, the audit with its intervals, who decided.

All of it follows from the candidates as they stand; nothing here is a region or names a sample.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import NormalDist

from exceptiondrive_build.agreement import outcome
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.inspection import draw
from exceptiondrive_build.records import Kind, Record
from exceptiondrive_build.settings import InspectSection, VerifySection
from exceptiondrive_build.values import Edited, Inspected
from exceptiondrive_schemas.datasheet import Audit, Cell, Decider, Interval, Stage
from exceptiondrive_schemas.taxonomy import Taxonomy

CONFIDENCE = 0.95


def stages(candidates: Iterable[Candidate], limits: VerifySection, n_frozen: int) -> tuple[Stage, ...]:
    """The funnel: how many candidates came through each stage, of those that came to it."""
    everything = list(candidates)
    ways = (
        ("suitable", "Scene suits the task", lambda it: it.is_suitable),
        ("edited", "Edited in every view", lambda it: isinstance(it.edited, Edited)),
        ("reviewed", "Passed the review", lambda it: it.passed_review),
        ("accepted", "Accepted, people's words included", lambda it: it.is_accepted),
        ("localized", "Region proposed", lambda it: it.localized is not None),
        ("verified", "Region verified", lambda it: is_verified(it, limits)),
    )
    found, left = [], everything
    for stage_id, title, came_through in ways:
        # a person may accept what the review did not: acceptance is asked of all that were edited
        entered = [it for it in everything if isinstance(it.edited, Edited)] if stage_id == "accepted" else left
        left = [it for it in entered if came_through(it)]
        found.append(Stage(id=stage_id, title=title, n=len(left), of=len(entered)))
    return (*found, Stage(id="frozen", title="In the split", n=n_frozen, of=len(left)))
