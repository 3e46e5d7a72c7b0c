"""The reconciler: once a second, it repairs whatever a crash or a lost message left undone.

One leader at a time wakes the lanes that have work, gives up jobs without attempts left, and
advances rescoring runs. Claims check its decisions again.
"""

import math
import os
import socket
import threading
import time
from dataclasses import dataclass

import structlog
from sqlalchemy.exc import OperationalError, ProgrammingError, SQLAlchemyError

from exceptiondrive_records.boards.renewal import renew_where_families_show
from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.notifications.events import POLL_EVERY_S, tell_teams
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.work.dispatch import Dispatcher, mark_queued, wake_lanes
from exceptiondrive_records.work.jobs import give_up_exhausted
from exceptiondrive_records.work.lease import give_up, give_up_lead, take_lead
from exceptiondrive_records.work.tables import Profile, Trial

_log = structlog.get_logger("exceptiondrive.reconciler")

LEADERSHIP = "reconciler"


@dataclass(frozen=True)
class Pass:
    """The results of one pass."""

    woken_for: int = 0
    """The number of due items in lanes that the broker could wake."""
    dead_jobs: int = 0
    rescoring_jobs: int = 0


def reconcile_once(database: Database, dispatcher: Dispatcher, settings: RecordsSettings) -> Pass:
    """Make one pass."""
    with database.write() as session:
        dead_jobs = give_up_exhausted(session, settings.max_attempts)
        for kind in (Profile, Trial):
            give_up(session, kind, settings.max_attempts)
    renew_where_families_show(database)
    rescoring_jobs = tend_runs(database, settings.max_attempts)
    woken_for = wake_lanes(database, dispatcher, settings)
    if woken_for:
        with database.write() as session:
            mark_queued(session)
    return Pass(woken_for, dead_jobs, rescoring_jobs)


def run_reconciler(
    database: Database, dispatcher: Dispatcher, settings: RecordsSettings, stop: threading.Event
) -> None:
    """Make passes while leading, until `stop` is set; retry after errors of the database.

    Raises:
        ProgrammingError: A right, table or column is missing: a retry would not help.
    """
    polled_at_s = -math.inf
    holder = f"{socket.gethostname()}:{os.getpid()}:{random_id(6)}"
    while not stop.is_set():
        try:
            with database.write() as session:
                leads = take_lead(session, LEADERSHIP, holder, settings.leader_lease_s)
            if leads:
                done = reconcile_once(database, dispatcher, settings)
                if time.monotonic() - polled_at_s >= POLL_EVERY_S:
                    polled_at_s = time.monotonic()
                    tell_teams(database)
                if done != Pass():
                    _log.info("reconciled", **vars(done))
        except OperationalError as error:
            _log.warning("the database did not answer", reason=sentence_of(error))
        except ProgrammingError:
            raise
        except SQLAlchemyError as error:  # e.g. a former leader was frozen, so that two lead
            _log.warning("a pass was broken off", error=type(error).__name__)
        stop.wait(settings.reconcile_every_s)
    with database.write() as session:
        give_up_lead(session, LEADERSHIP, holder)
