"""Boards: immutable snapshots; "the current board" is one pointer."""

import threading
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import NamedTuple, TypeVar

from sqlalchemy import ColumnElement, exists, func, insert, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.documents import entry_documents, read_board
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardFlip, BoardRow, told_as
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.phases.disqualified import is_one_taken_back
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.policy import frozen_since, is_pseudonym, shown_board
from exceptiondrive_records.phases.scoring_keys import ScoringKey, is_of_key
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.board_requests import finish_board
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.api.phase_settings import BoardView, SplitPart
from exceptiondrive_schemas.api.rescoring import EntryChange
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.board import Board, BoardEntry, BoardLeader, BoardNews, EntryNews
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.method_facts import Links

_Named = TypeVar("_Named", BoardEntry, BoardLeader, EntryNews, EntryChange)
BOARD_LINES = ("board published", "board built")
"""Audit actions for a new board: it is shown to readers, or it is held back."""
_A_DRAFT = "it is a draft"
MAX_NEWS = 20
"""If a board changes more entries, as with a new part of the split, the rest are only counted."""


def publish_board(
    session: Session, request: BoardRequest, board: Board, late: Board | None = None
) -> BoardRow | None:
    """Append a board and, under the phase's own protocol and split, make it the current one.

    Number and date are assigned here, and what may not be shown yet is removed, so that no response
    has it. A board equal to the latest one of this protocol is not appended again; a draft is, as
    the numbers of public boards would otherwise reveal whether it changed. The pointers stay while
    the phase is frozen, or if an entry was taken back meanwhile: the next board leaves it out.

    Returns:
        The row that holds the board; None if the lease was lost and nothing was recorded.

    Raises:
        LeaseLost: At the end of the transaction: the lease was lost meanwhile; nothing is recorded.
    """
    phase = lock_phase(session, request.phase_id)
    if not finish_board(session, request):
        return None
    now = database_now(session)
    kept_back = _kept_back(phase, request, now)
    ids = {key for each in (board, late) if each for key in each.entries_by_submission}
    if not kept_back and is_one_taken_back(session, phase, ids):
        kept_back = "an entry was taken back while it was built"
    row = _kept_or_appended(session, request, shown_board(phase, board, now), "main", kept_back)
    late_row = late and _kept_or_appended(
        session, request, shown_board(phase, late, now), "late", kept_back
    )
    if not kept_back:
        flip_board(session, phase, row, at=max(now, row.published_at))
        phase.late_board_id = late_row.id if late_row else None
    return row


def _kept_back(phase: Phase, request: BoardRequest, now: datetime) -> str:
    """Return why a new board is not shown at once; empty if it is shown."""
    shown = (phase.protocol_digest, phase.split_revision)
    if shown != (request.protocol_digest, request.split_revision):
        return _A_DRAFT
    return "the board is frozen" if frozen_since(phase, now) is not None else ""


def _kept_or_appended(
    session: Session, request: BoardRequest, board: Board, view: BoardView, kept_back: str
) -> BoardRow:
    key = ScoringKey(request.protocol_digest, request.split_revision)
    row = latest_board(session, request.phase_id, key, view)
    digest = board.content_digest
    if kept_back != _A_DRAFT and row is not None and row.digest == digest:
        return row
    return _append(session, request, board, digest, view, kept_back)


def flip_board(
    session: Session, phase: Phase, row: BoardRow, *, at: datetime | None = None
) -> BoardFlip | None:
    """Point the phase at a board; the caller holds the lock of the phase.

    Readers see it from `at`, by default now.

    Returns:
        The flip; None if the phase showed this board already.
    """
    if phase.current_board_id == row.id:
        return None
    before = session.get(BoardRow, phase.current_board_id) if phase.current_board_id else None
    phase.current_board_id = row.id
    at = at or database_now(session)
    news = news_between(phase.challenge, before, row) if before else BoardNews()
    flip = BoardFlip(phase_id=phase.id, board_id=row.id, at=at, news=news)
    session.add(flip)
    session.flush()
    return flip


