"""Family cells: the first primary metric by family, as heat with its value and n in words."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.boards.scales import nice_scale
from exceptiondrive_server.web.numbers import Digits, grouped

HEAT_STEPS = 10
SMALL_FAMILY = 30


@dataclass(frozen=True)
class HeatScale:
    """Ten steps of heat from 0 to a round maximum over all entries of a board."""

    metric: Metric
    top: float
    best: dict[str, float]

    @classmethod
    def of(cls, board: Board, metric: Metric) -> "HeatScale":
        """Return the scale that holds every scored and reported family cell."""
        values = [
            value
            for entry in board.entries
            if entry.source != "reference"
            for cell in entry.families.values()
            if (value := cell.metrics.get(metric.key)) is not None
        ]
        top = nice_scale(values, (0, 1), n_ticks=6, include=(0.0, 0.05), ceiling=1.0).domain[1]
        return cls(metric, top, best_by_family(board, metric))

    def step(self, value: float) -> int:
        """Return the heat step of a value, 0 to 9; for a lower-is-better metric it is reversed."""
        share = min(max(value / self.top, 0.0), 1.0)
        step = min(int(share * HEAT_STEPS), HEAT_STEPS - 1)
        return HEAT_STEPS - 1 - step if self.metric.better == "lower" else step


@dataclass(frozen=True)
class FamilyTile:
    """One family of one entry; `text` is None where it is unknown."""

    family: str
    title: str
    short: str
    n: int | None
    n_text: str
    text: str | None
    step: int | None
    is_best: bool
    is_small: bool
    interval: str | None
    words: str


_SHORT = {
    "and gap conflict": "and gap",
    "and rule conflict": "and rule",
    "conflict": "",
    "hazard": "",
}


def short_title(title: str) -> str:
    """Return a family title for a narrow column: `Road-Surface Hazard` -> `Road-surface`."""
    words = title.capitalize()
    for ending, replacement in _SHORT.items():
        if words.endswith(f" {ending}"):
            return words.removesuffix(ending).strip() + (f" {replacement}" if replacement else "")
    return words


def family_tiles(
    entry: BoardEntry, board: Board, heat: HeatScale, digits: Digits
) -> tuple[FamilyTile, ...]:
    """Return one tile per family of the board, in its order; empty if the entry has none."""
    if not entry.families:
        return ()
    return tuple(_tile(entry, head.id, head.title, heat, digits) for head in board.families)


def best_by_family(board: Board, metric: Metric) -> dict[str, float]:
    """Return the best value of a metric in each family, among ranked entries."""
    best: dict[str, float] = {}
    for entry in board.entries:
        if entry.rank is None:
            continue
        for family, cell in entry.families.items():
            value = cell.metrics.get(metric.key)
            if value is None:
                continue
            known = best.get(family, value)
            best[family] = min(known, value) if metric.better == "lower" else max(known, value)
    return best


def _tile(
    entry: BoardEntry, family: str, title: str, heat: HeatScale, digits: Digits
) -> FamilyTile:
    cell = entry.families.get(family)
    value = cell.metrics.get(heat.metric.key) if cell else None
    n = cell.n if cell else None
    text = digits.text(heat.metric, value)
    interval = cell.intervals.get(heat.metric.key) if cell else None
    span = (
        f"{digits.text(heat.metric, interval[0])} to {digits.text(heat.metric, interval[1])}"
        if interval
        else None
    )
    n_text = "n not reported" if n is None else f"n = {grouped(n)}"
    return FamilyTile(
        family=family,
        title=title,
        short=short_title(title),
        n=n,
        n_text=n_text,
        text=text,
        step=None if value is None else heat.step(value),
        is_best=entry.rank is not None and value is not None and value == heat.best.get(family),
        is_small=n is not None and n < SMALL_FAMILY,
        interval=span,
        words=_words(title, text, n_text),
    )


def _words(title: str, text: str | None, n_text: str) -> str:
    return f"{title}: not reported" if text is None else f"{title} {text} %, {n_text}"
