"""Which scored submissions a board lists, and what it may show of each."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ColumnElement, exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.best_run import best_run
from exceptiondrive_records.boards.documents import Sharing
from exceptiondrive_records.phases.disqualified import disqualified_ids
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.policy import (
    is_anonymous,
    is_late,
    is_published,
    is_split_revealed,
    pseudonym_of_method,
    pseudonym_of_team,
    score_kept_back_since,
)
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    all_accepted_under,
    is_of_key,
    key_of_phase,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.phase_settings import BoardView
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import REMINDER, ScoreSheet

_NEVER = datetime(1, 1, 1, tzinfo=UTC)
_SHEETS_AT_ONCE = 200
_ON_NO_ROW: Mapping[str, Any] = {"tasks": {}, "clearance_curve": None}
"""The large parts of a sheet that no board shows; most of its further rows are left out too."""


@dataclass(frozen=True)
class EntryRecord:
    """The data of one entry that a board needs; names are pseudonyms in an anonymous phase."""

    submission_id: str
    team: str
    team_slug: str
    is_reference: bool
    method: str
    description: str
    links: Links
    submitted_at: datetime
    file_digest: str
    sheet: ScoreSheet
    """Without tasks, curve and further rows but reminder records; `whole_sheets` reads the rest."""
    measurement_key: str
    accepted_under: ProtocolDocument
    """The protocol whose bounds its file passed."""
    linked_to: str | None = None
    """The team's submission of the same agent without reminder; it need not be on the board."""
    is_late: bool = False


@dataclass(frozen=True)
class _Scored:
    """A scored submission with its team and the key of its measurements."""

    submission: Submission
    team: Team
    measurement_key: str


_Picker = Callable[[Sequence[_Scored]], _Scored]


def entries_for_board(
    session: Session,
    phase_id: str,
    protocol_digest: str,
    split_revision: str | None = None,
    view: BoardView = "main",
) -> list[EntryRecord]:
    """Return the entries of a board, in order of submission.

    For each (team, method) that is the latest scored public submission in time, or the one that the
    team chose if the phase lets it; some phases show one entry of each team. The late view adds the
    latest late ones. If the latest submission is withdrawn before the deadline, the method falls
    back to the one before; if later, the method has no entry, so that nobody picks after seeing the
    outcome. A disqualified entry leaves its place empty: the one that it replaced does not return.
    All were scored against `split_revision`, by default the one that the phase shows.

    Raises:
        NotFound: No such phase.
    """
    phase = find_phase(session, phase_id)
    key = ScoringKey(protocol_digest, split_revision or phase.split_revision)
    scored = _scored_under(session, phase, key)
    due = _entries_due(session, phase, scored, view, key)
    sheets = _sheets(session, [each.submission.id for each in due], key)
    accepted = all_accepted_under(session, phase.id)
    return [_entry(phase, each, sheets, accepted) for each in due]


def entry_ids_for_board(session: Session, phase_id: str, key: ScoringKey) -> set[str]:
    """Return the submissions of `entries_for_board`, without reading a sheet."""
    phase = session.get_one(Phase, phase_id)
    scored = _scored_under(session, phase, key)
    return {each.submission.id for each in _entries_due(session, phase, scored, "main", key)}


def names_of(session: Session, submission_ids: list[str]) -> dict[str, tuple[str, str]]:
    """Return the real team and method of entries, by submission, for organizers only."""
    query = (
        select(Submission.id, Team.name, Submission.method)
        .join(Team, Team.id == Submission.team_id)
        .where(Submission.id.in_(submission_ids))
    )
    return {name: (team, method) for name, team, method in session.execute(query)}


