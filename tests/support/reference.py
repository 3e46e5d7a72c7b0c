"""Planning files whose scores are known: the made extract's by plain loops, the real ones' by golden."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tests.support import extract, naive_scorer, realdata

NAMES = (
    *(f"{extract.NAME}.{planner}" for planner in extract.PLANNERS),
    *(f"{split}.{method}" for split, method in realdata.WITH_REFERENCE),
)
"""Split and submission; those of real planners skip where their files are absent."""
METRICS = naive_scorer.METRICS + naive_scorer.FURTHER

RECORDED = {"nuscenes-real": "recorded-human"}


@dataclass(frozen=True)
class Reference:
    """A split, a file, and the sheet that it must get, to 1e-9."""

    split: Path
    file: Path
    sheet: dict[str, Any]
    recorded: Path | None = None
    """A file whose source trajectories are what was really driven."""

    def check(self, sheet: dict[str, Any]) -> None:
        """Compare every mean of a sheet, given as it is written to JSON."""
        assert sheet["n"] == self.sheet["n"]
        for key in ("micro", "macro_family"):
            means = _means(self.sheet[key])
            assert held_to(sheet[key], means) == pytest.approx(means, abs=1e-9)
        for part in ("families", "tasks"):
            assert sheet[part].keys() == self.sheet[part].keys()
            for name, row in self.sheet[part].items():
                assert sheet[part][name]["n"] == row["n"]
                assert held_to(sheet[part][name], _means(row)) == pytest.approx(
                    _means(row), abs=1e-9
                )


def reference(name: str, folder: Path) -> Reference:
    """Return a case by its name; files that are made are written into the folder."""
    split, method = name.split(".", 1)
    if split == extract.NAME:
        made = _made()
        made.write(folder)
        sheet = naive_scorer.score(made.files[method], made.split)
        return Reference(folder / "split.json.gz", made.path(folder, method), sheet)
    realdata.require()
    golden = json.loads((realdata.GOLDEN / f"{name}.json").read_text("utf-8"))
    further = json.loads((realdata.GOLDEN / f"{name}.protocol-1.1.json").read_text("utf-8"))
    for part in ("micro", "macro_family"):
        golden[part] |= further[part]
    for part in ("families", "tasks"):
        for key, row in golden[part].items():
            row |= further[part][key]
    return Reference(
        realdata.split_path(split),
        realdata.file_path(split, method),
        golden,
        realdata.file_path(split, RECORDED[split]) if split in RECORDED else None,
    )


@cache
def _made() -> extract.Extract:
    return extract.make_extract()


def _means(row: dict[str, Any]) -> dict[str, Any]:
    return {metric: row[metric] for metric in METRICS if metric in row}


def held_to(row: dict[str, Any], reference: dict[str, Any]) -> dict[str, Any]:
    """Return what a reference says something of; another metric may stand beside it."""
    return {key: row[key] for key in reference}
