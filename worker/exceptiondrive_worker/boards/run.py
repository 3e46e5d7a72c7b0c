"""The board run: rank the scored entries of a phase under a protocol into a new board snapshot."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import zip_longest

import structlog

from exceptiondrive_records.boards.boards import (
    current_board,
    is_draft,
    latest_board,
    publish_board,
)
from exceptiondrive_records.boards.documents import collector_at_rest, entries_of, entry_documents
from exceptiondrive_records.boards.standings import entries_for_board, whole_sheets
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.scoring_keys import ScoringKey
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.work.board_requests import claim_board
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.api.phase_settings import BoardView
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.reported import reported_entries
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_worker.boards.comparisons import (
    Standing,
    best_ranked,
    comparisons,
    entry_uncertainties,
)
from exceptiondrive_worker.boards.entries import ScoredEntry, board_entries, family_heads
from exceptiondrive_worker.boards.references import scored_references
from exceptiondrive_worker.boards.reminder_effects import reminder_effects
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.drawing import Drawable, draw_entries, draw_protocol
from exceptiondrive_worker.failures import FailureCode, run_job
from exceptiondrive_worker.similarity_run import compare_submissions
from exceptiondrive_worker.splits.floors import FloorHeldError, FloorsUnreadableError
from exceptiondrive_worker.splits.floors_held import open_split
from exceptiondrive_worker.splits.store import SplitUnavailableError
from exceptiondrive_worker.stages import Stages, Target

_log = structlog.get_logger("exceptiondrive.worker")


def build_next_board(context: WorkerContext, lane: Lane) -> bool:
    """Build and publish the board of a lane that is due longest; return whether there was one.

    A failed build keeps its lease, and is tried again when that expires.
    """
    with context.database.claim() as session:
        request = claim_board(session, lane, context.settings.board_lease_s)
    if request is None:
        return False
    run_job(request.subject, lambda: build_board(context, request), lambda _: None)
    return True


def build_board(context: WorkerContext, claimed: BoardRequest) -> None:
    """Build and publish the board that was claimed, then its drawings."""
    phase_id = claimed.phase_id
    where = {"job": claimed.subject, "phase": phase_id}
    try:
        with collector_at_rest():
            board, drawable, like = _board(context, claimed)
            late = _late_board(context, claimed)
            with context.database.write() as session:
                row = publish_board(session, claimed, board, late)
    except (SplitUnavailableError, FloorsUnreadableError) as error:
        code = "split_unavailable"
        _log.error("split unavailable: board not built", **where, code=code, reason=str(error))
        return
    except FloorHeldError as held:
        code = FailureCode.SPLIT_FLOOR.value
        _log.error("floors of the split: board not built", **where, code=code, reason=str(held))
        return
    _log.info("board built", phase=phase_id, number=None if row is None else row.number)
    draw_protocol(context, claimed.protocol_digest)
    draw_entries(context, drawable)
    compare_submissions(context, phase_id, like)


def with_previous_ranks(
    entries: tuple[BoardEntry, ...], latest: str | None, current: str | None
) -> tuple[BoardEntry, ...]:
    """Add each ranked entry's rank on the current board, which is given as recorded.

    If the entries equal those of the latest board of this protocol, its previous ranks are kept:
    building a board twice changes nothing.
    """
    if latest is not None and _says_the_same(entries, latest):
        places = [row.previous_rank for row in entries_of(latest)]
    elif current is not None:
        # a submission may be renamed; a method's next run inherits the rank of the one that left
        stay = {row.submission_id for row in entries}
        by_submission: dict[str | None, int | None] = {}
        by_name: dict[tuple[str, str], int | None] = {}
        for was in entry_documents(current):  # streamed: a long board would take most of the memory
            if was["source"] == "scored":
                by_submission[was["submission_id"]] = was["rank"]
                if was["submission_id"] not in stay:
                    by_name[was["team"], was["method"]] = was["rank"]
        places = [
            row.previous_rank
            if row.rank is None
            else by_submission.get(row.submission_id, by_name.get((row.team, row.method)))
            for row in entries
        ]
    else:
        return entries
    return tuple(
        row if row.previous_rank == place else row.model_copy(update={"previous_rank": place})
        for row, place in zip(entries, places, strict=True)
    )


def _says_the_same(entries: tuple[BoardEntry, ...], body: str) -> bool:
    """Whether a recorded board has the same entries, apart from previous ranks."""
    said = (row.model_copy(update={"previous_rank": None}) for row in entries_of(body))
    return all(one == other for one, other in zip_longest(said, entries))


def _late_board(context: WorkerContext, claimed: BoardRequest) -> Board | None:
    """Return the board of the late view; None if the phase has none, or nothing came late."""
    with context.database.read() as session:
        phase = find_phase(session, claimed.phase_id)
        if phase.policy.late_entries != "own_view":
            return None
        records = entries_for_board(
            session, phase.id, claimed.protocol_digest, claimed.split_revision, "late"
        )
    return _board(context, claimed, "late")[0] if any(each.is_late for each in records) else None


def _board(
    context: WorkerContext, claimed: BoardRequest, view: BoardView = "main"
) -> tuple[Board, list[Drawable], Target]:
    """Return the board, the entries that may be drawn, and a target of the phase without a file."""
    with context.database.read() as session:
        phase = find_phase(session, claimed.phase_id)
        protocol = find_protocol(session, claimed.protocol_digest)
        key = ScoringKey(protocol.digest, claimed.split_revision)
        records = entries_for_board(session, phase.id, *key, view)
        part = find_split(session, phase.split_name, claimed.split_revision).part
        latest, current = (
            latest_board(session, phase.id, key, view),
            current_board(session, phase.id),
        )
        if view == "main" and latest is not None and is_draft(session, latest):
            latest = None  # it gives previous ranks on a board that may have been another one
        bodies = [None if row is None else row.body for row in (latest, current)]
        ref = SplitRef(name=phase.split_name, revision=claimed.split_revision)
        is_public = find_public_split(session, ref) is not None
    challenge = CHALLENGES[phase.challenge]
    split = open_split(context, ref, protocol, phase_id=phase.id, is_public=is_public)
    like = Target("", challenge, split, protocol)
    targets = [
        replace(like, file_digest=record.file_digest, read_under=record.accepted_under)
        for record in records
    ]
    standings = list(zip(targets, records, strict=True))
    rounding = Rounding.of(like, is_public=is_public)
    references = scored_references(context.stages, like, rounding)
    scored = _scored(context.stages, standings, rounding)
    entries = board_entries(scored, references, challenge, protocol, rounding)
    best = _best(context, standings, best_ranked(entries, protocol), key)
    compared = comparisons(context.stages, best, protocol, rounding)
    if phase.shows_reported:
        entries += reported_entries(challenge.id, protocol.grading.headline)
    entries = with_previous_ranks(entries, *bodies)
    has_too_few_scenes = any(row.rank is not None and row.rank_interval is None for row in entries)
    board = Board(
        challenge=challenge.id,
        phase=phase.id,
        split=split.manifest.ref,
        protocol=ProtocolRef.of(protocol),
        headline=protocol.grading.headline,
        board=0,  # number and date are assigned on publication
        published_at=datetime.fromtimestamp(0, UTC),
        n_samples=split.arrays.n_samples,
        confidence=protocol.ranking.confidence,
        families=family_heads(split, protocol),
        entries=entries,
        comparisons=compared,
        view=view,
        part=part,
        min_scenes=protocol.ranking.min_scenes if has_too_few_scenes else None,
    )
    _ = board.content_digest  # computed and cached now, not while the write lock is held
    return board, [(target, record.submission_id) for target, record in standings], like


def _best(
    context: WorkerContext, standings: Sequence[Standing], names: Sequence[str], key: ScoringKey
) -> list[Standing]:
    """Return the standings of these submissions, in their order, with their whole sheets."""
    found = {record.submission_id: (target, record) for target, record in standings}
    best = [found[name] for name in names]
    if not best:
        return []
    with context.database.read() as session:
        whole = dict(whole_sheets(session, names, key))
    return [(target, replace(one, sheet=whole[one.submission_id])) for target, one in best]


def _scored(stages: Stages, standings: list[Standing], rounding: Rounding) -> list[ScoredEntry]:
    measured = [(target, record.measurement_key) for target, record in standings]
    uncertainties = entry_uncertainties(stages, measured)
    effects = reminder_effects(stages, standings, rounding)
    records = (record for _, record in standings)
    return [ScoredEntry(*parts) for parts in zip(records, uncertainties, effects, strict=True)]