def replacements(
    session: Session, phase: Phase, submissions: Sequence[Submission], now: datetime
) -> dict[str, Submission]:
    """Return which submission counts instead of each of these scored ones of the same team.

    That is another run of the method, or the team's one entry if the phase shows one of each; those
    that count themselves, or are no entries, are left out. One withdrawn after the deadline keeps
    its place, and leaves it empty. Late ones are separate. Those whose score is kept back are
    ignored: which of two submissions counts would reveal the better one.
    """

    def counts(each: Submission) -> bool:
        is_told = score_kept_back_since(phase, each, now) is None
        return is_told and is_published(phase, each)

    asked = [each for each in submissions if each.is_scored and counts(each)]
    if not asked:
        return {}
    is_one_each = phase.policy.entries_shown == "chosen"
    query = (
        select(Submission, Team)
        .join(Team, Team.id == Submission.team_id)
        .where(
            Submission.phase_id == phase.id,
            Submission.team_id.in_({each.team_id for each in asked}),
            stood_at_deadline(phase),
            *([] if is_one_each else [Submission.method.in_({each.method for each in asked})]),
        )
        .order_by(Submission.received_at, Submission.id)
    )
    runs_at: dict[tuple[bool, int, str], list[_Scored]] = {}  # late or not, team, method
    place_of: dict[str, tuple[bool, int, str]] = {}
    for submission, team in session.execute(query):
        if counts(submission):
            is_late_one = is_late(phase, submission)
            shows_one = is_one_each and not is_late_one and not team.is_reference
            place = is_late_one, team.id, "" if shows_one else submission.method
            place_of[submission.id] = place
            runs_at.setdefault(place, []).append(_Scored(submission, team, ""))
    pick = _picker(session, phase, key_of_phase(phase))
    standing = {
        place: (pick(runs) if place[2] else _of_teams(runs)[0]).submission
        for place, runs in runs_at.items()
    }
    found = {each.id: standing.get(place_of[each.id]) for each in asked if each.id in place_of}
    return {name: one for name, one in found.items() if one is not None and one.id != name}


def _scored_under(session: Session, phase: Phase, key: ScoringKey) -> list[_Scored]:
    query = (
        select(Submission, Team, ScoreSheetRow.measurement_key)
        .join(Team, Team.id == Submission.team_id)
        .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
        .where(
            Submission.phase_id == phase.id,
            Submission.status == SubmissionStatus.SCORED,
            is_of_key(ScoreSheetRow, key),
        )
        .order_by(Submission.received_at, Submission.id)
    )
    return [_Scored(*row) for row in session.execute(query)]


def whole_sheets(
    session: Session, ids: Sequence[str], key: ScoringKey
) -> Iterator[tuple[str, ScoreSheet]]:
    """Yield each of these submissions that has a sheet, with the sheet; read in small batches."""
    for first in range(0, len(ids), _SHEETS_AT_ONCE):
        query = select(ScoreSheetRow.submission_id, ScoreSheetRow.sheet).where(
            ScoreSheetRow.submission_id.in_(ids[first : first + _SHEETS_AT_ONCE]),
            is_of_key(ScoreSheetRow, key),
        )
        yield from session.execute(query)


def _sheets(session: Session, ids: Sequence[str], key: ScoringKey) -> dict[str, ScoreSheet]:
    found, sharing = {}, Sharing()
    for submission_id, whole in whole_sheets(session, ids, key):
        kept = {REMINDER: whole.extra[REMINDER]} if whole.has_reminders else {}
        found[submission_id] = whole.model_copy(update={**_ON_NO_ROW, "extra": kept})
        sharing.share(found[submission_id])
    return found


def stood_at_deadline(phase: Phase) -> ColumnElement[bool]:
    """Condition on `Submission`: it has a score, and was not withdrawn before the deadline."""
    is_scored = Submission.status == SubmissionStatus.SCORED
    if phase.closes_at is None:
        return is_scored
    return is_scored | (
        (Submission.status == SubmissionStatus.WITHDRAWN)
        & (Submission.withdrawn_at >= phase.closes_at)
        & (
            Submission.granted_until.is_(None)
            | (Submission.withdrawn_at >= Submission.granted_until)
        )
        & exists().where(ScoreSheetRow.submission_id == Submission.id)
    )


