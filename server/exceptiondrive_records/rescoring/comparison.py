"""Compare two boards: what readers see now, and what they would see."""

from dataclasses import dataclass

from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import parsed_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.progress import count_scored
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.splits.splits import find_split, list_splits, part_words
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_schemas.api.rescoring import ChangeKind, Comparison, EntryChange, Standing
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.datasheet import SplitChange
from exceptiondrive_schemas.protocols.difference import (
    Change,
    Difference,
    Stage,
    protocol_difference,
    split_changes,
)
from exceptiondrive_schemas.score_sheet import MetricRow

_DECIMALS = 6
"""Rounding for differences of rounded numbers, to remove floating-point noise."""


def compare_boards(old: Board, new: Board) -> Comparison:
    """Return what changes for every scored entry from one board to the other.

    The old one is what readers see now, the new one what they would see.
    """
    before, after = old.entries_by_submission, new.entries_by_submission
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
        n_ranks_changed=sum(entry.old_rank != entry.new_rank for entry in entries),
        n_newly_failing=sum(entry.newly_failing for entry in entries),
        worst_movers=_worst_movers(entries, new.challenge),
        entries=entries,
    )


def _change(old: BoardEntry | None, new: BoardEntry | None) -> EntryChange:
    entry = new or old
    assert entry is not None
    assert entry.submission_id is not None
    before, after = _standing(old), _standing(new)
    old_rank, new_rank = (None if side is None else side.rank for side in (before, after))
    return EntryChange(
        submission_id=entry.submission_id,
        method=entry.method,
        team=entry.team,
        change=_kind(before, after),
        newly_failing=old_rank is not None and new_rank is None,
        old=before,
        new=after,
        rank_shift=None if old_rank is None or new_rank is None else old_rank - new_rank,
        metric_shifts=_shifts(_metrics_of(before), _metrics_of(after)),
        family_shifts={
            family: _shifts(before.families.get(family) if before else None, row)
            for family, row in (after.families if after else {}).items()
        },
        effect_shifts=_shifts(_effect_of(before), _effect_of(after)),
    )


def _standing(entry: BoardEntry | None) -> Standing | None:
    if entry is None:
        return None
    return Standing(
        rank=entry.rank,
        rank_interval=entry.rank_interval,
        unranked_because=entry.unranked_because,
        metrics=entry.metrics,
        intervals=entry.intervals,
        families={key: cell.metrics for key, cell in entry.families.items()},
        reminder_effect=entry.reminder_effect,
    )


def _kind(old: Standing | None, new: Standing | None) -> ChangeKind:
    if old is None:
        return "appears"
    if new is None:
        return "disappears"
    if _numbers_differ(old, new):
        return "numbers"
    is_same = (old.rank, old.rank_interval) == (new.rank, new.rank_interval)
    return "none" if is_same else "rank_only"


def _numbers_differ(old: Standing, new: Standing) -> bool:
    """Whether a published number changes; the counterpart of the reminder effect is not a number.

    A metric that only one of the boards has is ignored.
    """
    if old.families.keys() != new.families.keys():
        return True
    rows = [(old.metrics, new.metrics)]
    rows += [(row, new.families[family]) for family, row in old.families.items()]
    effects = [each and each.differences for each in (old.reminder_effect, new.reminder_effect)]
    return effects[0] != effects[1] or any(
        before[key] != after[key] for before, after in rows for key in before.keys() & after.keys()
    )


def _effect_of(standing: Standing | None) -> MetricRow | None:
    effect = None if standing is None else standing.reminder_effect
    return None if effect is None else effect.by_metric


def _metrics_of(standing: Standing | None) -> MetricRow | None:
    return None if standing is None else standing.metrics


def _shifts(old: MetricRow | None, new: MetricRow | None) -> MetricRow:
    """Return new minus old by metric; None if either is missing."""
    if not old or not new:
        return dict.fromkeys(new or old or {})
    return {key: _shift(old.get(key), value) for key, value in new.items()}


def _shift(old: float | None, new: float | None) -> float | None:
    return None if old is None or new is None else round(new - old, _DECIMALS) + 0.0


def _worst_movers(entries: tuple[EntryChange, ...], challenge_id: str) -> tuple[str, ...]:
    """Return losing entries: newly failing ones first, then by ranks lost, then by metric lost.

    The metric is the first primary one. Entries that gain ranks but lose in the metric come last.
    """
    metric = CHALLENGES[challenge_id].metrics[0]
    sign = 1 if metric.better == "higher" else -1

    def badness(entry: EntryChange) -> tuple[bool, int, float]:
        shift = entry.metric_shifts.get(metric.key) or 0.0
        return (not entry.newly_failing, entry.rank_shift or 0, sign * shift)

    losers = [
        entry
        for entry, (is_ranked, rank_shift, shift) in zip(
            entries, map(badness, entries), strict=True
        )
        if not is_ranked or rank_shift < 0 or shift < 0
    ]
    return tuple(entry.submission_id for entry in sorted(losers, key=badness))


