"""Faults of scoring itself: an older scorer among the workers, and submissions without a score."""

import json
import time

from sqlalchemy import select
from tests.chaos.clients import planning_file
from tests.chaos.run import Run
from tests.chaos.saboteur import SCORER
from tests.chaos.topology import PHASE

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.api.submission import SubmissionStatus

_OLDER = "0"
_REFUSAL = "upgrade this worker"


def older_scorer(run: Run) -> str:
    """A worker of an older release joins when the newer ones have just died."""
    current = run.topology.worker
    current.hold_down()
    older = run.topology.add_worker(environment={SCORER: _OLDER})
    calls = [run.upload(), run.upload("beta")]
    run.topology.wait_until(lambda: older.exit_codes, "the older worker to refuse")
    time.sleep(1)
    untouched = [run.job_of(call).attempts for call in calls]
    run.topology.remove_worker(older)
    current.start()
    run.settle()
    with run.topology.database.read() as session:
        versions = set(session.scalars(select(ScoreSheetRow.scorer_version)))
    assert _REFUSAL in older.log.read_text(), "nobody is told what to do"
    assert untouched == [0, 0], f"an older scorer took a job: {untouched}"
    assert _OLDER not in versions, f"sheets of several scorers: {versions}"
    assert all(run.status_of(call) is SubmissionStatus.SCORED for call in calls)
    return f"it refused to start {len(older.exit_codes)} times, every sheet is of the newer scorer"


def no_score(run: Run) -> str:
    """One submission fails, another answers nothing: neither ever has a rank."""
    failed = run.upload(order="kill")
    run.clients.stream(4)
    run.settle()
    silent = run.clients.submit(_nothing_answered(run), "beta")  # the newest of its method
    run.settle()
    with run.topology.database.read() as session:
        board = current_board(session, PHASE)
        assert board is not None
        entries = json.loads(board.body)["entries"]
    rows = {entry["submission_id"]: entry for entry in entries if entry["submission_id"]}
    ranks = [entry["rank"] for entry in entries if entry["source"] == "scored"]
    assert run.status_of(failed) is SubmissionStatus.FAILED
    assert failed.submission_id not in rows, "a failed submission stands on the board"
    assert run.status_of(silent) is SubmissionStatus.SCORED
    entry = rows[silent.submission_id]
    assert entry["rank"] is None, f"rank {entry['rank']} without an answer"
    assert entry["unranked_because"], "nobody is told why"
    assert None not in ranks[: sum(rank is not None for rank in ranks)], "unranked among the ranked"
    return f"failed: not on the board; nothing answered: unranked ({entry['unranked_because']})"


def _nothing_answered(run: Run) -> bytes:
    document = json.loads(planning_file(run.topology.sample_ids, 1.0))
    for prediction in document["predictions"]:
        prediction["edited"] = None
    return json.dumps(document).encode()