class _Stood(NamedTuple):
    """What the news report about an entry; `value` is that of the challenge's first metric."""

    method: str
    team: str
    rank: int | None
    value: float | None


_Standings = Mapping[str, _Stood]
"""Entries by submission, in the order of the board."""


def _news_of(was: _Standings, now: _Standings) -> BoardNews:
    before_of = _runs_before(was, now)
    replaced = set(before_of.values())
    found = []
    for name, either in {**was, **now}.items():
        earlier = before_of.get(name, name)
        before, after = was.get(earlier), now.get(name)
        values = before and before.value, after and after.value
        is_same = earlier == name and name in was and name in now and values[0] == values[1]
        if name not in replaced and not is_same:
            found.append(
                EntryNews(
                    submission_id=name,
                    method=either.method,
                    team=either.team,
                    rank=either.rank,
                    before=values[0],
                    after=values[1],
                    is_new=earlier not in was,
                    is_new_run=earlier != name,
                    has_left=name not in now,
                )
            )
    found.sort(key=lambda each: (each.has_left, each.rank is None, each.rank or 0))
    return BoardNews(entries=tuple(found[:MAX_NEWS]), n_more=max(0, len(found) - MAX_NEWS))


def _runs_before(was: _Standings, now: _Standings) -> dict[str, str]:
    """Return the entry that each new one replaced: one of the same team and method that left."""
    left = {(stood.team, stood.method): name for name, stood in was.items() if name not in now}
    return {
        name: left[stood.team, stood.method]
        for name, stood in now.items()
        if name not in was and (stood.team, stood.method) in left
    }


def news_between(
    challenge: str, old: BoardRow, row: BoardRow, *, with_aliases: bool = True
) -> BoardNews:
    """List new scores; boards of different protocols or split revisions cannot be compared.

    It reads little of the boards, because the caller holds locks.
    """
    if (old.protocol_digest, old.split_revision) != (row.protocol_digest, row.split_revision):
        return BoardNews()
    key = CHALLENGES[challenge].metrics[0].key
    return _news_of(*(_standings(each, key, with_aliases) for each in (old, row)))


def _standings(row: BoardRow, key: str, with_aliases: bool) -> _Standings:
    aliases = _aliases_on(row) if with_aliases else {}
    return {
        name: _Stood(
            entry["method"],
            entry["team"] if is_pseudonym(entry["team"]) else aliases.get(name, entry["team"]),
            entry["rank"],
            entry["metrics"].get(key),
        )
        for entry in entry_documents(row.body)
        if (name := entry["submission_id"])
    }


def current_board(session: Session, phase_id: str) -> BoardRow | None:
    """Return the board that the phase shows now."""
    query = select(BoardRow).join(Phase, Phase.current_board_id == BoardRow.id)
    return session.scalars(query.where(Phase.id == phase_id)).first()


def board_at(session: Session, phase_id: str, as_of: datetime) -> BoardRow | None:
    """Return the board that the phase showed at a time."""
    return _last_shown(session, phase_id, BoardFlip.at <= as_of)


def latest_public_board(session: Session, phase_id: str, protocol_digest: str) -> BoardRow | None:
    """Return the most recently shown board of a phase under a protocol, also after a rollback."""
    return _last_shown(session, phase_id, BoardRow.protocol_digest == protocol_digest)


def last_shown_of_part(session: Session, phase: Phase, part: SplitPart | None) -> BoardRow | None:
    """Return the last shown board that counts a part of the split (None: the whole split)."""
    is_part = SplitRow.name == phase.split_name, SplitRow.part.is_not_distinct_from(part)
    revisions = select(SplitRow.revision).where(*is_part)
    return _last_shown(session, phase.id, BoardRow.split_revision.in_(revisions))


