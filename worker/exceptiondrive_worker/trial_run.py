"""The trial run: check whether a split can be scored under the target of a rescoring run.

Results are the reasons, for a public split with the number of affected samples; on a withheld split
such counts would reveal regions. Floors of a withheld split are checked first, and a trial counts
among the protocols that they allow.
"""

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.trials import finish_trial
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.work.tables import Trial
from exceptiondrive_schemas.api.rescoring import SplitTrial, TrialFinding
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.failures import Failure, run_job
from exceptiondrive_worker.splits.faults import SplitFault, SplitRefusedError
from exceptiondrive_worker.splits.floors import FloorHeldError
from exceptiondrive_worker.splits.floors_held import open_split


def try_next_split(context: WorkerContext) -> bool:
    """Try the next split; return whether there was one."""
    item = context.claim_oldest(Trial)
    if item is None:
        return False

    def failed(failure: Failure) -> None:
        finding = TrialFinding(what=f"{failure.message} ({failure.code.value})")
        _record(context, item, SplitTrial(state="failed", found=(finding,)))

    run_job(item.id, lambda: _record(context, item, _try_split(context, item)), failed)
    return True


def _try_split(context: WorkerContext, item: Trial) -> SplitTrial:
    with context.database.read() as session:
        run = find_run(session, item.run_id)
        phase = session.get_one(Phase, run.phase_id)
        protocol = find_protocol(session, run.to_protocol_digest)
        ref = SplitRef(name=phase.split_name, revision=run.to_split_revision)
        is_public = find_public_split(session, ref) is not None
    try:
        open_split(context, ref, protocol, phase_id=phase.id, is_public=is_public)
    except FloorHeldError as held:
        asked = tuple(TrialFinding(what=words) for words in held.asked)
        return SplitTrial(state="held", found=asked)
    except SplitRefusedError as refused:
        return SplitTrial(
            state="refused",
            found=tuple(_finding(fault, is_public=is_public) for fault in refused.faults),
        )
    return SplitTrial(state="fits")


def _finding(fault: SplitFault, *, is_public: bool) -> TrialFinding:
    if is_public:
        return TrialFinding(what=fault.what, n=len(fault.sample_ids))
    return TrialFinding(what=f"some {fault.what}")


def _record(context: WorkerContext, item: Trial, trial: SplitTrial) -> None:
    with context.database.write() as session:
        finish_trial(session, item, trial)
