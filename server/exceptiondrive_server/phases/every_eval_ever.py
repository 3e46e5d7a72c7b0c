"""Entries as records of the shared schema *Every Eval Ever*, github.com/evaleval/every_eval_ever.

One record is one entry on one board, with every metric that has a better direction, overall and by
family. `tests/phases/test_export.py` validates them against the schema's own JSON Schema.
"""

import hashlib
import re
from collections.abc import Iterator
from typing import Any
from uuid import UUID

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.method_facts import EntryFacts
from exceptiondrive_schemas.score_sheet import Interval, MetricRow, ScoreSheet
from exceptiondrive_server.boards.entry_facts import challenge_of
from exceptiondrive_server.web.numbers import iso

SCHEMA_VERSION = "0.3.0"
COLLECTION = "exceptiondrive"
_AVAILABLE = {"yes": "open_weights", "no": "closed_weights", None: "unknown"}
_UNITS = {"fraction": "proportion", "metre": "metres"}


def record_path(record: dict[str, Any]) -> str:
    """Return where the shared store keeps a record: by developer and model, under a UUID of its id."""
    digest = hashlib.sha256(record["evaluation_id"].encode()).digest()
    developer, model = record["model_info"]["id"].split("/")
    return f"data/{COLLECTION}/{developer}/{model}/{UUID(bytes=digest[:16], version=4)}.json"


def record_of(
    board: Board, entry: BoardEntry, sheet: ScoreSheet, told: EntryFacts, site_url: str
) -> dict[str, Any]:
    """Return a scored entry as a record; the same board gives the same record."""
    model = f"{_portable(entry.team)}/{_portable(entry.method)}"
    address = f"{site_url}/entries/{entry.submission_id}?phase={board.phase}&board={board.board}"
    return {
        "schema_version": SCHEMA_VERSION,
        "evaluation_id": (
            f"{COLLECTION}.{board.phase}/{entry.submission_id}/"
            f"{board.protocol.digest}/{board.split.revision}"
        ),
        "evaluation_timestamp": iso(entry.submitted_at or board.published_at),
        "retrieved_timestamp": str(int(board.published_at.timestamp())),
        "source_metadata": {
            "source_name": "ExceptionDrive leaderboard",
            "source_type": "evaluation_run",
            "source_organization_name": "ExceptionDrive",
            "source_organization_url": site_url,
            "evaluator_relationship": "third_party",
            "additional_details": {
                "entry": address,
                "board": str(board.board),
                "rank": "none" if entry.rank is None else str(entry.rank),
                "flags": " ".join(flag.code for flag in entry.flags),
            },
        },
        "eval_library": {
            "name": "exceptiondrive",
            "version": sheet.scorer_version,
            "additional_details": {
                "protocol": board.protocol.version,
                "protocol_digest": board.protocol.digest,
                "average": board.headline,
            },
        },
        "model_info": {
            "name": entry.method,
            "id": model,
            "developer": entry.team,
            "additional_details": {
                "deployment_type": "unknown",
                "model_availability": _AVAILABLE[told.facts.open_weights],
            },
        },
        "evaluation_results": list(_results(board, entry, site_url)),
    }


def _results(board: Board, entry: BoardEntry, site_url: str) -> Iterator[dict[str, Any]]:
    overall = f"{COLLECTION}.{board.phase}"
    yield from _scores(board, overall, entry.metrics, entry.intervals, board.n_samples, site_url)
    for family, cell in entry.families.items():
        name = f"{overall}.{family}"
        yield from _scores(board, name, cell.metrics, cell.intervals, cell.n, site_url)


def _scores(
    board: Board,
    name: str,
    values: MetricRow,
    intervals: dict[str, Interval | None],
    n: int | None,
    site_url: str,
) -> Iterator[dict[str, Any]]:
    for metric in challenge_of(board).metrics:
        value = values.get(metric.key)
        if value is None or metric.better is None:
            continue
        uncertainty: dict[str, Any] = {} if n is None else {"num_samples": n}
        ends = intervals.get(metric.key)
        if ends is not None:
            uncertainty["confidence_interval"] = {
                "lower": ends[0],
                "upper": ends[1],
                "confidence_level": board.confidence,
                "method": board.interval_method,
            }
        yield {
            "evaluation_result_id": f"{name}.{metric.key}",
            "evaluation_name": name,
            "source_data": {
                "dataset_name": f"{COLLECTION}: {board.split.name}",
                "source_type": "url",
                "url": [f"{site_url}/splits/{board.split.name}"],
                "additional_details": {
                    "revision": board.split.revision,
                    "part": board.part or "all",
                },
            },
            "metric_config": _config(metric),
            "score_details": {"score": value, "uncertainty": uncertainty},
        }


def _config(metric: Metric) -> dict[str, Any]:
    return {
        "evaluation_description": metric.meaning,
        "metric_id": f"{COLLECTION}.{metric.key}",
        "metric_name": metric.title,
        "metric_unit": _UNITS[metric.unit],
        "lower_is_better": metric.better == "lower",
        "score_type": "continuous",
        "min_score": 0.0,
        "max_score": 1.0 if metric.unit == "fraction" else "Infinity",
    }


def _portable(name: str) -> str:
    """A name as a part of a path on any system."""
    return re.sub(r"[^\w.-]+", "-", name, flags=re.ASCII).strip("-.") or "unnamed"
