"""Trials, in which a worker tests the split under a run's target protocol before the run starts.

Only workers open splits; a trial reports why samples cannot be scored, and how many.
"""

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.work.lease import finish, new_item
from exceptiondrive_records.work.tables import Trial, WorkState
from exceptiondrive_schemas.api.rescoring import SplitTrial, TrialFinding
from exceptiondrive_schemas.jobs import Lane

_UNANSWERED = SplitTrial(
    state="failed", found=(TrialFinding(what="trying it did not finish in any of its attempts"),)
)


def ask_for_trial(session: Session, run: RescoringRun) -> None:
    """Request a trial of a run's split."""
    session.add(new_item(Trial, run.id, run.created_at, lane=Lane.RESCORE, run_id=run.id))


def finish_trial(session: Session, item: Trial, trial: SplitTrial) -> bool:
    """Record the outcome of a trial; return False if the lease was lost."""
    if not finish(session, item):
        return False
    session.execute(update(Trial).where(Trial.id == item.id).values(trial=trial))
    return True


def trial_of(session: Session, run_id: str) -> SplitTrial | None:
    """Return the outcome of a run's trial; None for a kind of run without one."""
    item = session.scalars(select(Trial).where(Trial.run_id == run_id)).first()
    if item is None:
        return None
    is_over = item.state is WorkState.DEAD
    return item.trial or (_UNANSWERED if is_over else SplitTrial())
