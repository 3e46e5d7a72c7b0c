"""Tables on the terminal, and as Markdown for docs/performance.md."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

CONSOLE = Console(width=120)


def show(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print one table; all columns but the first are numbers."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for index, name in enumerate(head):
        table.add_column(name, justify="left" if index == 0 else "right")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    CONSOLE.print(table)


def note(text: str) -> None:
    """Print one line under a table."""
    CONSOLE.print(text, style="dim")


def ms(seconds: float) -> str:
    """Milliseconds with three digits."""
    return f"{seconds * 1e3:,.3g}" if seconds < 0.1 else f"{seconds * 1e3:,.0f}"


def times(factor: float) -> str:
    """A factor, `12.3x`."""
    return f"{factor:,.0f}x" if factor >= 10 else f"{factor:.2f}x"