def _last_shown(session: Session, phase_id: str, which: ColumnElement[bool]) -> BoardRow | None:
    query = (
        select(BoardRow)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .where(BoardFlip.phase_id == phase_id, which)
        .order_by(BoardFlip.at.desc(), BoardFlip.id.desc())
        .limit(1)
    )
    return session.scalars(query).first()


def late_board(session: Session, phase_id: str) -> BoardRow | None:
    """Return the board of the late view; None while there are no late submissions."""
    query = select(BoardRow).join(Phase, Phase.late_board_id == BoardRow.id)
    return session.scalars(query.where(Phase.id == phase_id)).first()


def latest_board(
    session: Session, phase_id: str, key: ScoringKey, view: BoardView = "main"
) -> BoardRow | None:
    """Return the newest board of a phase under a key, including drafts."""
    query = select(BoardRow).where(
        BoardRow.phase_id == phase_id, is_of_key(BoardRow, key), BoardRow.view == view
    )
    return session.scalars(query.order_by(BoardRow.number.desc()).limit(1)).first()


def last_flip_at(session: Session, phase_id: str) -> datetime | None:
    """Return when a phase's current board was first shown."""
    return session.scalar(select(func.max(BoardFlip.at)).where(BoardFlip.phase_id == phase_id))


def public_protocols(session: Session, phase_id: str) -> list[str]:
    """Return the digests of the protocols under which a board of the phase was ever shown."""
    query = (  # start from the flips, which have an index: looking up a flip per board is quadratic
        select(BoardRow.protocol_digest)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .where(BoardFlip.phase_id == phase_id)
    )
    return list(session.scalars(query.distinct()))


_PARSED: Memory[str, Board] = Memory(16 * 2**20)
"""Bounded by the bytes of the documents; a parsed board takes three times as much memory."""
_READING = threading.Lock()
"""Boards are parsed one at a time: concurrent requests for a new board would each parse it."""


def parsed_board(row: BoardRow) -> Board:
    """Return the parsed document of a board, cached: boards never change."""
    kept = _PARSED.get(row.told)
    if kept is not None:
        return kept
    with _READING:
        return _PARSED.get(row.told) or _PARSED.keep(row.told, _read(row), len(row.body))


def _read(row: BoardRow) -> Board:
    _PARSED.make_room(len(row.body))
    board = read_board(row.body)
    if row.told_at != board.published_at:
        board = board.model_copy(update={"published_at": row.told_at})
    if aliases := _aliases_on(row):
        board = _under_aliases(board, aliases)
    return board


def _aliases_on(row: BoardRow) -> dict[str, str]:
    """Return the aliases on a board of forgotten teams, by submission."""
    lines = row.forgotten.split("\n") if row.forgotten else []
    return dict(line.split(" ", 1) for line in lines)


def _under_aliases(board: Board, aliases: Mapping[str, str]) -> Board:
    """Show forgotten teams under aliases, without texts; pseudonyms stay: they reveal nothing."""
    wordless = {"description": "", "links": Links()}
    named = (under_alias(entry, aliases) for entry in board.entries)
    entries = (
        told if told is entry else told.model_copy(update=wordless)
        for entry, told in zip(board.entries, named, strict=True)
    )
    return board.model_copy(update={"entries": tuple(entries)})


def served_body(row: BoardRow) -> str:
    """Return the document of a board as readers get it.

    These are the recorded bytes with two exceptions: `published_at` of a former draft is the time
    when it was first shown, and a forgotten team has its alias instead of its name and texts.
    """
    if is_told_as_recorded(row):
        return row.body
    return b"".join(parsed_board(row).canonical_pieces()).decode()


def is_told_as_recorded(row: BoardRow) -> bool:
    """Whether readers get exactly the recorded bytes, whose digest is `body_digest`."""
    return row.told_at == row.published_at and row.forgotten is None


def boards_with(
    session: Session, submission_id: str, board_ids: Iterable[int | None]
) -> list[BoardRow]:
    """Return those of the given boards that list a submission, in the given order."""
    wanted = [board_id for board_id in board_ids if board_id is not None]
    query = (
        select(BoardRow)
        .join(BoardEntryRow, BoardEntryRow.board_id == BoardRow.id)
        .where(BoardEntryRow.submission_id == submission_id, BoardRow.id.in_(wanted))
    )
    return sorted(session.scalars(query), key=lambda row: wanted.index(row.id))


