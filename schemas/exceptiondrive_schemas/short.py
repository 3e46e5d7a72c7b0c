"""Short forms of documents for a prompt, and tables for a notebook."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from pydantic import BaseModel

LONGEST_TEXT = 40
MOST_ROWS = 60
Cells = dict[str, str]


def short(value: Any) -> str:
    """Return a value on one line: long texts are cut, large collections counted."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, BaseModel):
        return f"<{type(value).__name__}>"
    if isinstance(value, list | tuple | Mapping) and value:
        return f"<{len(value):,}>"
    text = str(value)
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 3]}..."


def html(document: BaseModel) -> str:
    """Return a document as tables: its own values, then a table for each nested list or object."""
    parts = [
        _table([{"": name, type(document).__name__: short(value)} for name, value in document])
    ]
    for name, value in document:
        rows = list(_rows(value))
        if rows:
            parts.append(f"<h4>{escape(name)}</h4>{_table(rows[:MOST_ROWS])}")
            if len(rows) > MOST_ROWS:
                parts.append(f"<p>... and {len(rows) - MOST_ROWS:,} more</p>")
    return "".join(parts)


def _rows(value: Any) -> Iterator[Cells]:
    listed = value if isinstance(value, list | tuple) else ()
    named = value.items() if isinstance(value, Mapping) else (("", each) for each in listed)
    for name, each in named:
        if isinstance(each, BaseModel):
            yield {**({"": str(name)} if name else {}), **_cells(each)}


def _cells(document: BaseModel) -> Cells:
    """Return the values of a row; numbers of a nested object become columns of their own."""
    cells: Cells = {}
    for name, value in document:
        if isinstance(value, Mapping) and all(isinstance(each, float) for each in value.values()):
            cells |= {key: short(each) for key, each in value.items()}
        else:
            cells[name] = "" if value is None else short(value)
    return cells


def _table(rows: list[Cells]) -> str:
    heads = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    lines = ("".join(f"<td>{escape(row.get(name, ''))}</td>" for name in heads) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
