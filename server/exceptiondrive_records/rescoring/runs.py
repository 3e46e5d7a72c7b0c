"""Queries for rescoring runs; `changes` moves them from state to state."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_schemas.api.rescoring import RunKind, RunState

_OPEN = [state for state in RunState if not state.is_final]


def find_run(session: Session, run_id: str, *, lock: bool = False) -> RescoringRun:
    """Return a run.

    Raises:
        NotFound: There is none.
    """
    return find_row(session, RescoringRun, "rescoring run", run_id, lock=lock)


def list_runs(
    session: Session,
    phase_id: str | None = None,
    kind: RunKind = RunKind.UPDATE,
    *,
    only_open: bool = False,
    limit: int | None = None,
) -> list[RescoringRun]:
    """Return runs of a kind, newest first, at most `limit`.

    Raises:
        NotFound: There is no such phase.
    """
    query = select(RescoringRun).where(RescoringRun.kind == kind)
    query = query.order_by(RescoringRun.created_at.desc(), RescoringRun.id)
    if phase_id is not None:
        query = query.where(RescoringRun.phase_id == find_phase(session, phase_id).id)
    if only_open:
        query = query.where(RescoringRun.state.in_(_OPEN))
    return list(session.scalars(query.limit(limit)))
