"""The keys of score sheets, and the runs for which new submissions are scored a second time."""

from typing import NamedTuple

from sqlalchemy import ColumnElement, and_, bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.columns import is_one_of
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.rescoring import RunKind, RunState
from exceptiondrive_schemas.protocol import ProtocolDocument

UNFINISHED = (RunState.SCORING, RunState.PAUSED, RunState.READY)
"""States of runs under whose target every new submission is scored as well."""
IS_TWO_SIDED = and_(
    RescoringRun.phase_id == Phase.id,
    RescoringRun.kind == RunKind.UPDATE,
    is_one_of(RescoringRun.state, (*UNFINISHED, RunState.APPLIED)),
)
"""Join condition: the run is an update of the phase for which submissions are scored twice."""
_PHASE_AND_TWO_SIDED_RUN = (
    select(Phase, RescoringRun)
    .outerjoin(RescoringRun, IS_TWO_SIDED)
    .where(Phase.id == bindparam("phase"))
    .execution_options(populate_existing=True)
)
_FIRST_PROTOCOL = (
    select(ScoreSheetRow.protocol_digest)
    .where(ScoreSheetRow.submission_id == bindparam("submission"))
    .order_by(ScoreSheetRow.created_at, ScoreSheetRow.protocol_digest)
    .limit(1)
)


class ScoringKey(NamedTuple):
    """A protocol and a split revision: with a submission it identifies one sheet."""

    protocol_digest: str
    split_revision: str


def is_of_key(rows: type[Job | ScoreSheetRow | BoardRow], key: ScoringKey) -> ColumnElement[bool]:
    """Condition on a job, sheet or board: it belongs to a key."""
    return and_(
        rows.protocol_digest == key.protocol_digest, rows.split_revision == key.split_revision
    )


def key_of_phase(phase: Phase) -> ScoringKey:
    """Return the key that the phase shows."""
    return ScoringKey(phase.protocol_digest, phase.split_revision)


def old_key(run: RescoringRun) -> ScoringKey:
    """Return the source key of the run."""
    return ScoringKey(run.from_protocol_digest, run.from_split_revision)


def new_key(run: RescoringRun) -> ScoringKey:
    """Return the target key of the run."""
    return ScoringKey(run.to_protocol_digest, run.to_split_revision)


def shadow_key(run: RescoringRun) -> ScoringKey:
    """Return the key of the run that the public board does not show, scored in the background."""
    return old_key(run) if run.state is RunState.APPLIED else new_key(run)


class Shadow(NamedTuple):
    """The second key under which a new submission is scored, and whether that scoring is held."""

    key: ScoringKey
    is_held: bool


def phase_and_shadow(session: Session, phase_id: str) -> tuple[Phase, Shadow | None]:
    """Return a phase, reread, and its shadow while an update of it is open.

    One statement reads both: with two, a flip in between could leave a submission without one key.

    Raises:
        NotFound: There is no such phase.
    """
    found = session.execute(_PHASE_AND_TWO_SIDED_RUN, {"phase": phase_id}).first()
    if found is None:
        raise NotFound("phase", phase_id)
    phase, run = found
    if run is None:
        return phase, None
    return phase, Shadow(shadow_key(run), run.state is RunState.PAUSED)


# The protocol under which an upload was accepted: it is parsed under that one forever.


def all_accepted_under(session: Session, phase_id: str) -> dict[str, ProtocolDocument]:
    """Return the protocol of the first sheet of each submission to a phase that has one."""
    query = (  # newest first, so that the oldest row of each submission overwrites the others
        select(ScoreSheetRow.submission_id, ScoreSheetRow.protocol_digest)
        .join(Submission, Submission.id == ScoreSheetRow.submission_id)
        .where(Submission.phase_id == phase_id)
        .order_by(ScoreSheetRow.created_at.desc(), ScoreSheetRow.protocol_digest.desc())
    )
    first = {submission_id: digest for submission_id, digest in session.execute(query)}
    protocols = {digest: find_protocol(session, digest) for digest in set(first.values())}
    return {submission_id: protocols[digest] for submission_id, digest in first.items()}


def accepted_under(session: Session, submission_id: str) -> ProtocolDocument | None:
    """Return the protocol of the first sheet of a submission; None while it has none."""
    digest = session.scalars(_FIRST_PROTOCOL, {"submission": submission_id}).first()
    return None if digest is None else find_protocol(session, digest)
