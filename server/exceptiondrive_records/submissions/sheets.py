"""How much has been told of a split: the protocols and submissions that have sheets of it."""

from datetime import datetime, timedelta

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow

_A_DAY = timedelta(days=1)


def _revisions(name: str) -> Select[str]:
    return select(SplitRow.revision).where(SplitRow.name == name)


def protocols_of_split(session: Session, name: str) -> set[str]:
    """Return the digests of the protocols that a split was scored under, at any revision."""
    query = select(ScoreSheetRow.protocol_digest).where(
        ScoreSheetRow.split_revision.in_(_revisions(name))
    )
    return set(session.scalars(query.distinct()))


def scored_within_a_day(session: Session, name: str, now: datetime, *, besides: str) -> int:
    """Count the submissions that got their first sheet of a split in the 24 hours before `now`.

    Nothing that another role of the database may write counts: sheets alone, which only workers add
    and nobody takes away.

    Args:
        session: To read with.
        name: Of the split, at any revision.
        now: The end of the day.
        besides: A submission that is not counted.
    """
    firsts = (
        select(func.min(ScoreSheetRow.created_at).label("at"))
        .where(
            ScoreSheetRow.split_revision.in_(_revisions(name)),
            ScoreSheetRow.submission_id != besides,
        )
        .group_by(ScoreSheetRow.submission_id)
        .subquery()
    )
    query = select(func.count()).select_from(firsts).where(firsts.c.at > now - _A_DAY)
    return session.scalar(query) or 0
