"""Tables that fit a terminal: ids stay whole, words wrap, what matters least is left out first."""

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

GAP = 2
"""Columns of the terminal between two columns of a table."""
NARROWEST_WORDS = 16
LONGEST_WORD = 24
"""Words may be set as narrow as the longest of them, within these."""
_PIECES = re.compile(r"[^\s-]*-+|[^\s-]+|\s+")
"""A line may end after each: `gemini-2.5-` and `pro`."""
Cell = str | Text


@dataclass(frozen=True)
class Column:
    """A column of a `FittedTable`.

    Attributes:
        title: Its head.
        kind: `id`: never folded and never cut; `number`: the same, to the right; `words` wrap.
        left_out: Where a terminal is too narrow the highest is left out first; 0 always stays.
    """

    title: str
    kind: Literal["id", "number", "words"] = "words"
    left_out: int = 0


@dataclass
class FittedTable:
    """A table without lines that looks at how wide the terminal is.

    Of the columns that may be left out those with nothing in them are, and in a narrow terminal
    others too, which a line below names. Where even the rest is too wide, each row becomes a few
    lines, a value each.
    """

    columns: tuple[Column, ...]
    rows: list[tuple[tuple[Text, ...], str]] = field(default_factory=list)

    @classmethod
    def of(cls, *columns: Column | str) -> "FittedTable":
        """Return an empty table; a bare title is a column of words that always stays."""
        return cls(tuple(Column(each) if isinstance(each, str) else each for each in columns))

    def add_row(self, *cells: Cell, style: str = "") -> None:
        """Add a row, a cell for each column."""
        if len(cells) != len(self.columns):
            raise ValueError(f"{len(cells)} cells for {len(self.columns)} columns")
        row = tuple(Text(cell) if isinstance(cell, str) else cell for cell in cells)
        self.rows.append((row, style))

    def add_gap(self) -> None:
        """Add an empty line."""
        self.rows.append((tuple(Text() for _ in self.columns), ""))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        shown = self.shown(options.max_width)
        least = [self._least_width_of(index) for index in shown]
        spare = options.max_width - sum(least) - GAP * (len(shown) - 1)
        if spare < 0:
            yield from self._one_value_a_line()
            return
        yield self._table(shown, least, spare)
        left_out = [
            column.title
            for index, column in enumerate(self.columns)
            if index not in shown and self._has_values(index)
        ]
        if left_out:
            yield Text(f"wider, or with --json: {', '.join(left_out)}", style="dim")

    @property
    def whole_width(self) -> int:
        """How wide a terminal must be to show everything and fold nothing."""
        shown = self.shown(sys.maxsize)
        return sum(map(self._full_width, shown)) + GAP * (len(shown) - 1)

    def shown(self, width: int) -> list[int]:
        """Return the numbers of the columns that have a place in so wide a terminal."""
        shown = [index for index in range(len(self.columns)) if self._has_values(index)]
        while self._least_width(shown) > width:
            least = max(shown, key=lambda index: (self.columns[index].left_out, index))
            if self.columns[least].left_out == 0:
                break
            shown.remove(least)
        return shown

    def _has_values(self, index: int) -> bool:
        return self.columns[index].left_out == 0 or any(row[index].plain for row, _ in self.rows)

    def _column_texts(self, index: int) -> list[Text]:
        return [Text(self.columns[index].title), *(row[index] for row, _ in self.rows)]

    def _full_width(self, index: int) -> int:
        """Width of a column that folds nothing."""
        return max(text.cell_len for text in self._column_texts(index))

    def _least_width_of(self, index: int) -> int:
        if self.columns[index].kind != "words":
            return self._full_width(index)
        pieces = (
            piece for text in self._column_texts(index) for piece in _PIECES.findall(text.plain)
        )
        longest = max(map(cell_len, pieces), default=0)
        return min(self._full_width(index), max(NARROWEST_WORDS, min(longest, LONGEST_WORD)))

    def _least_width(self, shown: list[int]) -> int:
        return sum(map(self._least_width_of, shown)) + GAP * (len(shown) - 1)

    def _table(self, shown: list[int], least: list[int], spare: int) -> Table:
        wanted = [
            self._full_width(index) - width for index, width in zip(shown, least, strict=True)
        ]
        folded = sum(wanted)
        table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, header_style="bold")
        widths = [
            width + (more if folded <= spare else spare * more // folded)
            for width, more in zip(least, wanted, strict=True)
        ]
        for index, width in zip(shown, widths, strict=True):
            column = self.columns[index]
            table.add_column(
                column.title,
                justify="right" if column.kind == "number" else "left",
                width=width,
                no_wrap=column.kind != "words",
                overflow="fold",
            )
        for row, style in self.rows:
            cells = zip(shown, widths, strict=True)
            table.add_row(*(_folded_text(row[index], width) for index, width in cells), style=style)
        return table

    def _one_value_a_line(self) -> Iterable[RenderableType]:
        told = [each for each in self.rows if any(cell.plain for cell in each[0])]
        for number, (row, style) in enumerate(told):
            if number:
                yield ""
            for column, cell in zip(self.columns, row, strict=True):
                if cell.plain:
                    label = f"{column.title}: " if column.title else ""
                    yield Text.assemble((label, "bold"), cell, style=style)


def _folded_text(text: Text, width: int) -> Text:
    """Break lines at spaces and after hyphens; what is still too long is left to the table."""
    if cell_len(text.plain) <= width:
        return Text(text.plain.strip(), style=text.style)
    lines = [""]
    for piece in _PIECES.findall(text.plain):
        if lines[-1] and cell_len(lines[-1] + piece.rstrip()) > width:
            lines.append("")
        lines[-1] += piece if lines[-1] else piece.lstrip()
    return Text("\n".join(line.rstrip() for line in lines), style=text.style)


@dataclass(frozen=True)
class ByWidth:
    """What is written otherwise in a narrow terminal: `make` gets its columns."""

    make: Callable[[int], Iterable[RenderableType]]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield from self.make(options.max_width)
