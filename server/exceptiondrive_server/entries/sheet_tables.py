"""Further tables of an entry: effect of a reminder, sensitivity, confusion, any other named table."""

from typing import NamedTuple

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import REMINDER, MetricRow, ScoreSheet
from exceptiondrive_server.boards.entry_facts import challenge_of, primary_metrics
from exceptiondrive_server.web.numbers import Digits, fixed, percent, unit_of

CONFUSION, SENSITIVITY = "confusion_", "d_safe_x"
_FACTORS = {
    0.5: "half the required clearance",
    1.0: "the required clearance, as it ranks",
    2.0: "twice the required clearance",
}
_REMINDER_LABELS = {
    "given": "samples with a reminder record",
    "presence_precision": "hazard presence, precision",
    "presence_recall": "hazard presence, recall",
    "type_task_accuracy": "hazard type right, the task",
    "type_family_accuracy": "hazard type right, the family",
    "strategy_accuracy": "recommended strategy acceptable",
}


class SheetTable(NamedTuple):
    """Named rows, and what they mean; an empty cell is undefined."""

    title: str
    heads: tuple[str, ...]
    """Of the names of rows first."""
    lines: tuple[tuple[str, tuple[str, ...]], ...]
    note: str = ""


def effect_table(board: Board, entry: BoardEntry, digits: Digits) -> SheetTable:
    """Return what a reminder changed, as the board carries it; no lines where nothing is linked."""
    effect = entry.reminder_effect
    lines = []
    for metric in primary_metrics(challenge_of(board)):
        found = effect.differences.get(metric.key) if effect else None
        if found is not None:
            share = found.discordant
            cells = (
                digits.signed(metric, found.difference),
                digits.interval(metric, found.interval, signed=True),
                "not told" if share is None else f"{digits.fraction(share)}\u2009%",
                found.verdict,
            )
            lines.append((f"{metric.label} {unit_of(metric)}", cells))
    return SheetTable(
        "What the reminder changed",
        (
            "metric",
            "difference",
            f"{percent(board.confidence)} interval",
            "samples changed",
            "verdict",
        ),
        tuple(lines),
        f"With the reminder minus without it ({effect.without_method if effect else ''}), sample by "
        "sample; the interval draws scenes, the same for both.",
    )


def sheet_tables(
    sheet: ScoreSheet, protocol: ProtocolDocument, digits: Digits
) -> tuple[SheetTable, ...]:
    """Return a table of each kind of further row that a score sheet has."""
    kinds = (CONFUSION, SENSITIVITY, REMINDER)
    others = {key: row for key, row in sheet.extra.items() if not key.startswith(kinds)}
    tables = (
        _sensitivity_table(sheet, protocol, digits),
        _confusion_table(_of_kind(sheet, CONFUSION)),
        _reminder_table(sheet.extra.get(REMINDER, {}), digits),
        _further_rows(others),
    )
    return tuple(table for table in tables if table.lines)


def _of_kind(sheet: ScoreSheet, kind: str) -> dict[str, MetricRow]:
    return {k.removeprefix(kind): row for k, row in sheet.extra.items() if k.startswith(kind)}


def _sensitivity_table(sheet: ScoreSheet, protocol: ProtocolDocument, digits: Digits) -> SheetTable:
    """HCC with other required clearances, the one that ranks among them, from small to large."""
    by_factor = {float(factor): row for factor, row in _of_kind(sheet, SENSITIVITY).items()}
    if by_factor:
        macro, micro = sheet.macro_family.get("hcc"), sheet.micro.get("hcc")
        by_factor[1.0] = {"hcc_macro_family": macro, "hcc_micro": micro}
    heads = {"hcc_macro_family": "HCC % over families", "hcc_micro": "HCC % over samples"}
    order = list(heads) if protocol.grading.headline == "macro_family" else list(heads)[::-1]
    return SheetTable(
        "Sensitivity to the required clearance",
        ("clearance", *(heads[key] for key in order)),
        tuple(
            (
                _FACTORS.get(factor, f"{factor:g} times d_safe"),
                tuple(_share(row.get(key), digits) for key in order),
            )
            for factor, row in sorted(by_factor.items())
        ),
        "The same trajectories, if every task required less or more clearance. "
        "Only the unchanged row ranks.",
    )


def _confusion_table(rows: dict[str, MetricRow]) -> SheetTable:
    """How many samples of each acceptable set got each answer: plain counts."""
    heads = _column_keys(rows)
    return SheetTable(
        "Answers by acceptable set",
        ("acceptable", *("samples" if head == "n" else head for head in heads)),
        tuple(
            ("\u00a0".join(name), tuple(_count(row.get(head)) for head in heads))
            for name, row in rows.items()
        ),
        "How many samples whose acceptable answers are those on the left got which answer.",
    )


def _reminder_table(row: MetricRow, digits: Digits) -> SheetTable:
    n = row.get("n")
    over = "the samples" if n is None else counted(int(n), "sample")
    return SheetTable(
        "What the reminder records say",
        ("measure", "%"),
        tuple(
            (label, (_share(row.get(key), digits),))
            for key, label in _REMINDER_LABELS.items()
            if key in row
        ),
        f"Scored over {over} with a record, where what a record leaves out counts as wrong. "
        "Each has its hazard, so precision is 100 wherever a hazard is said at all. It never ranks.",
    )


def _further_rows(rows: dict[str, MetricRow]) -> SheetTable:
    heads = _column_keys(rows)
    return SheetTable(
        "Further rows",
        ("name", *(head.replace("_", " ") for head in heads)),
        tuple(
            (name.replace("_", " "), tuple(_plain_number(row.get(head)) for head in heads))
            for name, row in rows.items()
        ),
    )


def _column_keys(rows: dict[str, MetricRow]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(key for row in rows.values() for key in row))


def _share(value: float | None, digits: Digits) -> str:
    return "" if value is None else digits.fraction(value)


def _count(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def _plain_number(value: float | None) -> str:
    if value is None:
        return ""
    return str(int(value)) if value == int(value) and abs(value) > 1 else fixed(value * 100, 1)
