"""The planning scores as docs/protocol.md words them: plain loops and shapely, and nothing of ours.

Slow and short, so that it can be read beside the formulas. It imports no package of this project;
even the numbers of the protocol are read from the TOML by itself.
"""

import gzip
import json
import math
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

from shapely.geometry import LineString, MultiPoint, Polygon
from shapely.geometry import Point as ShapelyPoint
from shapely.ops import unary_union

from exceptiondrive_schemas.python310 import tomllib

ROOT = Path(__file__).parents[2]
PROTOCOL_FILE = ROOT / "schemas" / "exceptiondrive_schemas" / "protocols" / "1.0.toml"
METRICS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
OUTCOMES = ("clear", "close", "hit_reacting", "hit_unmoved")
SOURCE_L2 = {"source_l2_1s_m": 1.0, "source_l2_2s_m": 2.0, "source_l2_3s_m": 3.0}
FURTHER = (*OUTCOMES, "progress", "source_l2_m", *SOURCE_L2)
"""What docs/protocol.md section 9 adds."""
REACTION_SHIFT_M, LEAST_PATH_M, HELD_BACK_BELOW = 0.5, 2.0, 0.5
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
    samples = [each for each in split["samples"] if _counts(each)]
    by_family: dict[str, list[Row]] = {}
    by_task: dict[str, list[Row]] = {}
    for sample in samples:
        task = tasks[sample["task"]]
        d_safe_m = sample.get("d_safe_m", task["d_safe_m"])
        row = _sample(answers[sample["sample_id"]], sample, d_safe_m, protocol)
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
        "micro": _means(every) | _over_caution(split, answers),
        "macro_family": _means(list(families.values())),
        "families": {key: {"n": len(by_family[key]), **row} for key, row in families.items()},
        "tasks": {key: {"n": len(rows), **_means(rows)} for key, rows in by_task.items()},
    }


def clearance_m(answer: Any, region: Any) -> float | None:
    """Return the clearance of a sample; None where it is in the hazard or without an answer."""
    geometry = tomllib.loads(PROTOCOL_FILE.read_text("utf-8"))["geometry"]
    if answer["edited"] is None:
        return None
    clear_m = _clearance_m([(0.0, 0.0), *answer["edited"]], region, geometry)
    return clear_m if clear_m > geometry["contact_tolerance_m"] else None


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


def _counts(sample: Any) -> bool:
    return not sample.get("control") and sample.get("withdrawn") is None


def _over_caution(split: dict[str, Any], answers: Any) -> Row:
    """Share of the controls with progress below one half, where there are controls."""
    controls = [s for s in split["samples"] if s.get("control") and s.get("withdrawn") is None]
    if not controls:
        return {}
    found = [_progress(answers[sample["sample_id"]]) for sample in controls]
    defined = [share for share in found if share is not None]
    return {"over_caution": fmean(s < HELD_BACK_BELOW for s in defined) if defined else None}


def _sample(answer: Any, sample: Any, d_safe_m: float, protocol: Any) -> Row:
    geometry = protocol["geometry"]
    row: Row = dict.fromkeys(METRICS + FURTHER)
    row |= {"hcc": 0.0, "ur": 1.0, "hpr": 0.0}  # a missing answer drives into the hazard
    outcome = "hit"
    if answer["edited"] is not None:
        clear_m = _clearance_m([(0.0, 0.0), *answer["edited"]], sample["region"], geometry)
        if clear_m > geometry["contact_tolerance_m"]:
            hpr = d_safe_m / (abs(clear_m - d_safe_m) + d_safe_m)
            row |= {"hcc": min(clear_m / d_safe_m, 1.0), "ur": 0.0, "hpr": hpr}
            outcome = "clear" if clear_m >= d_safe_m else "close"
    if answer["edited"] is not None and answer["source"] is not None:
        pairs = [(0.0, 0.0, 0.0, 0.0)] + [
            (*one, *other) for one, other in zip(answer["source"], answer["edited"], strict=True)
        ]
        row["cts"] = fmean(math.hypot(x1 - x0, y1 - y0) for x0, y0, x1, y1 in pairs)
        row["cts_x"] = fmean(abs(x1 - x0) for x0, _, x1, _ in pairs)
        row["cts_y"] = fmean(abs(y1 - y0) for _, y0, _, y1 in pairs)
    if outcome == "hit":
        outcome = "hit_reacting" if (row["cts"] or 0.0) >= REACTION_SHIFT_M else "hit_unmoved"
    row |= {each: float(each == outcome) for each in OUTCOMES}
    row["progress"] = _progress(answer)
    if answer["source"] is not None and sample.get("recorded") is not None:
        gaps = [math.dist(*pair) for pair in zip(answer["source"], sample["recorded"], strict=True)]
        row["source_l2_m"] = fmean(gaps)
        for key, time_s in SOURCE_L2.items():
            row[key] = gaps[round(time_s / geometry["time_step_s"]) - 1]
    return row


def _progress(answer: Any) -> float | None:
    """How far along its own source path the edited trajectory ends."""
    if answer["source"] is None:
        return None
    path = LineString([(0.0, 0.0), *answer["source"]])
    if path.length < LEAST_PATH_M:
        return None
    if answer["edited"] is None:
        return 0.0
    return float(path.project(ShapelyPoint(answer["edited"][-1])) / path.length)


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
    for metric in METRICS + FURTHER:
        defined = [value for row in rows if (value := row[metric]) is not None]
        means[metric] = fmean(defined) if defined else None
    return means
