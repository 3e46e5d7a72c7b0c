"""What a reminder changed, as a table: the paired differences that the board carries."""

from exceptiondrive_schemas.board import Board, BoardEntry, PairedDifference
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.pages.entry_facts import challenge_of, primary_metrics
from exceptiondrive_server.pages.extra_tables import ExtraTable
from exceptiondrive_server.pages.numbers import Digits, unit_of


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
