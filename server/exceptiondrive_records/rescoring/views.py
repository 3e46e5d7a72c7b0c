"""Read model of runs, previews and the history of boards, for API and pages."""

from collections.abc import Mapping

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import aliases_in, latest_board, under_alias
from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.errors import Conflict, NotFound
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.scoring_keys import shadow_key
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import (
    checked_protocol,
    find_protocol,
    list_protocols,
)
from exceptiondrive_records.rescoring.comparison import (
    Compared,
    compare_to_shown,
    difference_of,
    split_steps,
    splits_of,
    what_changed,
)
from exceptiondrive_records.rescoring.flip import blockers_of, comparison_of
from exceptiondrive_records.rescoring.progress import count_scored, progress_of
from exceptiondrive_records.rescoring.reveal import reveal_warnings
from exceptiondrive_records.rescoring.runs import find_run, list_runs
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.trials import trial_of
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.api.rescoring import (
    BoardHistoryLine,
    FlipDirection,
    PreviewView,
    PublicRun,
    RunAction,
    RunState,
    RunView,
    actions_of,
)
from exceptiondrive_schemas.board import BoardNews
from exceptiondrive_schemas.protocols.difference import Difference, protocol_difference
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

_PREVIEWED = (RunState.SCORING, RunState.PAUSED, RunState.READY, RunState.APPLIED)


def run_view(session: Session, run: RescoringRun) -> RunView:
    """Return a run as organizers see it."""
    phase = session.get_one(Phase, run.phase_id)
    compared = comparison_of(session, run) if run.state in _PREVIEWED else None
    progress = progress_of(session, run)
    actions = actions_of(run.state, has_failed=progress.failed > 0, kind=run.kind)
    trial = trial_of(session, run.id)
    is_refused = trial is not None and trial.state == "refused"
    return RunView(
        id=run.id,
        kind=run.kind,
        phase=run.phase_id,
        state=run.state,
        reason=run.reason,
        actor=run.actor,
        from_protocol=_protocol_ref(session, run.from_protocol_digest),
        to_protocol=_protocol_ref(session, run.to_protocol_digest),
        from_split=SplitRef(name=phase.split_name, revision=run.from_split_revision),
        to_split=SplitRef(name=phase.split_name, revision=run.to_split_revision),
        created_at=run.created_at,
        started_at=run.started_at,
        applied_at=run.applied_at,
        ended_at=run.ended_at,
        progress=progress,
        actions=tuple(one for one in actions if one is not RunAction.START or not is_refused),
        blockers=blockers_of(session, run),
        difference=difference_of(session, run),
        trial=trial,
        old_board=compared.comparison.old_board if compared else None,
        new_board=compared.comparison.new_board if compared else None,
        preview=compared.digest if compared else None,
    )


def run_views(
    session: Session, phase_id: str | None = None, limit: int | None = None
) -> list[RunView]:
    """Return runs, newest first, at most `limit`."""
    return [run_view(session, run) for run in list_runs(session, phase_id, limit=limit)]


def protocol_check(session: Session, toml: str, phase_id: str | None) -> Difference:
    """Return what a protocol document would change, without storing it.

    Without a phase, it is compared with the protocol added last.

    Raises:
        InvalidRecord: Not a valid protocol document; every problem is listed.
        NotFound: No such phase, or no protocol to compare with.
        Conflict: The version is taken by another content.
    """
    new = checked_protocol(session, toml)
    if phase_id is not None:
        phase = find_phase(session, phase_id)
        old = find_protocol(session, phase.protocol_digest)
        return protocol_difference(old, new, count_scored(session, phase.id))
    known = list_protocols(session)
    if not known:
        raise NotFound("protocol", "to compare with")
    sheets = select(func.count()).where(ScoreSheetRow.protocol_digest == known[-1].digest)
    return protocol_difference(known[-1], new, session.scalar(sheets) or 0)


def preview_of(session: Session, run_id: str, seen: str | None = None) -> PreviewView:
    """Return the comparison that the next flip would publish.

    If `seen` is the digest of an earlier one, the result says whether that is stale now.

    Raises:
        NotFound: No such run.
        Conflict: One of the two boards does not exist yet; the sentence says why.
    """
    run = find_run(session, run_id)
    phase = session.get_one(Phase, run.phase_id)
    blockers = blockers_of(session, run)
    compared = (
        comparison_of(session, run)
        if run.state in _PREVIEWED
        else _applied_comparison(session, run)
    )
    is_behind = compared is None and not run.state.is_final
    if compared is None:
        draft = latest_board(session, run.phase_id, shadow_key(run))
        compared = compare_to_shown(session, phase, draft)  # even if submissions came since
    if compared is None:
        yet = "" if run.state.is_final else " yet"
        raise Conflict(f"There is nothing to compare{yet}. {' '.join(blockers)}")
    return PreviewView(
        run=run.id,
        digest=compared.digest,
        direction=_direction(run.state),
        is_stale=is_behind or (seen is not None and seen != compared.digest),
        blockers=blockers,
        warnings=reveal_warnings(session, run),
        comparison=compared.comparison,
    )


