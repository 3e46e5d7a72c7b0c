"""Find changes that bypassed the audit log, in rows that decide boards.

The server's database role may change these rows, and may write audit lines. These checks find
changes without a line; `violations` runs all of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session, defer

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import news_between
from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.phases import deciding_settings
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import BoardNews


def unlogged_forgetting(session: Session) -> Iterator[Violation]:
    """Check that the log names exactly the forgotten teams, which boards show under aliases."""
    said = select(AuditLine.subject).where(AuditLine.action == "team forgotten")
    is_forgotten = Team.forgotten_at.is_not(None) & Team.merged_into_id.is_(None)
    for team in session.scalars(select(Team.slug).where(is_forgotten, Team.slug.not_in(said))):
        yield Violation("forgotten by nobody", team, "no audit line says that it was forgotten")
    told = select(Team.slug).where(Team.forgotten_at.is_(None), Team.slug.in_(said))
    for team in session.scalars(told):
        yield Violation("forgotten and back", team, "the audit log says that it was forgotten")


@dataclass
class _Told:
    """The state of one submission according to the log, by the last line of each kind."""

    sent_by: str | None = None
    is_withdrawn: bool = False
    method: str | None = None
    chosen: tuple[str, datetime] | None = None
    """The rule, and the time of the line."""


_CHOICE_TO_LINE = timedelta(minutes=10)
"""A choice and its line are written in one transaction; only waiting for locks separates them."""


def unlogged_submissions(session: Session) -> Iterator[Violation]:
    """Check that team, method, choice and withdrawal of each submission follow from the log."""
    told = _told_of_submissions(session)
    into = {f"team:{team.id}": team.merged_into_id for team in session.scalars(select(Team))}
    for row in session.scalars(select(Submission).options(defer(Submission.report))):
        of_it = told.get(row.id, _Told())
        was_told = row.confirmed_as is not None or of_it.is_withdrawn
        if row.status is SubmissionStatus.WITHDRAWN and not was_told:
            yield Violation("withdrawn by nobody", row.id, "no audit line says who withdrew it")
        owner = of_it.sent_by or f"team:{row.team_id}"
        while (later := into.get(owner)) is not None:
            owner = f"team:{later}"
        if owner != f"team:{row.team_id}":
            yield Violation("submission of another team", row.id, f"{owner} sent it")
        if of_it.method not in (None, row.method):
            yield Violation("renamed by nobody", row.id, f"the audit log calls it {of_it.method!r}")
        if not _is_choice(row, of_it.chosen):
            yield Violation("chosen by nobody", row.id, "the audit log tells another choice")
    said = select(AuditLine.subject).where(AuditLine.action == "team merged")
    is_merged = Team.merged_into_id.is_not(None) & Team.forgotten_at.is_(None)
    for slug in session.scalars(select(Team.slug).where(is_merged, Team.slug.not_in(said))):
        yield Violation("merged by nobody", slug, "no audit line says that it was merged")


def _told_of_submissions(session: Session) -> dict[str, _Told]:
    found: dict[str, _Told] = {}
    actions = ("received", "withdrawn", "restored", "edited")
    is_of_it = AuditLine.action.in_(["entry chosen", *(f"submission {each}" for each in actions)])
    for line in session.scalars(select(AuditLine).where(is_of_it).order_by(AuditLine.id)):
        told = found.setdefault(line.subject, _Told())
        match line.action.removeprefix("submission "):
            case "received":
                told.sent_by = told.sent_by or line.actor
                told.method = told.method or line.detail.get("method")
            case "edited":
                told.method = line.detail.get("changed", {}).get("method", [told.method])[-1]
            case "entry chosen":
                told.chosen = (str(line.detail.get("rule")), line.at)
            case ending:
                told.is_withdrawn = ending == "withdrawn"
    return found


def _is_choice(row: Submission, chosen: tuple[str, datetime] | None) -> bool:
    if chosen is None or row.chosen_at is None:
        return chosen is None and row.chosen_at is None
    rule, at = chosen
    return row.chosen_rule == rule and timedelta(0) <= at - row.chosen_at < _CHOICE_TO_LINE


def unlogged_disqualifications(session: Session) -> Iterator[Violation]:
    """Check that disqualifications, with their words, and reinstatements follow from the log."""
    ended = AuditLine.action.endswith(" reinstated")
    begun = AuditLine.action.endswith(" disqualified")
    details = select(AuditLine.detail)
    notes = {each.get("disqualification"): each for each in session.scalars(details.where(begun))}
    ends = {each.get("disqualification") for each in session.scalars(details.where(ended))}
    for row in session.scalars(select(Disqualification)):
        line = notes.pop(row.id, {})
        if (line.get("reason"), line.get("public_note")) != (row.reason, row.public_note):
            text = "no audit line tells of it in these words"
            yield Violation("disqualified by nobody", str(row.id), text)
        if (row.reinstated_at is not None) != (row.id in ends):
            yield Violation("reinstated by nobody", str(row.id), "the audit log says otherwise")
    for gone in notes:
        yield Violation("reinstated by nobody", str(gone), "an audit line tells of it; it is gone")


_OF_A_FREEZE = "freezes_at"
"""A freeze also changes it, and its audit line has another form."""


def unlogged_settings(session: Session) -> Iterator[Violation]:
    """Check that dates and policy of phases are those at creation, as changed by later audit lines.

    Any line `phase ...` may change them: it names a setting with its value before and after.
    """
    told: dict[str, dict[str, Any]] = {}
    is_of_phase = AuditLine.action.startswith("phase ")
    for line in session.scalars(select(AuditLine).where(is_of_phase).order_by(AuditLine.id)):
        if line.action == "phase created":
            told[line.subject] = dict(line.detail)
        else:
            of_it = told.setdefault(line.subject, {})
            pairs = {key: each for key, each in line.detail.items() if isinstance(each, list)}
            of_it |= {key: each[-1] for key, each in pairs.items()}
    for phase in session.scalars(select(Phase).options(defer(Phase.page))):
        of_it = told.get(phase.id, {})
        for key, value in deciding_settings(phase).items():
            if key != _OF_A_FREEZE and of_it.get(key, value) != value:
                yield Violation("phase changed by nobody", phase.id, f"its {key}")


def unlogged_flips(session: Session) -> Iterator[Violation]:
    """Check that the news in the history of a phase follow from the boards that it names.

    Flips are ordered by id, because the clock may have been set back between any two.
    """
    flips = (
        select(BoardFlip, Phase.challenge)
        .join(Phase, Phase.id == BoardFlip.phase_id)
        .order_by(BoardFlip.phase_id, BoardFlip.id)
    )
    before: BoardRow | None = None
    for flip, challenge in session.execute(flips.execution_options(yield_per=20)):
        row = session.get_one(BoardRow, flip.board_id)
        if before is not None and before.phase_id != flip.phase_id:
            before = None
        if not _is_told(challenge, flip.news, before, row):
            subject = f"{flip.phase_id}/{row.number}"
            yield Violation("history altered", subject, "its news are not in its boards")
        before = row


def _is_told(challenge: str, news: BoardNews, old: BoardRow | None, new: BoardRow) -> bool:
    """Whether news follow from boards, with recorded names or with aliases of forgotten teams."""
    if news == BoardNews():  # nothing was shown before, or nothing comparable
        return True
    if old is None:
        return False
    recorded = news_between(challenge, old, new, with_aliases=False)
    if news == recorded:
        return True
    told = news_between(challenge, old, new)
    return (
        news.n_more == recorded.n_more
        and len(news.entries) == len(recorded.entries)
        and all(
            entry in (one, one.model_copy(update={"team": other.team}))
            for entry, one, other in zip(news.entries, recorded.entries, told.entries, strict=True)
        )
    )
