"""The reconciler: whatever was lost, frozen or forgotten is set right, one pass a second.

One leader at a time rings for what is queued or expired, gives up jobs without attempts left, and
rings for boards that are wanted. It decides nothing that a claim does not check again.
"""

import os
import socket
import threading
from dataclasses import dataclass
from datetime import timedelta

import structlog
from sqlalchemy import delete, or_, update
from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.base import JobState
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.verification import due_items, mark_items_rung
from exceptiondrive_records.work.board_rings import ring_due_boards
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.jobs import set_failed
from exceptiondrive_records.work.phase_boards import tend_phases
from exceptiondrive_records.work.ringing import ring_due_jobs
from exceptiondrive_records.work.tables import Job, Leader
from exceptiondrive_schemas.jobs import Lane

# One leader at a time, by a lease in the database.


def take_lead(session: Session, name: str, holder: str, lease_s: float) -> bool:
    """Become or stay the leader; False while another holder's lease runs."""
    now = database_now(session)
    lease_until = now + timedelta(seconds=lease_s)
    insert = sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
    session.execute(
        insert(Leader).values(name=name, holder=holder, lease_until=now).on_conflict_do_nothing()
    )
    taken = session.execute(
        update(Leader)
        .where(Leader.name == name, (Leader.holder == holder) | (Leader.lease_until <= now))
        .values(holder=holder, lease_until=lease_until)
        .returning(Leader.name)
        .execution_options(synchronize_session=False)
    ).first()
    return taken is not None


def give_up_lead(session: Session, name: str, holder: str) -> None:
    """Let another lead at once."""
    session.execute(delete(Leader).where(Leader.name == name, Leader.holder == holder))


_log = structlog.get_logger("exceptiondrive.reconciler")

LEADERSHIP = "reconciler"
EXHAUSTED_CODE = "attempts_exhausted"
EXHAUSTED_MESSAGE = (
    "Scoring did not finish in any of its attempts. The organizers see this; your quota is "
    "not used up by it."
)


@dataclass(frozen=True)
class Pass:
    """What one pass did."""

    rung_jobs: int = 0
    rung_boards: int = 0
    dead_jobs: int = 0
    rescoring_jobs: int = 0
    rung_verifications: int = 0


def reconcile_once(database: Database, doorbell: Doorbell, settings: RecordsSettings) -> Pass:
    """Make one pass."""
    with database.write() as session:
        dead_jobs = give_up_exhausted(session, settings.max_attempts)
    tend_phases(database)
    rescoring_jobs = tend_runs(database)
    return Pass(
        rung_jobs=sum(ring_due_jobs(database, doorbell, settings, lane) for lane in Lane),
        rung_boards=ring_due_boards(database, doorbell, settings),
        dead_jobs=dead_jobs,
        rescoring_jobs=rescoring_jobs,
        rung_verifications=_ring_verifications(database, doorbell, settings),
    )


def run_reconciler(
    database: Database, doorbell: Doorbell, settings: RecordsSettings, stop: threading.Event
) -> None:
    """Make passes while leading, until `stop` is set; a database that is away is waited for."""
    holder = f"{socket.gethostname()}:{os.getpid()}:{random_id(6)}"
    while not stop.is_set():
        try:
            with database.write() as session:
                leads = take_lead(session, LEADERSHIP, holder, settings.leader_lease_s)
            if leads:
                done = reconcile_once(database, doorbell, settings)
                if done != Pass():
                    _log.info("reconciled", **vars(done))
        except OperationalError as error:
            _log.warning("the database did not answer", error=type(error.orig).__name__)
        stop.wait(settings.reconcile_every_s)
    with database.write() as session:
        give_up_lead(session, LEADERSHIP, holder)


def give_up_exhausted(session: Session, max_attempts: int) -> int:
    """Give up jobs whose last lease expired without an answer; return how many."""
    now = database_now(session)
    dead = session.execute(
        update(Job)
        .where(
            Job.attempts >= max_attempts,
            or_(Job.state == JobState.QUEUED, Job.lease_until < now),
            Job.state.in_((JobState.QUEUED, JobState.LEASED)),
        )
        .values(
            state=JobState.DEAD,
            fence=Job.fence + 1,
            lease_until=None,
            rung_at=None,
            finished_at=now,
        )
        .returning(Job.id, Job.submission_id, Job.is_first, Job.attempts)
        .execution_options(synchronize_session=False)
    ).all()
    for job_id, submission_id, is_first, attempts in dead:
        if is_first:
            set_failed(session, submission_id, EXHAUSTED_CODE, EXHAUSTED_MESSAGE)
        detail = {"code": EXHAUSTED_CODE, "job": job_id, "attempts": attempts}
        audit(session, "reconciler", "scoring failed", submission_id, detail)
    return len(dead)


def _ring_verifications(database: Database, doorbell: Doorbell, settings: RecordsSettings) -> int:
    with database.read() as session:
        due = due_items(session, settings.ring_again_after_s)
    rung = [item for item in due if doorbell.ring_verification(item)]
    if rung:
        with database.write() as session:
            mark_items_rung(session, rung)
    return len(rung)
