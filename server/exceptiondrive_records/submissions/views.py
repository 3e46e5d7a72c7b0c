"""Read model of submissions as their team sees them, with queue position, score sheet and rank."""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from functools import cached_property
from statistics import median

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import entries_on, entry_ids
from exceptiondrive_records.boards.standings import replacements
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.entries.selection import publishable, rules_of
from exceptiondrive_records.phases.disqualified import disqualified_since
from exceptiondrive_records.phases.policy import (
    can_publish,
    deadline_of,
    frozen_since,
    has_revealed,
    is_late,
    is_published,
    is_split_revealed,
    pseudonym_of_team,
    score_kept_back_since,
    shown_sheet,
    shows_pseudonyms,
)
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.submissions import (
    LONGEST_UPLOAD,
    arrival,
    takes_confirmation,
)
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.board_requests import is_board_wanted
from exceptiondrive_records.work.fair_share import jobs_ahead
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.profiles import profiles_coming
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.submission import (
    Failure,
    QueuePlace,
    SubmissionView,
)
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import Links, MethodFacts
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.score_sheet import HEADLINE, ScoreSheet

_RECENT = 20
_RECENT_RUNS = (
    select(Job.leased_at, Job.finished_at)
    .where(Job.lane == Lane.LIVE, Job.state == WorkState.DONE, Job.finished_at.is_not(None))
    .order_by(Job.finished_at.desc())
    .limit(_RECENT)
)
_FIRST_JOBS = select(Job).where(
    Job.submission_id.in_(bindparam("submissions", expanding=True)), Job.is_first
)
_TEAMS = select(Team).where(Team.id.in_(bindparam("teams", expanding=True)))
_PHASES = select(Phase).where(Phase.id.in_(bindparam("phases", expanding=True)))
_SHEETS = select(ScoreSheetRow).where(
    ScoreSheetRow.submission_id.in_(bindparam("submissions", expanding=True)),
    ScoreSheetRow.protocol_digest == bindparam("protocol"),
    ScoreSheetRow.split_revision == bindparam("revision"),
)


def view(session: Session, submission: Submission, *, is_duplicate: bool = False) -> SubmissionView:
    """Return a submission as its team sees it.

    `is_duplicate`: the same bytes were sent again.
    """
    (seen,) = views(session, [submission])
    return seen.model_copy(update={"is_duplicate": True}) if is_duplicate else seen


def views(session: Session, submissions: Sequence[Submission]) -> tuple[SubmissionView, ...]:
    """Return submissions as their teams see them, with one query of each kind per phase."""
    now = database_now(session)
    teams = session.scalars(_TEAMS, {"teams": list({each.team_id for each in submissions})})
    team_of = {team.id: team for team in teams}
    phases = session.scalars(_PHASES, {"phases": list({each.phase_id for each in submissions})})
    seen_in = {
        phase.id: _Seen(
            session, phase, [each for each in submissions if each.phase_id == phase.id], now
        )
        for phase in phases
    }
    disqualified = disqualified_since(session, submissions)
    places = queue_places(session, submissions, now)
    told = [each.id for each in submissions if each.is_scored and each.report is None]
    awaited = profiles_coming(session, told) if told else set()
    return tuple(
        _view(
            each,
            team_of[each.team_id],
            seen_in[each.phase_id],
            queue=places.get(each.id),
            disqualified_at=disqualified.get(each.id),
            awaits_profile=each.id in awaited,
        )
        for each in submissions
    )


