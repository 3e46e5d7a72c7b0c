"""Find the best run of a method, by the scores that its team could see before the deadline."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import last_shown_of_part
from exceptiondrive_records.phases.scoring_keys import ScoringKey, is_of_key
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.splits import find_split, live_revision
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet


def best_run(
    session: Session, phase: Phase, submission_ids: list[str], key: ScoringKey
) -> str | None:
    """Return the submission that ranks best by its published sheet; among equals the newest.

    Runs without a rank come last. Only samples that count before the reveal decide: on a private
    part, picking the best of many runs after the fact would reveal more of it than one entry does.
    `submission_ids` are ordered oldest first.

    Returns:
        None if no run has such a sheet.
    """
    protocol = find_protocol(session, key.protocol_digest)
    live = _live_revision(session, phase, key.split_revision)
    query = select(ScoreSheetRow).where(
        ScoreSheetRow.submission_id.in_(submission_ids),
        is_of_key(ScoreSheetRow, key._replace(split_revision=live)),
    )
    sheets = {row.submission_id: row.sheet for row in session.scalars(query)}
    known = [run for run in reversed(submission_ids) if run in sheets]
    return max(known, key=lambda run: _worth(sheets[run], protocol), default=None)


def _live_revision(session: Session, phase: Phase, revision: str) -> str:
    """Return the revision whose sheets teams saw: after a reveal, that of the live board before it."""
    live = live_revision(session, phase.split_name, revision, phase.policy.live_part)
    if live == revision:
        return live
    part = find_split(session, phase.split_name, live).part
    board = last_shown_of_part(session, phase, part)
    return live if board is None else board.split_revision


def _worth(sheet: ScoreSheet, protocol: ProtocolDocument) -> tuple[bool, list[tuple[bool, float]]]:
    """Return the sort key: whether it is ranked, then its ranking metrics, undefined ones last."""
    values = sheet.average(protocol.grading.headline)
    flags = {flag.code for flag in sheet.plausibility.flags}
    shares = (sheet.coverage.edited, sheet.coverage.source)
    is_covered = all(share is None or share >= protocol.ranking.min_coverage for share in shares)
    order = [
        (value is not None, (value or 0.0) * (1 if key.order == "descending" else -1))
        for key in protocol.ranking.order_of(CHALLENGES[sheet.challenge])
        for value in (values.get(key.metric),)
    ]
    return is_covered and flags.isdisjoint(protocol.ranking.unranked_flags), order
