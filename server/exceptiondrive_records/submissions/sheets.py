"""How much has been told of a split: the protocols and submissions that have sheets of it."""

from datetime import datetime, timedelta

from sqlalchemy import bindparam, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import seconds_from_now
from exceptiondrive_records.db.columns import UtcDateTime
from exceptiondrive_records.db.last import require_last
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow

_A_DAY = timedelta(days=1)


_OF_SPLIT = ScoreSheetRow.split_revision.in_(
    select(SplitRow.revision).where(SplitRow.name == bindparam("split"))
)
_PROTOCOLS = select(ScoreSheetRow.protocol_digest).where(_OF_SPLIT).distinct()
_FIRSTS = (
    select(func.min(ScoreSheetRow.created_at).label("at"))
    .where(_OF_SPLIT, ScoreSheetRow.submission_id != bindparam("besides"))
    .group_by(ScoreSheetRow.submission_id)
    .subquery()
)
_N_FIRSTS = select(func.count()).select_from(_FIRSTS)
_N_FIRSTS_SINCE = _N_FIRSTS.where(_FIRSTS.c.at > bindparam("since", type_=UtcDateTime()))
_N_FIRSTS_TODAY = _N_FIRSTS.where(_FIRSTS.c.at > seconds_from_now(-_A_DAY.total_seconds()))
_IS_ROOM = _N_FIRSTS_TODAY.scalar_subquery() < bindparam("most")


def protocols_of_split(session: Session, name: str) -> set[str]:
    """Return the digests of the protocols that a split was scored under, at any revision."""
    return set(session.scalars(_PROTOCOLS, {"split": name}))


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
    given = {"split": name, "besides": besides, "since": now - _A_DAY}
    return session.scalar(_N_FIRSTS_SINCE, given) or 0


def require_room_last(
    session: Session, name: str, most: int, *, besides: str, refusal: Exception
) -> None:
    """Keep this write transaction only if `scored_within_a_day` is less than `most` at its end.

    Args:
        session: Of the transaction; who comes here has locked the split last.
        name: Of the split, at any revision.
        most: Submissions within 24 hours.
        besides: A submission that is not counted.
        refusal: Raised otherwise.
    """
    given = {"split": name, "besides": besides, "most": most}
    require_last(session, _IS_ROOM, given, refusal)