class _Seen:
    """Data about submissions to one phase, each queried for all of them on first use."""

    def __init__(
        self, session: Session, phase: Phase, submissions: Sequence[Submission], now: datetime
    ) -> None:
        self._session, self._submissions = session, submissions
        self.phase, self.now = phase, now

    @cached_property
    def entries(self) -> Mapping[str, BoardEntry]:
        """The entries of the current board."""
        return entries_on(self._session, self.phase.current_board_id)

    @cached_property
    def sheets(self) -> Mapping[str, ScoreSheet]:
        """The sheets, except of scores that are kept back."""
        told = [each for each in self._submissions if each.is_scored and not self.hides(each)]
        return published_sheets(self._session, self.phase, {each.id for each in told}, self.now)

    @cached_property
    def headline(self) -> Average:
        """The average that ranks under the protocol of the sheets."""
        return find_protocol(self._session, self.phase.protocol_digest).grading.headline

    @cached_property
    def replaced_by(self) -> Mapping[str, Submission]:
        """See `replacements`."""
        return replacements(self._session, self.phase, self._submissions, self.now)

    @cached_property
    def rules(self) -> Mapping[str, tuple[RunRule, bool]]:
        """See `rules_of`."""
        return rules_of(self._session, self.phase, self._submissions)

    @cached_property
    def is_frozen(self) -> bool:
        """Whether the board is frozen, so that new entries are shown only after its reveal."""
        return frozen_since(self.phase, self.now) is not None

    @cached_property
    def is_board_coming(self) -> bool:
        """Whether a board with new entries is coming, or was shown since the phase was read."""
        if self.is_frozen:
            return False
        shown = select(Phase.current_board_id).where(Phase.id == self.phase.id)
        return (
            is_board_wanted(self._session, self.phase.id, *key_of_phase(self.phase))
            or self._session.scalar(shown) != self.phase.current_board_id
        )

    @cached_property
    def shows_pseudonyms(self) -> bool:
        """See `shows_pseudonyms`."""
        return shows_pseudonyms(self._session, self.phase)

    @cached_property
    def can_publish(self) -> bool:
        """See `can_publish`."""
        return can_publish(self._session, self.phase)

    @cached_property
    def publishable(self) -> Collection[str]:
        """See `publishable`."""
        private = [
            each
            for each in self._submissions
            if each.is_scored and not is_published(self.phase, each)
        ]
        if not private or not self.can_publish:
            return ()
        return publishable(self._session, self.phase, private)

    def hides(self, submission: Submission) -> datetime | None:
        """Return since when a score is kept back; None if it is not."""
        return score_kept_back_since(self.phase, submission, self.now)

    def can_be_confirmed(self, submission: Submission) -> bool:
        """Whether its team may still confirm it, and the phase would accept that."""
        return submission.can_be_confirmed(self.now) and takes_confirmation(
            self._session, self.phase, submission, self.now
        )

    def report_of(self, asked: Submission) -> CheckReport | None:
        """Return the report of an upload to be confirmed, with the consequences of its deadline."""
        report, ends, until = asked.report, deadline_of(self.phase, asked), asked.confirm_until
        if report is None or ends is None or until is None:
            return report
        came = asked.arrived_at or asked.received_at
        judged = came + LONGEST_UPLOAD
        if arrival(self._session, self.phase, asked.arrived_at, self.now) >= ends:
            words = "The deadline has passed: confirmed now, it stands on the late view alone."
        elif judged > ends and not has_revealed(self._session, self.phase, came):
            words = (
                f"It is in time where it is confirmed before {judged:%Y-%m-%d %H:%M} UTC, a quarter of an "
                "hour after its first byte."
            )
        elif ends < until:
            words = f"It is in time where it is confirmed before the deadline, {ends:%Y-%m-%d %H:%M} UTC."
        else:
            return report
        return report.model_copy(update={"to_confirm": (*report.to_confirm, words)})


def _view(
    submission: Submission,
    team: Team,
    seen: _Seen,
    *,
    queue: QueuePlace | None,
    disqualified_at: datetime | None,
    awaits_profile: bool,
) -> SubmissionView:
    phase, is_scored = seen.phase, submission.is_scored
    can_be_confirmed = disqualified_at is None and seen.can_be_confirmed(submission)
    shown = seen.entries.get(submission.id) if is_scored else None
    holder = seen.replaced_by.get(submission.id)
    run_rule, is_chosen = seen.rules.get(submission.id, ("newest", False))
    is_public = is_published(phase, submission)
    is_to_come = (
        is_scored
        and shown is None
        and holder is None
        and is_public
        and disqualified_at is None
        and not is_late(phase, submission)
    )
    unranked_because = shown.unranked_because if shown and is_public else None
    if is_to_come and seen.is_frozen and not seen.hides(submission):
        unranked_because = "the board is frozen, and shows it when the organizers reveal the board"
    elif is_scored and not is_public and submission.id not in seen.publishable:
        since = "at the deadline" if seen.can_publish else "when hidden scores were revealed"
        unranked_because = f"it was private {since}, and stays so"
    elif holder is not None and not holder.is_scored:
        unranked_because = (
            f"{holder.id} stood in its place at the deadline and was withdrawn later: the place "
            "stays empty"
        )
    sheet = seen.sheets.get(submission.id) if is_scored else None
    return SubmissionView(
        id=submission.id,
        phase=phase.id,
        challenge=phase.challenge,
        team=team.name,
        method=submission.method,
        description=submission.description,
        links=Links(paper=submission.paper_url, code=submission.code_url),
        facts=submission.facts or MethodFacts(),
        edited_at=submission.edited_at,
        linked_to=submission.linked_to,
        reminder_effect=shown.reminder_effect if shown else None,
        no_effect_because=_no_effect_because(submission, shown, seen),
        file_digest=submission.file_digest,
        size_bytes=submission.size_bytes,
        status=submission.status,
        received_at=submission.received_at,
        status_at=submission.status_at,
        queue=queue,
        report=seen.report_of(submission) if can_be_confirmed else submission.report,
        failure=_failure(submission),
        sheet=sheet,
        headline=HEADLINE if sheet is None else seen.headline,
        rank=shown.rank if shown else None,
        rank_interval=shown.rank_interval if shown else None,
        intervals=shown.intervals if shown else {},
        unranked_because=unranked_because,
        awaits_board=is_to_come and seen.is_board_coming,
        awaits_profile=awaits_profile,
        confirm_until=submission.confirm_until if can_be_confirmed else None,
        confirmed_as=submission.confirmed_as,
        is_late=is_late(phase, submission),
        replaced_by=holder.id if holder is not None and holder.is_scored else None,
        is_chosen=is_chosen,
        run_rule=run_rule,
        is_published=is_public,
        score_kept_back_since=seen.hides(submission),
        disqualified_at=disqualified_at,
        known_as=pseudonym_of_team(phase, team.id)
        if seen.shows_pseudonyms and not team.is_reference
        else None,
    )


