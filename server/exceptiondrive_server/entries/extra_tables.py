"""Further tables of an entry: sensitivity, confusion, what else a sheet names, a reminder's effect."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry, PairedDifference
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import MetricRow, ScoreSheet
from exceptiondrive_server.boards.entry_facts import challenge_of, primary_metrics
from exceptiondrive_server.web.numbers import Digits, fixed, unit_of

CONFUSION, SENSITIVITY, REMINDER = "confusion_", "d_safe_x", "reminder"
_REMINDER_WORDS = {
    "given": "samples with a reminder record",
    "presence_precision": "hazard presence, precision",
    "presence_recall": "hazard presence, recall",
    "type_task_accuracy": "hazard type right, the task",
    "type_family_accuracy": "hazard type right, the family",
    "strategy_accuracy": "recommended strategy acceptable",
}


@dataclass(frozen=True)
class ExtraTable:
    """Named rows of the score sheet, and what they mean."""

    title: str
    heads: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]
    note: str = ""


def extra_tables(sheet: ScoreSheet, protocol: Protocol, digits: Digits) -> tuple[ExtraTable, ...]:
    """Return a table of each kind of row that the sheet has."""
    kinds = (CONFUSION, SENSITIVITY, REMINDER)
    others = {key: row for key, row in sheet.extra.items() if not key.startswith(kinds)}
    tables = (
        _sensitivity(sheet, _of_kind(sheet, SENSITIVITY), protocol, digits),
        _confusion(_of_kind(sheet, CONFUSION)),
        _reminder(sheet.extra.get(REMINDER, {}), digits),
        _plain("Further rows", others),
    )
    return tuple(table for table in tables if table.lines)


def _of_kind(sheet: ScoreSheet, kind: str) -> dict[str, MetricRow]:
    return {k.removeprefix(kind): row for k, row in sheet.extra.items() if k.startswith(kind)}


def _sensitivity(
    sheet: ScoreSheet, rows: dict[str, MetricRow], protocol: Protocol, digits: Digits
) -> ExtraTable:
    """HCC with other required clearances, the one that ranks among them, from small to large."""
    by_factor = {float(factor): row for factor, row in rows.items()}
    if rows:
        macro, micro = sheet.macro_family.get("hcc"), sheet.micro.get("hcc")
        by_factor[1.0] = {"hcc_macro_family": macro, "hcc_micro": micro}
    order = ["hcc_macro_family", "hcc_micro"]
    heads = {"hcc_macro_family": "HCC % over families", "hcc_micro": "HCC % over samples"}
    if protocol.grading.headline == "micro":
        order.reverse()
    return ExtraTable(
        title="Sensitivity to the required clearance",
        heads=tuple(heads[key] for key in order),
        lines=tuple(
            (_factor_words(factor), tuple(_share(row.get(key), digits) for key in order))
            for factor, row in sorted(by_factor.items())
        ),
        note="The same trajectories, had every task asked for less or more clearance. "
        "Only the unchanged row ranks.",
    )


def _confusion(rows: dict[str, MetricRow]) -> ExtraTable:
    """How many samples of each acceptable set got each answer: plain counts."""
    heads = tuple(dict.fromkeys(key for row in rows.values() for key in row))
    return ExtraTable(
        title="Answers by acceptable set",
        heads=tuple("samples" if head == "n" else head for head in heads),
        lines=tuple(
            ("\u00a0".join(name), tuple(_count(row.get(head)) for head in heads))
            for name, row in rows.items()
        ),
        note="How many samples whose acceptable answers are those on the left got which answer.",
    )


def _reminder(row: MetricRow, digits: Digits) -> ExtraTable:
    return ExtraTable(
        title="What the reminder records say",
        heads=("%",),
        lines=tuple(
            (words, (_share(row.get(key), digits),))
            for key, words in _REMINDER_WORDS.items()
            if key in row
        ),
        note="Scored over the samples that carry a record; it never ranks.",
    )


def _count(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def _factor_words(factor: float) -> str:
    words = {0.5: "half of d_safe", 1.0: "d_safe as it ranks", 2.0: "twice d_safe"}
    return words.get(factor, f"{factor:g} times d_safe")


def _share(value: float | None, digits: Digits) -> str:
    return "" if value is None else digits.fraction(value)


def _plain(title: str, rows: dict[str, MetricRow]) -> ExtraTable:
    heads = tuple(dict.fromkeys(key for row in rows.values() for key in row))
    lines = tuple(
        (name.replace("_", " "), tuple(_text(row.get(head)) for head in heads))
        for name, row in rows.items()
    )
    return ExtraTable(title, tuple(head.replace("_", " ") for head in heads), lines)


def _text(value: float | None) -> str:
    if value is None:
        return ""
    return str(int(value)) if value == int(value) and abs(value) > 1 else fixed(value * 100, 1)


def effect_tables(board: Board, entry: BoardEntry, digits: Digits) -> tuple[ExtraTable, ...]:
    """Return the table of an entry's effect; none where nothing is linked."""
    effect = entry.reminder_effect
    if effect is None:
        return ()
    metrics = [m for m in primary_metrics(challenge_of(board)) if m.key in effect.differences]
    return (
        ExtraTable(
            title="What the reminder changed",
            heads=("difference", f"{board.confidence:.0%} interval", "samples changed", "verdict"),
            lines=tuple(
                (
                    f"{metric.label} {unit_of(metric)}",
                    _cells(metric, effect.differences[metric.key], digits),
                )
                for metric in metrics
            ),
            note=f"With the reminder minus without it ({effect.without_method}), sample by sample; "
            "the interval draws scenes, the same for both.",
        ),
    )


def _cells(metric: Metric, found: PairedDifference, digits: Digits) -> tuple[str, ...]:
    def signed(value: float | None) -> str:
        return "" if value is None else digits.signed(metric, value)

    low, high = found.interval or (None, None)
    share = "" if found.discordant is None else f"{digits.fraction(found.discordant)}\u2009%"
    interval = "" if low is None else f"{signed(low)} to {signed(high)}"
    return (signed(found.difference), interval, share, found.verdict)
