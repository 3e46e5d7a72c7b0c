"""The table of bad inputs, and which tests prove each row: `python -m tests.hostile.rows` prints it.

A test names its rows by `@pytest.mark.row("I05")`; sources are read for that, nothing is run.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROWS = {
    "I01": "NaN, Infinity, -Infinity, 1e309 in coordinates",
    "I02": "1e308, 1e154, 251 m",
    "I03": "10^400, an integer of 5,000 digits",
    "I04": "wrong number of waypoints, ragged, empty, points in 3-D",
    "I05": "texts, booleans, null as numbers",
    "I06": "duplicate sample id, duplicate JSON key",
    "I07": "missing, extra, unknown samples",
    "I08": "source trajectory missing",
    "I09": "depth 200,000, 10^6 keys, 10^6 samples",
    "I10": "lone surrogate, NUL, bad UTF-8, UTF-16, byte order mark",
    "I11": "right-to-left, zero-width, homoglyph, 10 kB name, emoji",
    "I12": "<script>, javascript: link, =cmd() as a name",
    "I13": "a body of 400 MB: length, chunked, multipart, lying length",
    "I14": "gzip bomb, zip, nested zip, zstd, deflate header",
    "I15": "parquet, pickle, npy, npz, csv sent as JSON",
    "I16": "slowloris with 400 sockets, slow body",
    "I17": "teleport, reverse time, all zeros",
    "I18": "the same file twice, 20 parallel copies",
    "I19": "30 parallel posts at quota 5",
    "I20": "clients sharing a team",
    "I21": "probing: one sample changed many times",
    "I22": "wrong, expired, revoked, truncated token",
    "I23": "a participant calls every organizer route",
    "I24": "read what is another team's",
    "I25": "a form sent from elsewhere with a cookie",
    "I26": "an exception in scoring that holds a canary",
    "I27": "what is shipped holds withheld data",
    "I28": "header injection, ../ in a file name, 64 kB header, smuggling",
    "I29": "a large file of invalid samples",
    "I30": "tampered receipt or score",
    "I31": "generated requests, generated files",
    "I32": "degenerate or self-crossing region",
    "I33": "equal scores",
}


def rows_with_tests(folder: Path = TESTS) -> dict[str, list[str]]:
    """Return the ids of the tests that are marked with each row."""
    found: dict[str, list[str]] = {row: [] for row in ROWS}
    for path in sorted(folder.rglob("test_*.py")):
        text = path.read_text("utf-8")
        for function, rows in _marked(ast.parse(text)) if "pytest.mark.row(" in text else ():
            for row in rows:
                place = path.relative_to(folder).as_posix()
                found.setdefault(row, []).append(f"{place}::{function}")
    return found


def _marked(tree: ast.Module) -> Iterator[tuple[str, list[str]]]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Call) and _is_row(decorator.func):
                    yield node.name, [str(ast.literal_eval(arg)) for arg in decorator.args]


def _is_row(function: ast.expr) -> bool:
    return ast.unparse(function) == "pytest.mark.row"


def table() -> str:
    """Return rows, inputs and tests as a Markdown table."""
    lines = ["| row | input | tests |", "|---|---|---|"]
    for row, places in rows_with_tests().items():
        lines.append(f"| {row} | {ROWS[row]} | {'<br>'.join(f'`{p}`' for p in places)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())  # noqa: T201 - this is what the module is called for
