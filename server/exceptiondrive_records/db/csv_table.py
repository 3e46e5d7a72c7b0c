"""Read CSV tables from organizers in any of the dialects that spreadsheets write."""

import csv
import io
from collections.abc import Iterable

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.printable import first_of

_SHOWN_FAULTS = 20
_SEPARATORS = ",;\t"
"""Cells copied from a spreadsheet are separated by tabs."""


def named_rows(text: str, *, most: int) -> list[tuple[int, dict[str, str]]]:
    """Return the rows below the header, each as its first line number and its values by column.

    The header decides whether commas, semicolons or tabs separate values; column names are
    case-insensitive.

    Raises:
        InvalidRecord: It is no table, names a column twice, or has no or more than `most` rows.
    """
    (_, head), *rows = _rows(text) or [(1, [])]
    names = [name.strip().lower() for name in head]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InvalidRecord(f"The first line names the column {min(twice)} twice.")
    if not rows:
        raise InvalidRecord("There are no rows: write one per line below the column names.")
    if len(rows) > most:
        raise InvalidRecord(f"There are more than {most} rows; import them in parts.")
    return [(line, dict(zip(names, map(str.strip, row), strict=True))) for line, row in rows]


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """Return non-empty rows, without empty cells to the right of the last column name."""
    text = text.removeprefix("\ufeff")
    head = text.lstrip("\r\n").split("\n", 1)[0]
    separator = max(_SEPARATORS, key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows: list[tuple[int, list[str]]] = []
    line, n_columns = 1, 0
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                while len(cells) > n_columns and not cells[-1].strip():
                    cells.pop()
                n_columns = n_columns or len(cells)
                if len(cells) != n_columns:
                    raise InvalidRecord(
                        f"Line {line} has {len(cells)} values, not {n_columns} as line {rows[0][0]}: "
                        "put text that holds the separator in quotes."
                    )
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise InvalidRecord(
            f"This is not a CSV table: {error}. Save it as CSV; in quoted text write each quote twice."
        ) from None
    return rows


def faults_text(faults: Iterable[tuple[int, str]]) -> str:
    """Join faults of lines into one text, without repeated sentences: `Line 2, Line 5: ...`."""
    lines: dict[str, list[str]] = {}
    for number, words in faults:
        lines.setdefault(words, []).append(f"Line {number}")
    told = [f"{first_of(where)}: {words}" for words, where in lines.items()]
    left_out = len(told) - _SHOWN_FAULTS
    return " ".join(told[:_SHOWN_FAULTS]) + (f" And {left_out} more." if left_out > 0 else "")
