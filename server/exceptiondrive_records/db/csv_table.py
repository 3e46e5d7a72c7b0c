"""Tables as CSV that organizers hand in, however their spreadsheet wrote them."""

import csv
import io
from collections.abc import Iterable

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.printable import first_of

_SHOWN_FAULTS = 20
_SEPARATORS = ",;\t"
"""The last is what stands in the clipboard when cells of a spreadsheet are copied."""


def csv_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the rows that hold something, each with the line on which it begins.

    Empty cells at the end of the first line are no columns, and nor are those below them. Values
    are separated by commas, semicolons or tabs, as the first line tells.

    Raises:
        InvalidRecord: It is no table, or a row has not as many values as the first one.
    """
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
            f"This is no table as CSV: {error}. Save it as CSV; in quoted text write each quote twice."
        ) from None
    return rows


def faults_text(faults: Iterable[tuple[int, str]]) -> str:
    """Say what is wrong on which lines, each sentence once: `Line 2, Line 5: ...`."""
    lines: dict[str, list[str]] = {}
    for number, words in faults:
        lines.setdefault(words, []).append(f"Line {number}")
    told = [f"{first_of(where)}: {words}" for words, where in lines.items()]
    left_out = len(told) - _SHOWN_FAULTS
    return " ".join(told[:_SHOWN_FAULTS]) + (f" And {left_out} more." if left_out > 0 else "")