def _direction(state: RunState) -> FlipDirection:
    if state.is_final:
        return "applied"
    return "roll_back" if state is RunState.APPLIED else "apply"


def _applied_comparison(session: Session, run: RescoringRun) -> Compared | None:
    """Return the comparison published when the run was applied, if any, under aliases."""
    if run.comparison is None:
        return None
    aliases = aliases_in(session, run.phase_id)
    entries = tuple(under_alias(entry, aliases) for entry in run.comparison.entries)
    told = run.comparison.model_copy(update={"entries": entries})
    return Compared(told, told.digest)


def public_run(session: Session, run_id: str, *, with_hidden: bool = False) -> PublicRun:
    """Return an applied run as every reader may see it, without the organizers' reason.

    `with_hidden`, for organizers, allows runs of hidden phases.

    Raises: NotFound: There is none, it was never applied, or its phase is hidden; the sentence is
        the same.
    """
    run = session.get(RescoringRun, run_id)
    applied = None if run is None else _applied_comparison(session, run)
    if run is None or run.applied_at is None or applied is None:
        raise NotFound("applied rescoring run", run_id)
    phase = session.get_one(Phase, run.phase_id)
    if phase.visibility == "hidden" and not with_hidden:
        raise NotFound("applied rescoring run", run_id)
    return PublicRun(
        id=run.id,
        phase=run.phase_id,
        state=run.state,
        applied_at=run.applied_at,
        ended_at=run.ended_at,
        from_protocol=_protocol_ref(session, run.from_protocol_digest),
        to_protocol=_protocol_ref(session, run.to_protocol_digest),
        from_split=SplitRef(name=phase.split_name, revision=run.from_split_revision),
        to_split=SplitRef(name=phase.split_name, revision=run.to_split_revision),
        changes=_words_for_readers(session, run),
        difference=difference_of(session, run),
        comparison=applied.comparison,
    )


def _words_for_readers(session: Session, run: RescoringRun) -> str:
    """Return what the authors of the new protocol and of the new split revision say about them."""
    words = []
    if run.from_protocol_digest != run.to_protocol_digest:
        words.append(find_protocol(session, run.to_protocol_digest).changes)
    words += [step.words for step in split_steps(session, *splits_of(session, run))]
    return " ".join(words)


def board_history(session: Session, phase_id: str) -> list[BoardHistoryLine]:
    """Return every board that was ever public, newest first, with the cause of its publication.

    No board is read: a phase may have thousands of a megabyte each.

    Raises:
        NotFound: No such phase.
    """
    phase = find_phase(session, phase_id)
    query = (
        select(
            BoardFlip.id,
            BoardFlip.at,
            BoardFlip.news,
            BoardRow.number,
            BoardRow.protocol_digest,
            BoardRow.split_revision,
        )
        .join(BoardRow, BoardRow.id == BoardFlip.board_id)
        .where(BoardFlip.phase_id == phase_id)
        .order_by(BoardFlip.at, BoardFlip.id)
    )
    flips = session.execute(query).all()
    runs, aliases = _runs_by_flip(session, phase_id), aliases_in(session, phase_id)
    digests = {flip.protocol_digest for flip in flips}
    protocols = {digest: _protocol_ref(session, digest) for digest in digests}
    ends = [*(flip.at for flip in flips[1:]), None][: len(flips)]
    lines = []
    for flip, end in zip(flips, ends, strict=True):
        run = runs.get(flip.id)
        lines.append(
            BoardHistoryLine(
                board=flip.number,
                address=f"/api/v1/boards/{phase_id}/{flip.number}",
                protocol=protocols[flip.protocol_digest],
                split=SplitRef(name=phase.split_name, revision=flip.split_revision),
                shown_from=flip.at,
                shown_until=end,
                what_changed=() if run is None else _words_of(session, run, flip.id),
                news=_news_under_aliases(flip.news, aliases),
                comparison=None if run is None else f"/api/v1/rescoring/{run.id}",
            )
        )
    return lines[::-1]


def _news_under_aliases(news: BoardNews, aliases: Mapping[str, str]) -> BoardNews:
    entries = tuple(under_alias(entry, aliases) for entry in news.entries)
    return news.model_copy(update={"entries": entries})


def update_words(session: Session, phase_id: str) -> dict[int, tuple[str, ...]]:
    """Describe the changes by each flip of a phase's board that applied or rolled back an update.

    Returns:
        Sentences by id of the flip, without organizers' reasons.
    """
    runs = _runs_by_flip(session, phase_id)
    return {flip_id: _words_of(session, run, flip_id) for flip_id, run in runs.items()}


def _words_of(session: Session, run: RescoringRun, flip_id: int) -> tuple[str, ...]:
    return what_changed(session, run, is_taken_back=flip_id == run.rollback_flip_id)


def _runs_by_flip(session: Session, phase_id: str) -> dict[int, RescoringRun]:
    found = {}
    for run in list_runs(session, phase_id):
        for flip_id in (run.apply_flip_id, run.rollback_flip_id):
            if flip_id is not None:
                found[flip_id] = run
    return found


def _protocol_ref(session: Session, digest: str) -> ProtocolRef:
    return ProtocolRef.of(find_protocol(session, digest))
