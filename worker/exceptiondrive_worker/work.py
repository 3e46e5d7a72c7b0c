"""A woken worker processes its lane until nothing is left for it.

A worker that finds a newer scorer among the workers refuses to work: two versions must never make
sheets at the same time. Workers that stop cleanly leave the list, so that an organizer can go back
to an older release on purpose.
"""

import time

import structlog
from sqlalchemy.orm import Session

from exceptiondrive_records.work.dispatch import kinds_due, wake_lanes
from exceptiondrive_records.work.fair_share import is_live_work_open
from exceptiondrive_records.work.tables import BoardRequest, Job, Profile, Recheck, Trial
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.boards.run import build_next_board
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.profile_run import describe_next
from exceptiondrive_worker.scorer_version import OlderScorerError, refuse_if_older
from exceptiondrive_worker.scoring_run import score_next
from exceptiondrive_worker.trial_run import try_next_split
from exceptiondrive_worker.verify_run import verify_next

_PART_OF_LIMIT = 0.02
"""Celery's time limits count from the message. After this part of the soft limit no new work is
begun: the lane is woken again instead."""
_MOST_PATIENCE_S = 1.0
"""Upper bound of the wait, so that a rescoring run goes on slowly during much live work."""
_POLL_EVERY_S = 0.02

_log = structlog.get_logger("exceptiondrive.worker")


def may_work(session: Session) -> bool:
    """Whether no newer scorer has joined since this worker began; otherwise that is logged."""
    try:
        refuse_if_older(session)
    except OlderScorerError as error:
        _log.error("scorer version mismatch: the job is left to newer workers", reason=str(error))
        return False
    return True


def work(context: WorkerContext, lane: Lane) -> int:
    """Do what waits in a lane, one item after the other; return their number.

    A worker that has done something wakes others for what is left, and for what became due by it.
    One that found nothing wakes nobody: two workers could wake each other without end.
    """
    until = time.monotonic() + _PART_OF_LIMIT * context.settings.soft_time_limit_s
    n_done = 0
    while time.monotonic() < until and _do_next(context, lane):
        n_done += 1
    if n_done:
        wake_lanes(context.database, context.dispatcher, context.settings)
    return n_done


def _do_next(context: WorkerContext, lane: Lane) -> bool:
    """Do the next item of a lane. Due boards come first: their pace limits their share.

    Profiles of files come last: no score waits for them.
    """
    if lane is Lane.RESCORE:
        if Lane.LIVE in context.lanes and _do_next(context, Lane.LIVE):
            return True
        let_live_work_pass(context)
    with context.database.read() as session:
        if not may_work(session):
            return False
        due = kinds_due(session, lane, context.settings.max_attempts)
    return (
        (Trial in due and try_next_split(context))
        or (BoardRequest in due and build_next_board(context, lane))
        or (Job in due and score_next(context, lane))
        or (Recheck in due and verify_next(context))
        or (Profile in due and describe_next(context))
    )


def let_live_work_pass(context: WorkerContext) -> None:
    """Delay background work briefly while other workers have live work.

    All of them write to one database, one after the other. A worker that also serves the live lane
    does not wait: the live work may be waiting for it.
    """
    until = time.monotonic() + (0 if Lane.LIVE in context.lanes else _MOST_PATIENCE_S)
    while time.monotonic() < until:
        with context.database.read() as session:
            if not is_live_work_open(session):
                return
        time.sleep(_POLL_EVERY_S)
