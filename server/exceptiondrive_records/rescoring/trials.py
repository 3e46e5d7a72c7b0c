"""Trials: a worker tries the split under what a run leads to, before anything is promised.

Only workers open splits; what comes back is why it cannot be scored, and of how many samples.
"""

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.work.lease import claim, finish, is_claimable, new_item
from exceptiondrive_records.work.tables import Trial
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.rescoring import SplitTrial

MAX_ATTEMPTS = 4


def ask_for_trial(session: Session, run: RescoringRun) -> None:
    """Ask a worker to try the split of a run."""
    session.add(new_item(Trial, run.id, run.created_at, lane=Lane.RESCORE, run_id=run.id))


def claim_trial(session: Session, lease_s: float) -> Trial | None:
    """Lease the split that is to be tried next; None: nothing is free."""
    now = database_now(session)
    first = (
        select(Trial.id)
        .where(is_claimable(Trial, now), Trial.attempts < MAX_ATTEMPTS)
        .order_by(Trial.created_at, Trial.id)
    )
    return claim(session, Trial, first, lease_s)


def finish_trial(session: Session, item: Trial, trial: SplitTrial) -> bool:
    """Record what came of a trial; False when the lease was lost."""
    if not finish(session, item):
        return False
    session.execute(update(Trial).where(Trial.id == item.id).values(trial=trial))
    return True


def trial_of(session: Session, run_id: str) -> SplitTrial | None:
    """Return what a worker said of the split of a run; None: it is not asked of this kind of run."""
    item = session.scalars(select(Trial).where(Trial.run_id == run_id)).first()
    return None if item is None else item.trial or SplitTrial()


def tried_protocols(session: Session, split_name: str) -> set[str]:
    """Return the digests of the protocols under which something was told of a split by trials."""
    query = (
        select(RescoringRun.to_protocol_digest, Trial.trial)
        .join(Trial, Trial.run_id == RescoringRun.id)
        .join(Phase, Phase.id == RescoringRun.phase_id)
        .where(Phase.split_name == split_name, Trial.trial.is_not(None))
    )
    return {
        digest
        for digest, trial in session.execute(query)
        if trial is not None and trial.state in ("fits", "refused")
    }
