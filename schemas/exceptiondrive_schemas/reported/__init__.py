"""Rows that papers report, as board entries: marked as reported, never ranked, kept apart."""

import json
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import BoardEntry, FamilyCell
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, ChallengeId
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.python310 import tomllib
from exceptiondrive_schemas.score_sheet import MetricRow

Printed = Annotated[str, Field(pattern=r"^\d+(\.\d+)?$")]
"""A number as printed, trailing zeros included: fractions in per cent, CTS in metres."""


class ReportedRow(Document):
    """One method of one paper."""

    method: str
    table: str
    metrics: dict[str, Printed]
    families: dict[str, Printed] = {}
    """Family id to the first metric of the challenge."""


class ReportedChallenge(Document):
    """What a paper reports on one challenge; without an aggregate it does not say which."""

    aggregate: Average | None = None
    n_samples: int | None = None
    samples: str
    """What was scored, in words; `n_samples` of them, where the paper says how many."""
    protocol: str
    """What scored it, in words."""
    rows: tuple[ReportedRow, ...]


class ReportedPaper(Document):
    """One paper."""

    schema_: Literal["exceptiondrive.reported/1"] = Field(alias="schema")
    cite: str
    team: str
    challenges: dict[str, ReportedChallenge]


@cache
def reported_paper() -> ReportedPaper:
    """Read the ExceptionDrive paper's rows, which ship with this package."""
    path = Path(__file__).with_name("exceptiondrive-paper.toml")
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    return ReportedPaper.model_validate_json(json.dumps(document))


def reported_entries(challenge_id: ChallengeId, headline: Average) -> tuple[BoardEntry, ...]:
    """Return the reported rows of a challenge, in the paper's order.

    Metrics that the paper does not report are None; so are all of them if the headline is not the
    aggregate that the paper prints.
    """
    paper, challenge = reported_paper(), CHALLENGES[challenge_id]
    reported = paper.challenges.get(challenge_id)
    if reported is None:
        return ()
    return tuple(
        _entry(row, paper, reported.aggregate, challenge, headline) for row in reported.rows
    )


def _entry(
    row: ReportedRow,
    paper: ReportedPaper,
    aggregate: Average | None,
    challenge: Challenge,
    headline: Average,
) -> BoardEntry:
    undefined: MetricRow = dict.fromkeys(challenge.metric_keys)
    values = undefined | {key: _value(challenge, key, text) for key, text in row.metrics.items()}
    first = challenge.metric_keys[0]
    families = {
        family: FamilyCell.of(None, {first: _value(challenge, first, text)})
        for family, text in row.families.items()
    }
    return BoardEntry(
        source="reported",
        rank=None,
        rank_interval=None,
        unranked_because="reported in a paper, not scored here",
        submission_id=None,
        method=row.method,
        team=paper.team,
        submitted_at=None,
        metrics=values if aggregate in (None, headline) else undefined,
        micro=values if aggregate == "micro" else undefined,
        macro_family=values if aggregate == "macro_family" else undefined,
        intervals={},
        families=families if aggregate in (None, headline) else {},
        cite=f"{paper.cite}, {row.table}",
    )


def _value(challenge: Challenge, key: str, printed: str) -> float:
    """Return the printed number as the board stores it: per cent become fractions, exactly."""
    number = Decimal(printed)
    return float(number / 100 if challenge.metric(key).unit == "fraction" else number)
