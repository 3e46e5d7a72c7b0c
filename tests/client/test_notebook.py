"""The notebook of the docs, run from its first cell to its last against a real server."""

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.client.servers import Running

NOTEBOOK = Path(__file__).parents[2] / "docs/notebooks/first_entry.ipynb"
INSTALL = '%pip install --quiet "exceptiondrive[evaluate,data]"'
RUN = """
import ast, json, sys
names, shown = {"__name__": "__main__"}, []
for source in json.load(open(sys.argv[1], encoding="utf-8")):
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    forms = [getattr(value, form) for form in ("_repr_svg_", "_repr_html_") if hasattr(value, form)]
    shown.append(forms[0]() if forms else repr(value))
json.dump(shown, open(sys.argv[2], "w", encoding="utf-8"))
"""
"""What a kernel does with the cells: the last expression of each is shown, in its richest form."""


@pytest.fixture
def notebook() -> dict[str, Any]:
    document: dict[str, Any] = json.loads(NOTEBOOK.read_text("utf-8"))
    return document


def code_of(notebook: dict[str, Any]) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_no_output_is_committed(notebook: dict[str, Any]) -> None:
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert code
    assert [(cell["outputs"], cell["execution_count"]) for cell in code] == [([], None)] * len(code)


def test_its_planner_is_another_than_that_of_the_quick_start(notebook: dict[str, Any]) -> None:
    """Who comes from there sends other bytes: the same ones under another name would be refused."""
    (slower,) = (
        line
        for cell in code_of(notebook)
        for line in cell.splitlines()
        if line.startswith("SLOWER = ")
    )
    quick_start = NOTEBOOK.parents[1] / "quickstart.md"
    assert "\nSLOWER = " in quick_start.read_text("utf-8")
    assert slower not in quick_start.read_text("utf-8")


def test_it_runs_from_check_to_rank(
    notebook: dict[str, Any], working: Running, tmp_path: Path
) -> None:
    install, *cells = code_of(notebook)
    assert install == INSTALL
    (tmp_path / "cells.json").write_text(json.dumps(cells), encoding="utf-8")
    settings = {
        "EXCEPTIONDRIVE_SERVER": working.url,
        "EXCEPTIONDRIVE_TOKEN": working.token,
        "EXCEPTIONDRIVE_PHASE": "dev",
    }
    done = subprocess.run(
        [sys.executable, "-c", RUN, "cells.json", "shown.json"],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), **settings},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    shown = dict(zip(cells, json.loads((tmp_path / "shown.json").read_text("utf-8")), strict=True))
    by_end = {source.splitlines()[-1]: text for source, text in shown.items()}
    assert by_end["len(manifest.sample_ids), manifest.waypoints, manifest.time_step_s"] == (
        "(4, 6, 0.5)"
    )
    assert by_end['Picture("worst.svg")'].startswith("<svg")
    assert "scored" in by_end["view.status, view.rank"]
    assert by_end["view.status, view.rank"].endswith(" 1)")
    board = next(text for end, text in by_end.items() if "leaderboard" in end)
    assert "Brake gently, from a notebook" in board
    assert all(ast.parse(source) for source in cells)