def entry_ids(session: Session, board_id: int) -> set[str]:
    """Return the submissions on a board."""
    query = select(BoardEntryRow.submission_id).where(BoardEntryRow.board_id == board_id)
    return set(session.scalars(query))


def entries_on(session: Session, board_id: int | None) -> Mapping[str, BoardEntry]:
    """Return the entries of a board by submission; a cached board's document is not loaded."""
    key = session.execute(
        select(BoardRow.body_digest, BoardRow.told_at, BoardRow.forgotten).where(
            BoardRow.id == board_id
        )
    ).first()
    if key is None:
        return {}
    board = _PARSED.get(told_as(*key))
    if board is None:
        board = parsed_board(session.get_one(BoardRow, board_id))
    return board.entries_by_submission


def newest_board_with(session: Session, submission_id: str) -> BoardRow | None:
    """Return the newest board that lists a submission and was ever shown.

    Only organizers see drafts.
    """
    query = (
        select(BoardRow)
        .join(BoardEntryRow, BoardEntryRow.board_id == BoardRow.id)
        .where(BoardEntryRow.submission_id == submission_id, was_shown())
        .order_by(BoardRow.id.desc())
        .limit(1)
    )
    return session.scalars(query).first()


def boards_by_protocol(
    session: Session, submission: Submission, limit: int
) -> list[tuple[BoardRow, BoardRow]]:
    """Return, for each protocol, the first and the last shown board with a submission.

    The last one is the one shown last, not built last: a rollback shows an earlier board again.
    Only the newest `limit` protocols are included.
    """
    query = (
        select(func.min(BoardFlip.id), func.max(BoardFlip.id))
        .join(BoardRow, BoardRow.id == BoardFlip.board_id)
        .join(BoardEntryRow, BoardEntryRow.board_id == BoardRow.id)
        .join(ProtocolRow, ProtocolRow.digest == BoardRow.protocol_digest)
        .where(BoardEntryRow.submission_id == submission.id)
        .group_by(ProtocolRow.digest, ProtocolRow.created_at)
        .order_by(ProtocolRow.created_at.desc())
        .limit(limit)
    )
    return [
        (_board_of(session, first), _board_of(session, last))
        for first, last in session.execute(query)
    ]


def boards_of_flip(session: Session, flip_id: int) -> tuple[BoardRow, BoardRow]:
    """Return the boards that a phase showed before and after an update was applied or rolled back."""
    phase_id = session.get_one(BoardFlip, flip_id).phase_id
    earlier = select(func.max(BoardFlip.id)).where(
        BoardFlip.phase_id == phase_id, BoardFlip.id < flip_id
    )
    return _board_of(session, session.scalars(earlier).one()), _board_of(session, flip_id)


def _board_of(session: Session, flip_id: int) -> BoardRow:
    return session.get_one(BoardRow, session.get_one(BoardFlip, flip_id).board_id)


def _leader_of(board: Board) -> BoardLeader | None:
    entry, metric = board.leader, CHALLENGES[board.challenge].metrics[0]
    value = entry.metrics.get(metric.key) if entry else None
    if entry is None or entry.submission_id is None or value is None:
        return None
    return BoardLeader(
        submission_id=entry.submission_id, method=entry.method, team=entry.team, value=value
    )


class Lead(NamedTuple):
    """When a board was shown, its protocol, its samples, and its leader."""

    at: datetime
    number: int
    protocol: str
    split_revision: str
    part: SplitPart | None
    leader: BoardLeader | None


def is_what_counts() -> ColumnElement[bool]:
    """Condition on `SplitRow`: the revision or part of the phase's split that a board counts."""
    return (SplitRow.name == Phase.split_name) & (SplitRow.revision == BoardRow.split_revision)


