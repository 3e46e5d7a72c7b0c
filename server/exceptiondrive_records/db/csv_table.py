"""Tables as CSV that organizers hand in, however their spreadsheet wrote them."""

import csv
import io

from exceptiondrive_records.db.errors import InvalidRecord


def csv_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the rows that hold something, each with the line on which it begins.

    Args:
        text: Its values are separated by commas or by semicolons, as the first line tells.

    Raises:
        InvalidRecord: It is no table.
    """
    text = text.removeprefix("\ufeff")
    head = text.split("\n", 1)[0]
    separator = ";" if head.count(";") > head.count(",") else ","
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows, line = [], 1
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        raise InvalidRecord(f"This is no table as CSV: {error}.") from None
    return rows