def _entries_due(
    session: Session,
    phase: Phase,
    scored: list[_Scored],
    view: BoardView,
    key: ScoringKey,
) -> list[_Scored]:
    public = [each for each in scored if is_published(phase, each.submission)]
    stood = sorted([*public, *_withdrawn_since(session, phase)], key=_by_arrival)
    in_time = [each for each in stood if not is_late(phase, each.submission)]
    shows_one = phase.policy.entries_shown == "chosen"
    pick = _picker(session, phase, key)
    due = _of_teams(in_time) if shows_one else _of_methods(in_time, pick)
    if view == "late" and not is_split_revealed(session, phase):
        due += _of_methods(each for each in public if is_late(phase, each.submission))
    out = disqualified_ids(session, phase.id)
    stands = [each for each in due if each.submission.is_scored and each.submission.id not in out]
    return sorted(stands, key=_by_arrival)


def _withdrawn_since(session: Session, phase: Phase) -> list[_Scored]:
    """Return public entries withdrawn after the deadline; what they replaced does not return."""
    query = (
        select(Submission, Team)
        .join(Team, Team.id == Submission.team_id)
        .where(
            Submission.phase_id == phase.id,
            Submission.status == SubmissionStatus.WITHDRAWN,
            stood_at_deadline(phase),
        )
    )
    found = [_Scored(submission, team, "") for submission, team in session.execute(query)]
    return [each for each in found if is_published(phase, each.submission)]


def _by_arrival(scored: _Scored) -> tuple[datetime, str]:
    return scored.submission.received_at, scored.submission.id


def _newest(runs: Sequence[_Scored]) -> _Scored:
    return runs[-1]


def _of_methods(scored: Iterable[_Scored], pick: _Picker = _newest) -> list[_Scored]:
    """Return one run of each method of each team, picked from its runs in order of submission."""
    methods: dict[tuple[int, str], list[_Scored]] = {}
    for each in scored:
        methods.setdefault((each.team.id, each.submission.method), []).append(each)
    return [pick(runs) for runs in methods.values()]


def _picker(session: Session, phase: Phase, key: ScoringKey) -> _Picker:
    """Return a function that picks the run that counts: the newest, or as its team chose last."""
    if phase.policy.run_choice == "newest":
        return _newest

    def pick(runs: Sequence[_Scored]) -> _Scored:
        said = max(runs, key=lambda run: (_chosen_at(run), *_by_arrival(run)))
        rule = said.submission.chosen_rule if said.submission.chosen_at else "newest"
        if rule == "this":
            return said
        if rule == "newest" or len(runs) == 1:
            return runs[-1]
        ids = [run.submission.id for run in runs]
        best = best_run(session, phase, ids, key)
        return next((run for run in runs if run.submission.id == best), runs[-1])

    return pick


def _of_teams(scored: list[_Scored]) -> list[_Scored]:
    """Return each team's last choice or else latest entry; reference teams keep all methods."""
    references = _of_methods(each for each in scored if each.team.is_reference)
    one: dict[int, _Scored] = {}
    for each in scored:
        held = one.get(each.team.id)
        if held is None or _chosen_at(each) >= _chosen_at(held):
            one[each.team.id] = each
    return references + [each for each in one.values() if not each.team.is_reference]


def _chosen_at(scored: _Scored) -> datetime:
    return scored.submission.chosen_at or _NEVER


def _entry(
    phase: Phase,
    scored: _Scored,
    sheets: Mapping[str, ScoreSheet],
    accepted: Mapping[str, ProtocolDocument],
) -> EntryRecord:
    submission, team, method = scored.submission, scored.team, scored.submission.method
    is_masked = is_anonymous(phase) and not team.is_reference
    return EntryRecord(
        submission_id=submission.id,
        team=pseudonym_of_team(phase, team.id) if is_masked else team.name,
        team_slug=team.slug,
        is_reference=team.is_reference,
        method=pseudonym_of_method(phase, team.id, method) if is_masked else method,
        description="" if is_masked else submission.description,
        links=Links() if is_masked else Links(paper=submission.paper_url, code=submission.code_url),
        submitted_at=submission.received_at,
        file_digest=submission.file_digest,
        sheet=sheets[submission.id],
        measurement_key=scored.measurement_key,
        accepted_under=accepted[submission.id],
        linked_to=submission.linked_to,
        is_late=is_late(phase, submission),
    )
