"""The planning scores as docs/protocol.md words them: plain loops and shapely, and nothing of ours.

Slow and short, so that it can be read beside the formulas. It imports no package of this project;
even the numbers of the protocol are read from the TOML by itself.
"""

import gzip
import json
import math
import tomllib
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

from shapely.geometry import MultiPoint, Polygon
from shapely.ops import unary_union

ROOT = Path(__file__).parents[2]
PROTOCOL_FILE = ROOT / "schemas" / "exceptiondrive_schemas" / "protocols" / "1.0.toml"
METRICS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
Point = tuple[float, float]
Row = dict[str, float | None]
Sheet = dict[str, Any]


def read(content: bytes) -> Any:
    """Read a file, packed or not."""
    return json.loads(gzip.decompress(content) if content[:2] == b"\x1f\x8b" else content)


def score(file: bytes, split: dict[str, Any]) -> Sheet:
    """Score a planning file on a split, with nothing rounded."""
    protocol = tomllib.loads(PROTOCOL_FILE.read_text("utf-8"))
    tasks = {task["id"]: task for task in protocol["tasks"]}
    answers = {answer["sample_id"]: answer for answer in read(file)["predictions"]}
    samples = split["samples"]
    by_family: dict[str, list[Row]] = {}
    by_task: dict[str, list[Row]] = {}
    for sample in samples:
        task = tasks[sample["task"]]
        d_safe_m = sample.get("d_safe_m", task["d_safe_m"])
        row = _sample(answers[sample["sample_id"]], sample["region"], d_safe_m, protocol)
        by_family.setdefault(task["family"], []).append(row)
        by_task.setdefault(task["id"], []).append(row)
    families = {key: _means(rows) for key, rows in by_family.items()}
    every = [row for rows in by_task.values() for row in rows]
    given = {
        key: fmean(answers[sample["sample_id"]][key] is not None for sample in samples)
        for key in ("edited", "source")
    }
    return {
        "n": len(samples),
        "coverage": given,
        "micro": _means(every),
        "macro_family": _means(list(families.values())),
        "families": {key: {"n": len(by_family[key]), **row} for key, row in families.items()},
        "tasks": {key: {"n": len(rows), **_means(rows)} for key, rows in by_task.items()},
    }


def ranked(sheets: dict[str, Sheet], published: dict[str, Row]) -> dict[str, int | None]:
    """Rank planners by published HCC, then UR; None where too little is covered."""
    able = [
        key
        for key, sheet in sheets.items()
        if min(share for share in sheet["coverage"].values()) >= 0.99
    ]
    place = {key: (-(published[key]["hcc"] or 0), published[key]["ur"] or 0) for key in able}
    return {
        key: 1 + sum(place[other] < place[key] for other in able) if key in able else None
        for key in sheets
    }


def _sample(answer: Any, region: Any, d_safe_m: float, protocol: Any) -> Row:
    geometry = protocol["geometry"]
    row: Row = dict.fromkeys(METRICS)
    row |= {"hcc": 0.0, "ur": 1.0, "hpr": 0.0}  # a missing answer drives into the hazard
    if answer["edited"] is not None:
        clear_m = _clearance_m([(0.0, 0.0), *answer["edited"]], region, geometry)
        if clear_m > geometry["contact_tolerance_m"]:
            hpr = d_safe_m / (abs(clear_m - d_safe_m) + d_safe_m)
            row |= {"hcc": min(clear_m / d_safe_m, 1.0), "ur": 0.0, "hpr": hpr}
    if answer["edited"] is not None and answer["source"] is not None:
        pairs = [(0.0, 0.0, 0.0, 0.0)] + [
            (*one, *other) for one, other in zip(answer["source"], answer["edited"], strict=True)
        ]
        row["cts"] = fmean(math.hypot(x1 - x0, y1 - y0) for x0, y0, x1, y1 in pairs)
        row["cts_x"] = fmean(abs(x1 - x0) for x0, _, x1, _ in pairs)
        row["cts_y"] = fmean(abs(y1 - y0) for _, y0, _, y1 in pairs)
    return row


def _clearance_m(points: list[Point], region: Any, geometry: Any) -> float:
    headings = _headings_rad(points, geometry)
    boxes = [_footprint(x, y, h, geometry) for (x, y), h in zip(points, headings, strict=True)]
    tube = unary_union([MultiPoint(one + two).convex_hull for one, two in pairwise(boxes)])
    return float(tube.distance(Polygon(region)))


def _headings_rad(points: list[Point], geometry: Any) -> list[float]:
    headings = [0.0]
    keeps_m = geometry["heading_hold_m"] + geometry["heading_hold_tolerance_m"]
    for (x0, y0), (x1, y1) in pairwise(points):
        if math.hypot(x1 - x0, y1 - y0) <= keeps_m:
            headings.append(headings[-1])
            continue
        angle = math.atan2(y1 - y0, x1 - x0)
        off = (angle - headings[-1] + math.pi) % (2 * math.pi) - math.pi
        if abs(off) > math.radians(geometry["reverse_above_deg"]) + 1e-9:
            angle += math.pi
        headings.append(math.remainder(angle, 2 * math.pi))
    return headings


def _footprint(x: float, y: float, heading_rad: float, geometry: Any) -> list[Point]:
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    centre, half = geometry["footprint_centre_ahead_m"], geometry["footprint_length_m"] / 2
    side = geometry["footprint_width_m"] / 2
    return [
        (x + ahead * cos - left * sin, y + ahead * sin + left * cos)
        for ahead in (centre - half, centre + half)
        for left in (-side, side)
    ]


def _means(rows: list[Row]) -> Row:
    """Return the mean of each metric over the rows that define it."""
    means: Row = {}
    for metric in METRICS:
        defined = [value for row in rows if (value := row[metric]) is not None]
        means[metric] = fmean(defined) if defined else None
    return means
