"""Report similar submissions to organizers, and keep the workers' comparisons of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import PROBING_SUSPECTED, audit_once
from exceptiondrive_records.db.database import insert_if_absent
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, SimilarityRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.similarity import (
    ALIKE_SUBMISSIONS,
    AlikeKind,
    AlikePair,
    AlikeSubmission,
    Probing,
    SimilarityReport,
    SubmissionOfTeam,
)

MOST_PAIRS = 500
PROBES_BEFORE_ALARM = 5
"""From so many submissions that change a few samples of another, they are reported and audited."""


_HAS_SCORE = exists().where(ScoreSheetRow.submission_id == Submission.id)


@dataclass(frozen=True)
class ScoredFile:
    """A scored submission, and whether it has been compared."""

    submission_id: str
    team_id: int
    file_digest: str
    is_compared: bool


def scored_files(session: Session, phase_id: str) -> list[ScoredFile]:
    """Return the submissions of a phase that ever had a score, in order of receipt.

    This includes withdrawn ones: what their teams learned from the scores stays known.
    """
    query = (
        select(
            Submission.id,
            Submission.team_id,
            Submission.file_digest,
            SimilarityRow.submission_id.is_not(None),
        )
        .outerjoin(SimilarityRow, SimilarityRow.submission_id == Submission.id)
        .where(Submission.phase_id == phase_id, _HAS_SCORE)
        .order_by(Submission.received_at, Submission.id)
    )
    return [ScoredFile(*row) for row in session.execute(query)]


def keep_alike(session: Session, submission_id: str, alike: Sequence[AlikeSubmission]) -> None:
    """Record the submissions similar to one; the first record stays. Probing by a team is audited."""
    found = ALIKE_SUBMISSIONS.dump_json(tuple(alike)).decode()
    is_first = insert_if_absent(session, SimilarityRow, submission_id=submission_id, alike=found)
    if is_first and any(each.is_probe for each in alike):
        _audit_alarm(session, session.get_one(Submission, submission_id))


def _audit_alarm(session: Session, submission: Submission) -> None:
    """Write an audit line about probing: at five submissions, and whenever their number doubles."""
    for found in similarity_report(session, submission.phase_id).probing:
        if submission.id in found.submissions:
            doublings = (found.n_submissions // PROBES_BEFORE_ALARM).bit_length() - 1
            detail = {
                "teams": list(found.teams),
                "submissions_at_least": PROBES_BEFORE_ALARM << doublings,
                "seen": "submissions that share most of their samples with an earlier one and "
                "change a few at a time",
            }
            audit_once(session, "worker", PROBING_SUSPECTED, submission.phase_id, detail)


def similarity_report(session: Session, phase_id: str) -> SimilarityReport:
    """Return the similar submissions of a phase, the nearest pairs first.

    Raises:
        NotFound: No such phase.
    """
    find_phase(session, phase_id)
    query = (
        select(Submission, Team, SimilarityRow.alike)
        .join(Team, Team.id == Submission.team_id)
        .outerjoin(SimilarityRow, SimilarityRow.submission_id == Submission.id)
        .where(Submission.phase_id == phase_id)
        .order_by(Submission.received_at, Submission.id)
    )
    known = {row[0].id: _Known(*row) for row in session.execute(query)}
    pairs = {frozenset((p.first.id, p.second.id)): p for p in _equal_files(known)}
    for pair in _alike_pairs(known):
        pairs.setdefault(frozenset((pair.first.id, pair.second.id)), pair)
    counts = select(func.count(), func.count(Submission.team_id.distinct()))
    n_scored, n_teams = session.execute(
        counts.where(Submission.phase_id == phase_id, _HAS_SCORE)
    ).one()
    n_compared = sum(each.alike is not None for each in known.values())
    return SimilarityReport(
        phase=phase_id,
        n_compared=n_compared,
        n_teams=n_teams,
        n_waiting=max(0, n_scored - n_compared),
        pairs=tuple(sorted(pairs.values(), key=_nearest_first)[:MOST_PAIRS]),
        probing=_find_probing(known),
    )


@dataclass(frozen=True)
class _Known:
    submission: Submission
    team: Team
    alike: str | None

    @property
    def shown(self) -> SubmissionOfTeam:
        submission = self.submission
        return SubmissionOfTeam(
            id=submission.id,
            team=self.team.name,
            method=submission.method,
            received_at=submission.received_at,
        )

    @property
    def alike_ones(self) -> tuple[AlikeSubmission, ...]:
        return () if self.alike is None else ALIKE_SUBMISSIONS.validate_json(self.alike)


def _equal_files(known: dict[str, _Known]) -> Iterator[AlikePair]:
    """Pair each file with the first team that sent it, whatever its outcome; skip confirmed ones."""
    first: dict[str, _Known] = {}
    for each in known.values():
        if each.submission.confirmed_as is not None:
            continue
        earlier = first.setdefault(each.submission.file_digest, each)
        if earlier.team.id != each.team.id:
            yield AlikePair(
                kind=AlikeKind.EQUAL_FILES,
                first=earlier.shown,
                second=each.shown,
                equal_share=1.0,
                mean_distance=0.0,
                n_different=0,
            )


def _alike_pairs(known: dict[str, _Known]) -> Iterator[AlikePair]:
    order = {name: number for number, name in enumerate(known)}
    for each in known.values():
        for found in each.alike_ones:
            other = known.get(found.submission_id)
            if other is None or other.team.id == each.team.id:
                continue
            is_same_file = other.submission.file_digest == each.submission.file_digest
            first, second = sorted((each, other), key=lambda one: order[one.submission.id])
            yield AlikePair(
                kind=AlikeKind.EQUAL_FILES if is_same_file else _kind(found),
                first=first.shown,
                second=second.shown,
                equal_share=found.equal_share,
                mean_distance=found.mean_distance,
                n_different=found.n_different,
                scale=found.scale,
            )


def _kind(found: AlikeSubmission) -> AlikeKind:
    if found.n_different == 0:
        return AlikeKind.EQUAL_ANSWERS
    return AlikeKind.NEAR if found.scale is None else AlikeKind.SCALED


def _find_probing(known: dict[str, _Known]) -> tuple[Probing, ...]:
    """Group submissions that differ in a few samples only, whichever teams sent them.

    Probes of one team are joined into one group if they alone are enough for an alarm.
    """
    first_of = {name: name for name in known}

    def root(name: str) -> str:
        while first_of[name] != name:
            name = first_of[name]
        return name

    asking: dict[str, int] = {}
    of_team: dict[int, list[str]] = {}
    for name, each in known.items():
        probed = [it for it in each.alike_ones if it.is_probe and it.submission_id in known]
        for it in probed:
            first_of[root(name)] = root(it.submission_id)
        if probed:
            asking[name] = min(it.n_changed for it in probed)
            of_team.setdefault(each.team.id, []).append(name)
    for probes in of_team.values():
        for name in probes if len(probes) >= PROBES_BEFORE_ALARM else ():
            first_of[root(name)] = root(probes[0])
    groups: dict[str, list[str]] = {}
    for name in known:
        groups.setdefault(root(name), []).append(name)
    found = []
    for names in groups.values():
        probes = [name for name in names if name in asking]
        if len(probes) >= PROBES_BEFORE_ALARM:
            found.append(
                Probing(
                    teams=tuple(sorted({known[name].team.name for name in names})),
                    n_submissions=len(probes),
                    fewest_changed=min(asking[name] for name in probes),
                    most_changed=max(asking[name] for name in probes),
                    first_at=known[probes[0]].submission.received_at,
                    last_at=known[probes[-1]].submission.received_at,
                    submissions=tuple(probes[:MOST_PAIRS]),
                )
            )
    return tuple(sorted(found, key=lambda each: -each.n_submissions))


def _nearest_first(pair: AlikePair) -> tuple[int, float, float]:
    return pair.n_different, -pair.equal_share, pair.mean_distance or 0.0
