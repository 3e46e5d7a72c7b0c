"""Two boards side by side. Pure: what readers see now, and what they would see."""

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.rescoring import Change, Comparison, EntryChange, Standing
from exceptiondrive_schemas.score_sheet import MetricRow

_DECIMALS = 6
"""A difference of two rounded numbers, without the noise of binary fractions."""


def compare_boards(old: Board, new: Board) -> Comparison:
    """Return what changes for every scored entry from one board to the other.

    Args:
        old: What readers see now.
        new: What they would see.
    """
    before, after = _scored(old), _scored(new)
    order = [*before, *(key for key in after if key not in before)]
    entries = tuple(_change(before.get(key), after.get(key)) for key in order)
    return Comparison(
        phase=new.phase,
        challenge=new.challenge,
        from_protocol=old.protocol,
        to_protocol=new.protocol,
        from_split=old.split,
        to_split=new.split,
        old_board=old.board,
        new_board=new.board,
        n_entries=len(entries),
        n_numbers_changed=sum(entry.change == "numbers" for entry in entries),
        n_ranks_changed=sum(_rank(entry.old) != _rank(entry.new) for entry in entries),
        n_newly_failing=sum(entry.newly_failing for entry in entries),
        worst_movers=_worst_movers(entries, new.challenge),
        entries=entries,
    )


def _scored(board: Board) -> dict[str, BoardEntry]:
    return {
        entry.submission_id: entry for entry in board.entries if entry.submission_id is not None
    }


def _change(old: BoardEntry | None, new: BoardEntry | None) -> EntryChange:
    entry = new or old
    assert entry is not None
    assert entry.submission_id is not None
    before, after = _standing(old), _standing(new)
    old_rank, new_rank = _rank(before), _rank(after)
    return EntryChange(
        submission_id=entry.submission_id,
        method=entry.method,
        team=entry.team,
        change=_kind(before, after),
        newly_failing=old_rank is not None and new_rank is None,
        old=before,
        new=after,
        rank_shift=None if old_rank is None or new_rank is None else old_rank - new_rank,
        metric_shifts=_shifts(_row(before), _row(after)),
        family_shifts={
            family: _shifts(before.families.get(family) if before else None, row)
            for family, row in (after.families if after else {}).items()
        },
        effect_shifts=_shifts(_effect(before), _effect(after)),
    )


def _standing(entry: BoardEntry | None) -> Standing | None:
    if entry is None:
        return None
    return Standing(
        rank=entry.rank,
        rank_interval=entry.rank_interval,
        unranked_because=entry.unranked_because,
        metrics=entry.metrics,
        families={key: cell.metrics for key, cell in entry.families.items()},
        reminder_effect=entry.reminder_effect,
    )


def _kind(old: Standing | None, new: Standing | None) -> Change:
    if old is None:
        return "appears"
    if new is None:
        return "disappears"
    if _numbers(old) != _numbers(new):
        return "numbers"
    is_same = (old.rank, old.rank_interval) == (new.rank, new.rank_interval)
    return "none" if is_same else "rank_only"


def _numbers(standing: Standing) -> tuple[object, ...]:
    """Return the published numbers; whom the reminder is measured against is none of them."""
    effect = standing.reminder_effect
    return (standing.metrics, standing.families, None if effect is None else effect.differences)


def _effect(standing: Standing | None) -> MetricRow | None:
    effect = None if standing is None else standing.reminder_effect
    return None if effect is None else effect.by_metric


def _row(standing: Standing | None) -> MetricRow | None:
    return None if standing is None else standing.metrics


def _rank(standing: Standing | None) -> int | None:
    return None if standing is None else standing.rank


def _shifts(old: MetricRow | None, new: MetricRow | None) -> MetricRow:
    """New minus old; None where one of the two is missing."""
    if not old or not new:
        return dict.fromkeys(new or old or {})
    return {key: _shift(old.get(key), value) for key, value in new.items()}


def _shift(old: float | None, new: float | None) -> float | None:
    return None if old is None or new is None else round(new - old, _DECIMALS) + 0.0


def _worst_movers(entries: tuple[EntryChange, ...], challenge_id: str) -> tuple[str, ...]:
    """Newly failing first, then by places lost, then by the first primary metric lost."""
    metric = CHALLENGES[ChallengeId(challenge_id)].metrics[0]
    sign = 1 if metric.better == "higher" else -1

    def badness(entry: EntryChange) -> tuple[bool, int, float]:
        shift = entry.metric_shifts.get(metric.key) or 0.0
        return (not entry.newly_failing, entry.rank_shift or 0, sign * shift)

    losers = [entry for entry in entries if badness(entry) < (True, 0, 0.0)]
    return tuple(entry.submission_id for entry in sorted(losers, key=badness))
