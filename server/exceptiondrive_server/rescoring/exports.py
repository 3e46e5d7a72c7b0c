"""A comparison as CSV, one line per entry, safe to open in a spreadsheet."""

import csv
import io

from exceptiondrive_schemas.api.rescoring import Comparison, EntryChange, FlipDirection, Standing
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import spreadsheet_text
from exceptiondrive_schemas.score_sheet import MetricRow

_REMINDER = "reminder_effect"


def comparison_csv(comparison: Comparison, direction: FlipDirection) -> str:
    """Return old and new of every number, entry by entry.

    Each line ends with what is compared: the direction (`roll_back`: new is the earlier protocol), and
    number, protocol and split revision of both boards.
    """
    metrics = CHALLENGES[comparison.challenge].metric_keys
    families = _families(comparison)
    columns = [("all", key) for key in metrics]
    columns += [(family, key) for family in families for key in metrics]
    if any(_effect(side) for entry in comparison.entries for side in (entry.old, entry.new)):
        columns += [(_REMINDER, key) for key in metrics]
    head = ["submission_id", "team", "method", "change", "newly_failing"]
    head += ["old_rank", "new_rank"]
    head += ["old_rank_low", "old_rank_high", "new_rank_low", "new_rank_high"]
    head += ["old_unranked_because", "new_unranked_because"]
    for family, key in columns:
        name = key if family == "all" else f"{key}.{family}"
        head += [f"old_{name}", f"new_{name}"]
    compared = {
        "direction": direction,
        "phase": comparison.phase,
        "old_board": str(comparison.old_board),
        "new_board": str(comparison.new_board),
        "old_protocol": comparison.from_protocol.version,
        "new_protocol": comparison.to_protocol.version,
        "old_split_revision": comparison.from_split.revision,
        "new_split_revision": comparison.to_split.revision,
    }
    head += compared
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    for entry in comparison.entries:
        writer.writerow([*_line(entry, columns), *compared.values()])
    return out.getvalue()


def _line(entry: EntryChange, columns: list[tuple[str, str]]) -> list[str | float | None]:
    """Cells of an entry; None is written as an empty one."""
    sides = (entry.old, entry.new)
    spans = [(side and side.rank_interval) or (None, None) for side in sides]
    cells: list[str | float | None] = [
        entry.submission_id,
        spreadsheet_text(entry.team),
        spreadsheet_text(entry.method),
        entry.change,
        entry.newly_failing,
        entry.old_rank,
        entry.new_rank,
        *(end for span in spans for end in span),
        *(spreadsheet_text((side and side.unranked_because) or "") for side in sides),
    ]
    for column in columns:
        cells += [_value(side, *column) for side in sides]
    return cells


def _value(standing: Standing | None, family: str, key: str) -> float | None:
    if standing is None:
        return None
    if family == _REMINDER:
        return _effect(standing).get(key)
    row = standing.metrics if family == "all" else standing.families.get(family, {})
    return row.get(key)


def _effect(standing: Standing | None) -> MetricRow:
    effect = None if standing is None else standing.reminder_effect
    return {} if effect is None else effect.by_metric


def _families(comparison: Comparison) -> list[str]:
    sides = (side for entry in comparison.entries for side in (entry.old, entry.new) if side)
    return list(dict.fromkeys(family for side in sides for family in side.families))
