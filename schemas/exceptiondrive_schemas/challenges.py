"""The two challenges as data: which file they take, which metrics they give, what ranks.

A challenge differs from its sibling only here, in the scoring package (measure, grade) and in the
submission file's form. Check, upload, jobs, records, rescoring, boards and pages are the same code.
"""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Literal

from exceptiondrive_schemas import formulas
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenge_words import (
    PLANNING_WORDS,
    STRATEGY_WORDS,
    ChallengeWords,
)


class ChallengeId(StrEnum):
    """Identifier of a challenge."""

    PLANNING = "planning"
    STRATEGY = "strategy"


class Metric(Document):
    """One column of a board: what it is called, which way is better, what it may decide."""

    key: str
    label: str
    title: str
    unit: Literal["fraction", "metre"]
    better: Literal["higher", "lower"] | None
    role: Literal["primary", "diagnostic"]
    meaning: str
    formula: str = ""
    """Its equation as MathML; empty where words are enough."""
    part_of: str = ""
    """Key of the metric of which it is a component; it is explained there."""


class RankKey(Document):
    """One key of the rank order."""

    metric: str
    order: Literal["descending", "ascending"]


class Challenge(Document):
    """A challenge: the schema of its submission file, its metrics in column order, its words."""

    id: ChallengeId
    title: str
    file_schema: str
    metrics: tuple[Metric, ...]
    words: ChallengeWords
    has_waypoints: bool = False
    """Whether its files hold as many waypoints as the protocol says."""
    is_ordered_by_protocol: bool = False
    """Whether every protocol must say what ranks it; else `primary_order` does where it does not.
    For a challenge that came after the first protocols were stored, which never change."""
    counterpart: str | None = None
    """What a submission may be linked to, and is then compared with; None: links are refused."""

    @property
    def metric_keys(self) -> tuple[str, ...]:
        """Keys of all metrics, in column order."""
        return tuple(metric.key for metric in self.metrics)

    @property
    def primary_order(self) -> tuple[RankKey, ...]:
        """Primary metrics in column order, the better value first."""
        return tuple(
            RankKey(
                metric=metric.key, order="ascending" if metric.better == "lower" else "descending"
            )
            for metric in self.metrics
            if metric.role == "primary"
        )

    def metric(self, key: str) -> Metric:
        """Return the metric called `key`.

        Raises:
            KeyError: This challenge has no such metric.
        """
        for metric in self.metrics:
            if metric.key == key:
                return metric
        raise KeyError(key)


PLANNING = Challenge(
    id=ChallengeId.PLANNING,
    title="Planning",
    file_schema="exceptiondrive.planning/1",
    words=PLANNING_WORDS,
    is_ordered_by_protocol=True,
    has_waypoints=True,
    metrics=(
        Metric(
            key="hcc",
            label="HCC",
            title="Hazard Clearance Compliance",
            unit="fraction",
            better="higher",
            role="primary",
            meaning="Zero inside the hazard, then grows with clearance until the required "
            "clearance is met.",
            formula=formulas.HCC,
        ),
        Metric(
            key="ur",
            label="UR",
            title="Unsafe Rate",
            unit="fraction",
            better="lower",
            role="primary",
            meaning="Share of samples in which the collision tube touches the hazard region.",
            formula=formulas.UR,
        ),
        Metric(
            key="hpr",
            label="HPR",
            title="Hazard Proximity Response",
            unit="fraction",
            better=None,
            role="diagnostic",
            meaning="Peaks where clearance equals the required clearance; too close and too far "
            "both cost. Not a safety score.",
            formula=formulas.HPR,
        ),
        Metric(
            key="cts",
            label="CTS",
            title="Counterfactual Trajectory Shift",
            unit="metre",
            better=None,
            role="diagnostic",
            meaning="How far the trajectory moved once the hazard appeared. Moving is not the "
            "same as avoiding.",
            formula=formulas.CTS,
        ),
        Metric(
            key="cts_x",
            label="CTSx",
            title="CTS, longitudinal",
            unit="metre",
            better=None,
            role="diagnostic",
            meaning="Longitudinal part of the shift.",
            part_of="cts",
        ),
        Metric(
            key="cts_y",
            label="CTSy",
            title="CTS, lateral",
            unit="metre",
            better=None,
            role="diagnostic",
            meaning="Lateral part of the shift.",
            part_of="cts",
        ),
    ),
)

STRATEGY = Challenge(
    id=ChallengeId.STRATEGY,
    title="Strategy",
    file_schema="exceptiondrive.strategy/1",
    words=STRATEGY_WORDS,
    is_ordered_by_protocol=True,
    counterpart="the same agent without reminder",
    metrics=(
        Metric(
            key="accuracy",
            label="Accuracy",
            title="Strategy accuracy",
            unit="fraction",
            better="higher",
            role="primary",
            meaning="Share of samples whose strategy is in the acceptable set.",
            formula=formulas.ACCURACY,
        ),
        Metric(
            key="under_warning",
            label="Under-warning",
            title="Under-warning rate",
            unit="fraction",
            better="lower",
            role="primary",
            meaning="Wrong, and less cautious than the least cautious acceptable strategy.",
            formula=formulas.UNDER_WARNING,
        ),
        Metric(
            key="over_warning",
            label="Over-warning",
            title="Over-warning rate",
            unit="fraction",
            better=None,
            role="diagnostic",
            meaning="Wrong, but not too little caution.",
        ),
        Metric(
            key="missing",
            label="Missing",
            title="Missing answers",
            unit="fraction",
            better="lower",
            role="diagnostic",
            meaning="No answer given; counted as wrong and under-warning.",
        ),
    ),
)

CHALLENGES: Mapping[ChallengeId, Challenge] = MappingProxyType(
    {challenge.id: challenge for challenge in (PLANNING, STRATEGY)}
)
CHALLENGE_OF_FILE_SCHEMA: Mapping[str, Challenge] = MappingProxyType(
    {challenge.file_schema: challenge for challenge in CHALLENGES.values()}
)
