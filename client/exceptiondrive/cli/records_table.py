"""Records of the API as a table."""

from typing import Any

from exceptiondrive.cli.output import show, show_json


def show_records(records: list[dict[str, Any]], columns: tuple[str, ...], json: bool) -> None:
    """Write records as a table of these columns, or as JSON."""
    from rich.table import Table

    if json:
        show_json(records)
        return
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for column in columns:
        table.add_column(column.replace("_", " "), overflow="fold")
    for record in records:
        table.add_row(*(_text(record[column]) for column in columns))
    show(table)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else str(value)