def leads(session: Session, phase_id: str) -> list[Lead]:
    """Return the leaders of a phase over time, oldest first, without reading any board."""
    query = (
        select(
            BoardFlip.at,
            BoardRow.number,
            ProtocolRow.version,
            SplitRow.revision,
            SplitRow.part,
            BoardRow.leader,
        )
        .join(BoardRow, BoardRow.id == BoardFlip.board_id)
        .join(ProtocolRow, ProtocolRow.digest == BoardRow.protocol_digest)
        .join(Phase, Phase.id == BoardFlip.phase_id)
        .join(SplitRow, is_what_counts())
        .where(BoardFlip.phase_id == phase_id)
        .order_by(BoardFlip.at, BoardFlip.id)
    )
    aliases = aliases_in(session, phase_id)
    found = (Lead(*row) for row in session.execute(query))
    return [
        lead._replace(leader=lead.leader and under_alias(lead.leader, aliases)) for lead in found
    ]


def aliases_in(session: Session, phase_id: str) -> dict[str, str]:
    """Return the aliases of forgotten teams in a phase, by submission."""
    query = (
        select(Submission.id, Team.name)
        .join(Team, Team.id == Submission.team_id)
        .where(Submission.phase_id == phase_id, Team.forgotten_at.is_not(None))
    )
    return {submission_id: name for submission_id, name in session.execute(query)}


def under_alias(named: _Named, aliases: Mapping[str, str]) -> _Named:
    """Return the alias of a forgotten team, unless the board shows a pseudonym."""
    alias = None if is_pseudonym(named.team) else aliases.get(named.submission_id or "")
    return named if alias is None else named.model_copy(update={"team": alias})


def was_shown() -> ColumnElement[bool]:
    """Condition on `BoardRow`: a phase once pointed at it. Only organizers see drafts."""
    return exists().where(BoardFlip.board_id == BoardRow.id)


def is_draft(session: Session, row: BoardRow) -> bool:
    """Whether no phase ever pointed at a board."""
    return session.scalar(select(BoardRow.id).where(BoardRow.id == row.id, was_shown())) is None


def find_board(session: Session, phase_id: str, number: int) -> BoardRow:
    """Return a board by its permanent number.

    Raises:
        NotFound: There is none, or it was never shown: only organizers see drafts.
    """
    query = select(BoardRow).where(
        BoardRow.phase_id == phase_id, BoardRow.number == number, was_shown()
    )
    row = session.scalars(query).first()
    if row is None:
        raise NotFound("board", f"{phase_id}/{number}")
    return row


def _append(
    session: Session,
    request: BoardRequest,
    board: Board,
    digest: str,
    view: BoardView,
    kept_back: str,
) -> BoardRow:
    query = select(func.max(BoardRow.number)).where(BoardRow.phase_id == request.phase_id)
    number = (session.scalar(query) or 0) + 1
    now = database_now(session)
    numbered = board.model_copy(update={"board": number, "published_at": now})
    body = b"".join(numbered.canonical_pieces())
    row = BoardRow(
        phase_id=request.phase_id,
        protocol_digest=request.protocol_digest,
        split_revision=board.split.revision,
        number=number,
        digest=digest,
        body_digest=bytes_digest(body),
        body=body.decode("utf-8"),
        published_at=now,
        view=view,
        leader=_leader_of(board),
    )
    session.add(row)
    session.flush()
    entries = [
        {"board_id": row.id, "submission_id": entry.submission_id, "rank": entry.rank}
        for entry in board.entries
        if entry.submission_id is not None
    ]
    if entries:
        session.execute(insert(BoardEntryRow), entries)
    detail = {
        "number": number,
        "digest": row.digest,
        "protocol": request.protocol_digest,
        "view": view,
    }
    published, built = BOARD_LINES
    detail |= {"kept_back": kept_back} if kept_back else {}
    audit(session, "worker", built if kept_back else published, request.phase_id, detail)
    return row