def _no_effect_because(submission: Submission, shown: BoardEntry | None, seen: _Seen) -> str | None:
    if submission.linked_to is None or shown is None or shown.reminder_effect is not None:
        return None
    if submission.linked_to in seen.entries:
        return "that one has reminder records of its own"
    return "that one is no entry of the board"


def queue_places(
    session: Session, submissions: Sequence[Submission], now: datetime
) -> dict[str, QueuePlace]:
    """Return, by submission, how many live jobs come first in fair order, and the expected wait.

    Submissions that have ended are left out.
    """
    waiting = [each.id for each in submissions if not each.status.is_terminal]
    if not waiting:
        return {}
    found = session.scalars(_FIRST_JOBS, {"submissions": waiting})
    jobs = [job for job in found if not job.state.is_final]
    queued = [job for job in jobs if job.state is not WorkState.LEASED]
    ahead = jobs_ahead(session, queued) if queued else {}
    name_of = {each.id: session.get_one(Phase, each.phase_id).split_name for each in submissions}
    split_of = {job.id: (name_of[job.submission_id], job.split_revision) for job in jobs}
    alive = {each: live_workers(session, Lane.LIVE, each) for each in set(split_of.values())}
    scoring_s = recent_scoring_s(session)
    places = {}
    for job in jobs:
        workers, position = alive[split_of[job.id]], ahead.get(job.id, 0)
        places[job.submission_id] = QueuePlace(
            position=position,
            expected_wait_s=_expected_wait_s(scoring_s, position, workers),
            attempts=job.attempts,
            workers_alive=workers,
            lease_until=_lease_until(job, now),
        )
    return places


def published_sheets(
    session: Session, phase: Phase, submission_ids: set[str], now: datetime
) -> dict[str, ScoreSheet]:
    """Return by submission the sheets under the key that the phase shows, as they may be shown.

    After a reveal of the split only entries of the board have one: otherwise a team would learn
    which of its submissions is the best on the private part.
    """
    board_id = phase.current_board_id
    if submission_ids and is_split_revealed(session, phase):
        final = set() if board_id is None else entry_ids(session, board_id)
        submission_ids = submission_ids & final
    if not submission_ids:
        return {}
    shown = {"protocol": phase.protocol_digest, "revision": phase.split_revision}
    rows = session.scalars(_SHEETS, {"submissions": list(submission_ids), **shown})
    return {row.submission_id: shown_sheet(phase, row, now) for row in rows}


def recent_scoring_s(session: Session) -> float | None:
    """Return the median duration of the last live scoring runs, measured by the database's clock."""
    durations_s = [
        (finished_at - leased_at).total_seconds()
        for leased_at, finished_at in session.execute(_RECENT_RUNS)
        if leased_at is not None and finished_at is not None
    ]
    return median(durations_s) if durations_s else None


def _expected_wait_s(scoring_s: float | None, position: int, alive: int) -> float | None:
    """Estimate the time until a worker is free: `position` jobs come first, on parallel workers."""
    if scoring_s is None or alive == 0:
        return None
    return round(max(0, position - alive + 1) * scoring_s / alive, 1)


def _lease_until(job: Job, now: datetime) -> datetime | None:
    is_held = (
        job.state is WorkState.LEASED and job.lease_until is not None and job.lease_until > now
    )
    return job.lease_until if is_held else None


def _failure(submission: Submission) -> Failure | None:
    if submission.failure_code is None:
        return None
    return Failure(code=submission.failure_code, message=submission.failure_message or "")
