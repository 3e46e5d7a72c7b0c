"""Trials: a worker tries the split under what a run leads to, before anything is promised.

Only workers open splits; what comes back is why it cannot be scored, and of how many samples.
"""

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.work.lease import finish, new_item
from exceptiondrive_records.work.tables import Trial, WorkState
from exceptiondrive_schemas.api.rescoring import SplitTrial, TrialFinding
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.split import SplitRef

_TRIED = select(Trial.protocol_digest, Trial.trial).where(
    Trial.split_name == bindparam("split"), Trial.protocol_digest.is_not(None)
)

_UNANSWERED = SplitTrial(
    state="failed", found=(TrialFinding(what="trying it did not finish in any of its attempts"),)
)


def ask_for_trial(session: Session, run: RescoringRun) -> None:
    """Ask a worker to try the split of a run."""
    session.add(new_item(Trial, run.id, run.created_at, lane=Lane.RESCORE, run_id=run.id))


def count_trial(session: Session, item: Trial, ref: SplitRef, protocol_digest: str) -> None:
    """Write down what is tried, before it is: a lost lease writes nothing, and tells nothing."""
    session.execute(
        update(Trial)
        .where(Trial.id == item.id, Trial.fence == item.fence)
        .values(
            protocol_digest=protocol_digest,
            split_name=ref.name,
            split_revision=ref.revision,
            phase_id=None,
        )
    )


def finish_trial(session: Session, item: Trial, trial: SplitTrial) -> bool:
    """Record what came of a trial; False when the lease was lost."""
    if not finish(session, item):
        return False
    session.execute(update(Trial).where(Trial.id == item.id).values(trial=trial))
    return True


def trial_of(session: Session, run_id: str) -> SplitTrial | None:
    """Return what a worker said of the split of a run; None: it is not asked of this kind of run."""
    item = session.scalars(select(Trial).where(Trial.run_id == run_id)).first()
    if item is None:
        return None
    is_over = item.state is WorkState.DEAD
    return item.trial or (_UNANSWERED if is_over else SplitTrial())


def tried_protocols(session: Session, split_name: str) -> set[str]:
    """Return the digests of the protocols under which trials told of a split, or are about to.

    What workers wrote down counts, which no other role of the database may change.
    """
    return {
        digest
        for digest, trial in session.execute(_TRIED, {"split": split_name})
        if digest is not None and (trial is None or trial.state in ("fits", "refused"))
    }