# Comparisons of recorded boards, cached in memory: boards never change, so neither do these.
#
# A preview of a run computes the comparison; the transaction that flips the pointer then finds it
# in the cache, and need not compute it while holding locks.


@dataclass(frozen=True)
class Compared:
    """A comparison and its digest, both computed once."""

    comparison: Comparison
    digest: str


_COMPARED: Memory[tuple[str, str], Compared] = Memory(4)
"""By pair of boards, for the open runs; about a megabyte each at 1,000 entries."""


def compare_to_shown(session: Session, phase: Phase, new: BoardRow | None) -> Compared | None:
    """Return what changes from the board that a phase shows; None if either board is missing."""
    old = None if phase.current_board_id is None else session.get(BoardRow, phase.current_board_id)
    return None if new is None or old is None else compare_rows(old, new)


def compare_rows(old: BoardRow, new: BoardRow) -> Compared:
    """Return what changes from one recorded board to another."""
    pair = old.told, new.told
    return _COMPARED.get(pair) or _COMPARED.keep(pair, _compare_rows(old, new), 1)


def _compare_rows(old: BoardRow, new: BoardRow) -> Compared:
    comparison = compare_boards(parsed_board(old), parsed_board(new))
    return Compared(comparison, comparison.digest)


# The changes of a run, from the recorded documents.


def difference_of(session: Session, run: RescoringRun) -> Difference:
    """Return what a run changes, in plain words, and how many sheets would be recomputed."""
    before, after = splits_of(session, run)
    return protocol_difference(
        find_protocol(session, run.from_protocol_digest),
        find_protocol(session, run.to_protocol_digest),
        count_scored(session, run.phase_id),
        split=_part_change(before, after) or _revision_changes(session, before, after),
    )


def splits_of(session: Session, run: RescoringRun) -> tuple[SplitRow, SplitRow]:
    """Return the source and the target split revision of a run."""
    name = session.get_one(Phase, run.phase_id).split_name
    before = find_split(session, name, run.from_split_revision)
    return before, find_split(session, name, run.to_split_revision)


def what_changed(session: Session, run: RescoringRun, *, is_taken_back: bool) -> tuple[str, ...]:
    """Describe for readers what a run, or its rollback, changes, without organizers' reasons."""
    sentences = difference_of(session, run).sentences
    if is_taken_back:
        return tuple(f"taken back: {sentence}" for sentence in sentences)
    if run.from_protocol_digest == run.to_protocol_digest:
        return sentences
    return find_protocol(session, run.to_protocol_digest).changes, *sentences


def split_steps(session: Session, before: SplitRow, after: SplitRow) -> tuple[SplitChange, ...]:
    """Return the public description of each step from a revision, or part of it, to a later one.

    Returns:
        Oldest first; empty if the later one does not derive from the earlier one.
    """
    previous = {
        row.revision: row.changes
        for row in list_splits(session)
        if row.name == after.name and row.changes is not None
    }
    steps: list[SplitChange] = []
    revision = after.revision
    while revision != before.revision and revision in previous:
        steps.append(previous.pop(revision))
        revision = steps[-1].previous
    return tuple(reversed(steps)) if revision == before.revision else ()


def _revision_changes(session: Session, before: SplitRow, after: SplitRow) -> tuple[Change, ...]:
    n_counted = before.n_samples, after.n_samples
    steps = split_steps(session, before, after)
    changes = split_changes(before.manifest, after.manifest, n_counted, steps)
    if before.public_file_digest is None or after.public_file_digest is not None:
        return changes
    sentence = "the regions of the new revision are withheld; those of the earlier one are public"
    return (*changes, Change(sentence=sentence, stage=Stage.MEASURE))


def _part_change(before: SplitRow, after: SplitRow) -> tuple[Change, ...]:
    """Say which samples count, if the part of the split changes."""
    if before.part == after.part:
        return ()
    old, new = (
        f"{part_words(row.part)} of the split ({row.n_samples:,} samples)"
        for row in (before, after)
    )
    counts = "count" if after.part is None else "counts"
    sentence = f"{new} {counts} in place of {old}"
    return (Change(sentence=sentence, stage=Stage.MEASURE),)
