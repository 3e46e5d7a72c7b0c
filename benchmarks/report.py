"""Tables on the terminal, and what was asked beside what this run measured."""

from collections.abc import Sequence
from typing import NamedTuple

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


class Target(NamedTuple):
    """What was asked of a figure, and what this run measured."""

    what: str
    measured: str
    asked: str
    is_met: bool


_targets: list[Target] = []


def at_most(what: str, measured: float, asked: float, unit: str) -> None:
    """Note a figure that must not be larger."""
    _note(what, measured, "at most", asked, unit, is_met=measured <= asked)


def at_least(what: str, measured: float, asked: float, unit: str) -> None:
    """Note a figure that must not be smaller."""
    _note(what, measured, "at least", asked, unit, is_met=measured >= asked)


def _note(what: str, measured: float, bound: str, asked: float, unit: str, *, is_met: bool) -> None:
    _targets.append(Target(what, f"{measured:,.3g} {unit}", f"{bound} {asked:,.3g} {unit}", is_met))


def show_targets() -> None:
    """Print all that was noted, in one table."""
    rows = [(what, had, asked, "yes" if is_met else "NO") for what, had, asked, is_met in _targets]
    if rows:
        show("What was asked, and this run", ("", "measured", "asked", "met"), rows)
