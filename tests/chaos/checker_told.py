"""What clients were told of endings, scores and boards stays true."""

import json
from collections.abc import Iterator
from datetime import datetime
from typing import Any

from pydantic import TypeAdapter
from tests.chaos.history import BoardSeen, History

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus

_FINAL = {status.value for status in SubmissionStatus if status.is_terminal}
_SCORED, _WITHDRAWN = SubmissionStatus.SCORED.value, SubmissionStatus.WITHDRAWN.value
SheetKey = tuple[str, str, str]
_DATE = TypeAdapter(datetime)


def _may_follow(before: str | None, after: str, *, is_restored: bool) -> bool:
    """An ending is for ever; but a score may be withdrawn, and an organizer may give it back."""
    if before not in _FINAL or before == after:
        return True
    return (before, after) == (_SCORED, _WITHDRAWN) or (
        is_restored and (before, after) == (_WITHDRAWN, _SCORED)
    )


def endings_stay(history: History, rows: list[Submission]) -> Iterator[Violation]:
    """Who was told an ending is never told another status, and the records say the same."""
    told: dict[str, str] = {}
    for seen in sorted(history.sightings, key=lambda seen: seen.at_s):
        before = told.get(seen.submission_id)
        is_restored = seen.submission_id in history.restored
        if not _may_follow(before, seen.status, is_restored=is_restored):
            yield Violation("ending changed", seen.submission_id, f"{before}, then {seen.status}")
        told[seen.submission_id] = seen.status
    for row in rows:
        said = told.get(row.id)
        if not _may_follow(said, row.status.value, is_restored=row.id in history.restored):
            yield Violation("ending changed", row.id, f"{said} was told, records: {row.status}")


def scores_stay(history: History, sheets: dict[SheetKey, dict[str, Any]]) -> Iterator[Violation]:
    """Every sheet that was told is that of the records, to the last number."""
    for seen in history.sightings:
        if seen.sheet is None:
            continue
        protocol, revision = seen.sheet["protocol"]["digest"], seen.sheet["split"]["revision"]
        kept = sheets.get((seen.submission_id, protocol, revision))
        if kept != seen.sheet:
            names = sorted(key for key in seen.sheet if (kept or {}).get(key) != seen.sheet[key])
            yield Violation("score changed", seen.submission_id, f"told other {', '.join(names)}")


def board_as_told(row: BoardRow, first_at: datetime) -> str:
    """The bytes of the records, with the moment when readers first saw them as their date.

    That is another than the recorded one where a rescoring built the board and it was applied later.
    """
    built, told = (
        f'"published_at":{_DATE.dump_json(at).decode()}' for at in (row.published_at, first_at)
    )
    return row.body.replace(built, told)


def boards_seen(
    seen: list[BoardSeen], kept: set[str], shown: dict[str, list[int]]
) -> Iterator[Violation]:
    """Every board that was shown is one of the records, byte for byte, and they came in its order.

    That is the order in which the pointer moved (`shown`, by phase): a rollback shows an earlier board again.
    """
    places: dict[str, int] = {}
    bodies: dict[str, bytes] = {}
    for board in sorted(seen, key=lambda board: board.at_s):
        document = json.loads(board.body)
        phase, number = document["phase"], document["board"]
        if board.body.decode() not in kept:
            yield Violation("board not on the records", phase, f"number {number} was shown")
        if bodies.setdefault(board.etag, board.body) != board.body:
            yield Violation("one tag, two boards", phase, board.etag)
        place = places.get(phase, 0)
        if number in shown[phase][place:]:
            places[phase] = shown[phase].index(number, place)
        else:
            yield Violation("board went back", phase, f"{number} after {shown[phase][: place + 1]}")
