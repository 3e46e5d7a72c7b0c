"""Find problems that raise no error, for the overview, the doctor and the metrics.

Each check takes few queries, and reveals nothing about a split but its name and revision.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import and_, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import last_action
from exceptiondrive_records.db.clock import NOW, SET_BACK, database_now
from exceptiondrive_records.notifications.tables import Channel, ContactPoint, Delivery
from exceptiondrive_records.operations.dump import BACKUP, BACKUP_FAILED, BACKUP_WRITTEN
from exceptiondrive_records.operations.garbage import orphans_were_left
from exceptiondrive_records.operations.reconciler import LEADERSHIP
from exceptiondrive_records.phases.phases import list_phases, not_checked
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.splits import whole_split
from exceptiondrive_records.work.heartbeats import live_workers, missing_splits
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Leader, WorkState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import counted

BEGUN_IN_VAIN = 2
"""A board or mail begun so often remained unfinished at least once."""
_MAIL_OF = timedelta(days=1)
"""Mails last tried longer ago are no longer reported."""


@dataclass(frozen=True)
class Trouble:
    """A problem that raises no error.

    Attributes:
        code: Stable name, for metrics and alerts.
        subject: The affected lane, split (or `split@revision`), phase, or other part.
        what: A sentence.
        do: What an operator or organizer can do about it.
        stops_scoring: Whether something cannot be scored until that is done.
    """

    code: str
    subject: str
    what: str
    do: str
    stops_scoring: bool = False


def troubles(session: Session) -> tuple[Trouble, ...]:
    """Return all problems, those that stop scoring first."""
    return (
        *_lanes(session),
        *_splits(session),
        *_reconciler(session),
        *_boards(session),
        *_phases(session, list_phases(session, with_hidden=True)),
        *_mail(session),
        *_store(session),
        *_backup(session),
    )


def troubles_of(session: Session, phase: Phase) -> tuple[Trouble, ...]:
    """Return the problems of a phase and of its split. A phase may have the same id as a split."""
    return (
        *(one for one in _splits(session) if one.subject.split("@")[0] == phase.split_name),
        *(one for one in _boards(session) if one.subject == phase.id),
        *_phases(session, [phase]),
    )


def _lanes(session: Session) -> Iterator[Trouble]:
    idle = [lane for lane in Lane if live_workers(session, lane) == 0]
    if idle == list(Lane):
        yield Trouble(
            "lane_without_worker",
            Lane.LIVE,
            "No worker is alive: nothing is scored. Nothing is lost meanwhile.",
            "start one: exceptiondrive-worker run; if one is running, its log says what stops it",
            stops_scoring=True,
        )
        return
    for lane in idle:
        what = "nothing new is scored" if lane is Lane.LIVE else "rescoring and verification wait"
        yield Trouble(
            "lane_without_worker",
            lane,
            f"No living worker serves the lane {lane}: {what}.",
            f"start one that does: exceptiondrive-worker run --lanes {lane}",
            stops_scoring=lane is Lane.LIVE,
        )


def _splits(session: Session) -> Iterator[Trouble]:
    for split, waits in missing_splits(session).items():
        name, _, revision = split.partition("@")
        uses = select(Phase.id).where(Phase.split_name == name, Phase.split_revision == revision)
        is_shown = not revision or session.scalar(uses.limit(1)) is not None
        who = "Workers" if waits else "Some workers"
        its = "its submissions" if is_shown else "sheets of a rescoring"
        at = f" at the revision {revision}" if revision else ""
        yield Trouble(
            "split_without_file",
            split,
            f"{who} cannot use split {name}{at}: "
            f"{f'{its} wait' if waits else f'the others alone score {its}'}.",
            f"put it back as {name}/split.json.gz in the workers' folder of splits; the folder has "
            "the name of the split. If it is there, floors.toml beside it cannot be read: the workers' "
            "log says why. What waits is then scored without further action",
            stops_scoring=waits and is_shown,
        )


def _reconciler(session: Session) -> Iterator[Trouble]:
    is_held = and_(Leader.lease_until > NOW, Leader.leased_at < SET_BACK)
    if session.scalar(select(Leader.id).where(Leader.key == LEADERSHIP, is_held)) is None:
        yield Trouble(
            "no_reconciler",
            "reconciler",
            "No reconciler leads: webhooks, mail and rescoring wait, and lost work is not found again.",
            "start one: exceptiondrive-server reconcile",
        )


def _boards(session: Session) -> Iterator[Trouble]:
    """Find unfinished boards: a failed build keeps its lease, and is retried when that expires."""
    in_vain = (BoardRequest.state.in_(OPEN_STATES), BoardRequest.attempts >= BEGUN_IN_VAIN)
    times = func.max(BoardRequest.attempts)
    query = select(Phase, times).join(BoardRequest, BoardRequest.phase_id == Phase.id)
    for phase, n_times in session.execute(query.where(*in_vain).group_by(Phase.id)):
        seen = (
            "there is none yet" if phase.current_board_id is None else "readers see the one before"
        )
        yield Trouble(
            "board_not_built",
            phase.id,
            f"A new board of phase {phase.title} ({phase.id}) was started {n_times} times and never "
            f"finished: {seen}.",
            "the workers' log says why, at job=board: docs/operating.md has its codes",
        )


def _phases(session: Session, phases: Sequence[Phase]) -> Iterator[Trouble]:
    without_drives: dict[str, list[str]] = {}
    for phase in phases:
        if phase.visibility == "archived":
            continue
        whole = whole_split(session, phase.split_name, phase.split_revision)
        if not_checked(phase.challenge, whole):
            without_drives.setdefault(whole.name, []).append(f"{phase.title} ({phase.id})")
        if phase.shows_reported and whole.public_file_digest is None:
            yield Trouble(
                "reported_beside_other_split",
                phase.id,
                f"Phase {phase.title} ({phase.id}) links to the paper's results, which were measured on the "
                f"paper's samples, not on split {phase.split_name}.",
                f"exceptiondrive organizer phases update {phase.id} --no-shows-reported",
            )
    for split, names in without_drives.items():
        yield Trouble(
            "no_recorded_drives",
            split,
            f"Split {split} of {'phase' if len(names) == 1 else 'phases'} {', '.join(names)} has no recorded "
            "drives: source trajectories are compared with nothing, and a file at a wrong time step may lead.",
            "add them (exceptiondrive-worker add-drives, then add-split), and rescore: docs/organizing.md",
        )


def _mail(session: Session) -> Iterator[Trouble]:
    """Report failed mails if no mail was sent since; one failing address is its team's concern."""
    since = database_now(session) - _MAIL_OF
    mails = select(Delivery).join(ContactPoint).where(ContactPoint.channel == Channel.EMAIL)
    last_sent_at = session.scalar(
        mails.with_only_columns(func.max(Delivery.finished_at)).where(
            Delivery.state == WorkState.DONE, Delivery.finished_at > since
        )
    )
    in_vain = mails.with_only_columns(
        func.count(Delivery.id), func.count(ContactPoint.id.distinct())
    ).where(
        Delivery.state.in_((*OPEN_STATES, WorkState.FAILED)),
        Delivery.attempts >= BEGUN_IN_VAIN,
        Delivery.leased_at > since,
        Delivery.created_at > (last_sent_at or since),
    )
    n_mails, n_addresses = session.execute(in_vain).one()
    if n_mails:
        yield Trouble(
            "mail_not_sent",
            "mail",
            f"Mail may not be going out: {counted(n_mails, 'message')} to "
            f"{counted(n_addresses, 'address', 'addresses')} failed, and none has been sent since. "
            "The log of exceptiondrive-server reconcile says why. Teams find everything in their notices.",
            "fix what the log says at 'not delivered'; docs/rescoring.md has the settings of mail. "
            "Waiting messages are then sent without further action",
        )


def _store(session: Session) -> Iterator[Trouble]:
    if orphans_were_left(session):
        yield Trouble(
            "files_without_record",
            "file store",
            "The file store holds more files without a record than crashes leave behind: the database may be "
            "older than the uploads, or another one. None was removed.",
            "put the newest database back; if this is it, remove them: exceptiondrive-server sweep "
            "--older-than-hours 1",
        )


def _backup(session: Session) -> Iterator[Trouble]:
    if last_action(session, BACKUP, BACKUP_WRITTEN, BACKUP_FAILED) == BACKUP_FAILED:
        yield Trouble(
            "backup_failed",
            BACKUP,
            "The last backup was not written.",
            "run exceptiondrive-server backup again: it says why",
        )
