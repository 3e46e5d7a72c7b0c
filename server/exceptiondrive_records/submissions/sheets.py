"""Count the submissions with sheets of a split, which measures how much was revealed about it."""

from datetime import datetime, timedelta

from sqlalchemy import BindParameter, ColumnElement, Select, bindparam, exists, func, select
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.db.clock import Moment, seconds_from_now
from exceptiondrive_records.db.columns import UtcDateTime
from exceptiondrive_records.db.last import require_last
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow

_A_DAY = timedelta(days=1)


def _of_split(sheet: type[ScoreSheetRow]) -> ColumnElement[bool]:
    revisions = select(SplitRow.revision).where(SplitRow.name == bindparam("split"))
    return sheet.split_revision.in_(revisions)


_IS_SCORED = select(
    exists().where(ScoreSheetRow.submission_id == bindparam("submission"), _of_split(ScoreSheetRow))
)


def _n_firsts(since: Moment | BindParameter[datetime]) -> Select[int]:
    """Count submissions whose first sheet was made since then, scanning only sheets since then."""
    earlier = aliased(ScoreSheetRow)
    had_one = exists().where(
        earlier.submission_id == ScoreSheetRow.submission_id,
        _of_split(earlier),
        earlier.created_at <= since,
    )
    return select(func.count(ScoreSheetRow.submission_id.distinct())).where(
        _of_split(ScoreSheetRow),
        ScoreSheetRow.created_at > since,
        ScoreSheetRow.submission_id != bindparam("besides"),
        ~had_one,
    )


_N_FIRSTS_SINCE = _n_firsts(bindparam("since", type_=UtcDateTime()))
_N_FIRSTS_TODAY = _n_firsts(seconds_from_now(-_A_DAY.total_seconds()))
_IS_ROOM = _N_FIRSTS_TODAY.scalar_subquery() < bindparam("most")


def is_scored(session: Session, name: str, submission_id: str) -> bool:
    """Whether a submission has a sheet of a split, at any revision; sheets stay forever."""
    given = {"split": name, "submission": submission_id}
    return bool(session.scalar(_IS_SCORED, given))


def has_sheets(session: Session, name: str) -> bool:
    """Whether any submission has a sheet of a split, at any revision."""
    return bool(session.scalar(select(exists().where(_of_split(ScoreSheetRow))), {"split": name}))


def scored_within_a_day(session: Session, name: str, now: datetime, *, besides: str) -> int:
    """Count the submissions that got their first sheet of a split in the 24 hours before `now`.

    It relies only on sheets, which no database role but the workers' may add, and none may delete.
    All revisions of the split count; the submission `besides` does not.
    """
    given = {"split": name, "besides": besides, "since": now - _A_DAY}
    return session.scalar(_N_FIRSTS_SINCE, given) or 0


def require_room_last(
    session: Session, name: str, most: int, *, besides: str, refusal: Exception
) -> None:
    """Commit this write transaction only if `scored_within_a_day` is less than `most` at its end.

    Otherwise `refusal` is raised. The caller has called `lock_split_last`.
    """
    given = {"split": name, "besides": besides, "most": most}
    require_last(session, _IS_ROOM, given, refusal)
