"""The notebook of the docs, run from its first cell to its last against a real server."""

import ast
from pathlib import Path
from typing import Any

import pytest
from tests.client.notebook import INSTALL, NOTEBOOK, code_of, read_notebook, run_cells
from tests.client.servers import Running

import exceptiondrive


@pytest.fixture
def notebook() -> dict[str, Any]:
    return read_notebook()


def test_no_output_is_committed(notebook: dict[str, Any]) -> None:
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert code
    assert [(cell["outputs"], cell["execution_count"]) for cell in code] == [([], None)] * len(code)


def test_it_imports_from_the_package_what_semver_holds_for(notebook: dict[str, Any]) -> None:
    cells = (ast.parse(cell) for cell in code_of(notebook) if cell != INSTALL)
    nodes = [node for cell in cells for node in ast.walk(cell)]
    sources = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    named = {
        each.name
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module == "exceptiondrive"
        for each in node.names
    }
    assert [each for each in sources if each.startswith("exceptiondrive")] == ["exceptiondrive"]
    assert "plot_file" in named
    assert named <= set(exceptiondrive.__all__)


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
    settings = {
        "EXCEPTIONDRIVE_SERVER": working.url,
        "EXCEPTIONDRIVE_TOKEN": working.token,
        "EXCEPTIONDRIVE_PHASE": "dev",
    }
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), **settings}
    by_end = run_cells(cells, tmp_path, environment)
    assert by_end["len(manifest.sample_ids), manifest.waypoints, manifest.time_step_s"] == (
        "(4, 6, 0.5)"
    )
    assert by_end['Picture("worst.svg")'].startswith("<svg")
    assert "scored" in by_end["view.status, view.rank"]
    assert by_end["view.status, view.rank"].endswith(" 1)")
    board = next(text for end, text in by_end.items() if "leaderboard" in end)
    assert "Brake gently, from a notebook" in board
    assert all(ast.parse(source) for source in cells)
