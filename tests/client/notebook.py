"""The notebook of the docs, and what a kernel does with it."""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[2] / "docs/notebooks/first_entry.ipynb"
INSTALL = (
    "# The page /client/ of your server has the address.\n"
    '%pip install --quiet "exceptiondrive[evaluate,data] @ https://SERVER/client/..."'
)
"""By the address: what an index has under the name alone may be another's."""
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
"""The last expression of each cell is shown, in its richest form."""


def read_notebook() -> dict[str, Any]:
    """Return the notebook as it is committed."""
    document: dict[str, Any] = json.loads(NOTEBOOK.read_text("utf-8"))
    return document


def code_of(notebook: Mapping[str, Any]) -> list[str]:
    """Return its cells of code."""
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_cells(cells: Sequence[str], folder: Path, environment: Mapping[str, str]) -> dict[str, str]:
    """Run cells in a process of their own; return what each showed, by its last line."""
    (folder / "cells.json").write_text(json.dumps(cells), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", RUN, "cells.json", "shown.json"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    shown = json.loads((folder / "shown.json").read_text("utf-8"))
    return {cell.splitlines()[-1]: text for cell, text in zip(cells, shown, strict=True)}
