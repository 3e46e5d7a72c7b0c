"""Queries for phases and boards: the one place that selects a board, and what its pages need besides."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from math import inf
from typing import NamedTuple

from sqlalchemy import ScalarSelect, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import (
    board_at,
    current_board,
    find_board,
    is_what_counts,
    late_board,
    latest_public_board,
    parsed_board,
    public_protocols,
)
from exceptiondrive_records.boards.reported import reported_boards
from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.news.news import news_of
from exceptiondrive_records.phases.disqualified import disqualification_notes
from exceptiondrive_records.phases.phases import list_phases, not_checked
from exceptiondrive_records.phases.policy import (
    is_anonymous,
    is_open,
    phase_now,
    shown_sheet,
    takes_late_entries,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.protocols.shown import shown_protocol
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.rescoring.views import update_words
from exceptiondrive_records.splits.drawings import protocol_drawing
from exceptiondrive_records.splits.shown import shown_whole
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.edits import edits_of_phase, facts_of_entries
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.board import Board, EntryNews
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.drawing import ProtocolDrawing, pictured_digest
from exceptiondrive_schemas.method_facts import NO_FACTS, FactsOfBoard
from exceptiondrive_schemas.protocol import NEWEST, ProtocolDocument, packaged_protocol
from exceptiondrive_server.boards.charts import Curves, best_entries
from exceptiondrive_server.boards.entry_facts import challenge_of
from exceptiondrive_server.boards.exports import Feed, FeedItem
from exceptiondrive_server.boards.families import MAX_SHEETS, Tasks, hardest_tasks
from exceptiondrive_server.boards.headline import BoardBefore, headline, moves_on
from exceptiondrive_server.boards.page import BoardPage, PhaseLink, of_board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.selection import selected_board
from exceptiondrive_server.web.markdown import plain_text
from exceptiondrive_server.web.numbers import iso, minute

_NEWEST_BOARDS = 10
"""As many the history of a phase tells of in its feed."""


class _Said(NamedTuple):
    """What a feed says about a board: what is new, who leads, under which protocol."""

    news: str
    findings: str
    protocol: str


_SAID: Memory[str, _Said] = Memory(500)
"""By what stands for a board: ten long ones are not read for each look at a feed."""


def read_board(session: Session, query: BoardQuery, *, with_hidden: bool = False) -> BoardPage:
    """Read the board that a query asks for; hidden phases are there for organizers alone.

    Raises:
        NotFound: The phase, protocol or board does not exist.
    """
    phase = choose_phase(session, query, with_hidden=with_hidden)
    links = _phase_links(session, phase)
    if phase is None:
        protocol = packaged_protocol(NEWEST)
        return BoardPage(query, (), None, None, protocol, (), protocol.version)
    row = choose_board(session, phase, query)
    board = without_reported(parsed_board(row)) if row else None
    current = find_protocol(session, phase.protocol_digest)
    protocol = find_protocol(session, board.protocol.digest) if board else current
    curves, tasks = _told_by_sheets(session, phase, board, query.chosen) if board else ((), ())
    return BoardPage(
        query=query,
        phases=links,
        phase=next(link for link in links if link.is_current),
        board=board,
        protocol=protocol,
        protocol_versions=protocol_versions(session, phase.id),
        current_protocol=current.version,
        is_current=row is None or row.id in (phase.current_board_id, phase.late_board_id),
        now=phase_now(session, phase),
        has_late_view=phase.late_board_id is not None,
        has_reported=phase.shows_reported,
        n_reported=sum(len(one.rows.rows) for one in reported_boards(session, phase.id)),
        curves=curves,
        tasks=tasks,
        drawing=_drawing_of(session, protocol),
        before=_board_before(session, row) if row else None,
        facts=facts_on(session, board) if board else NO_FACTS,
        disqualified=disqualification_notes(session, phase),
    )


def facts_on(session: Session, board: Board) -> FactsOfBoard:
    """Return the present facts of the methods on a board, by submission; old boards too.

    The same object until a team edits something in the phase.
    """
    phase = session.get_one(Phase, board.phase)
    what = "facts", edits_of_phase(session, phase.id), is_anonymous(phase)
    ids = (entry.submission_id for entry in board.entries)
    return of_board(board, what, lambda: facts_of_entries(session, phase.id, ids))


def without_reported(board: Board) -> Board:
    """Return a board without reported rows, which are of other samples; cached by board."""
    return of_board(board, "without reported", lambda: _without_reported(board))


def _without_reported(board: Board) -> Board:
    kept = tuple([entry for entry in board.entries if entry.source != "reported"])
    return board.model_copy(update={"entries": kept}) if len(kept) < len(board.entries) else board


def _told_by_sheets(
    session: Session, phase: Phase, board: Board, chosen: tuple[str, ...]
) -> tuple[Curves, Tasks]:
    what = "sheets", chosen
    return of_board(board, what, lambda: _read_sheets(session, phase, board, chosen))


def _read_sheets(
    session: Session, phase: Phase, board: Board, chosen: tuple[str, ...]
) -> tuple[Curves, Tasks]:
    """Clearance curves of the first, and the tasks of many more, as far as their sheets tell them."""
    best = best_entries(board, chosen)
    ranked = [e.submission_id for e in board.entries if e.rank is not None][:MAX_SHEETS]
    rows = session.scalars(
        select(ScoreSheetRow).where(
            ScoreSheetRow.submission_id.in_({*ranked, *(entry.submission_id for entry in best)}),
            ScoreSheetRow.protocol_digest == board.protocol.digest,
            ScoreSheetRow.split_revision == board.split.revision,
        )
    )
    now = database_now(session)
    sheets = {row.submission_id: shown_sheet(phase, row, now) for row in rows}
    found = ((entry, sheets.get(entry.submission_id or "")) for entry in best)
    curves = ((entry, sheet.clearance_curve) for entry, sheet in found if sheet)
    protocol, metric = find_protocol(session, board.protocol.digest), challenge_of(board).metrics[0]
    of_ranked = [sheets[name] for name in ranked if name in sheets]
    tasks = hardest_tasks(of_ranked, protocol.taxonomy, metric)
    return tuple((entry, curve) for entry, curve in curves if curve is not None), tasks


_OWN_DRAWINGS: dict[str, ProtocolDrawing] = {}
"""By digest of the protocol: once made, a drawing never changes."""


def _drawing_of(session: Session, protocol: ProtocolDocument) -> ProtocolDrawing:
    kept = _OWN_DRAWINGS.get(protocol.digest)
    if kept is None:
        kept = protocol_drawing(session, protocol)
        if kept.pictured == pictured_digest(protocol):
            _OWN_DRAWINGS[protocol.digest] = kept
    return kept


def read_phases(
    session: Session, query: BoardQuery
) -> tuple[tuple[PhaseLink, ...], PhaseLink | None]:
    """Read all phases, and the one asked for.

    Raises:
        NotFound: The phase does not exist.
    """
    links = _phase_links(session, choose_phase(session, query))
    return links, next((link for link in links if link.is_current), None)


def _phase_links(session: Session, chosen: Phase | None) -> tuple[PhaseLink, ...]:
    phases = list_phases(session)
    if chosen is not None and chosen not in phases:
        phases.append(chosen)
    return tuple(phase_link(session, each, each is chosen) for each in phases)


def phase_link(session: Session, phase: Phase, is_current: bool = False) -> PhaseLink:
    """Return what pages say of a phase."""
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    whole = split if split.part is None else shown_whole(session, phase)
    now = database_now(session)
    challenge = CHALLENGES[phase.challenge]
    return PhaseLink(
        id=phase.id,
        title=phase.title,
        challenge=challenge,
        n_samples=split.n_samples,
        is_open=is_open(phase, now),
        is_ahead=phase.opens_at is not None and now < phase.opens_at,
        takes_late=takes_late_entries(session, phase, now),
        is_current=is_current,
        visibility=phase.visibility,
        description=phase.description,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        quota_per_day=phase.quota_per_day,
        rejected_per_day=phase.rejected_per_day,
        split=phase.split_name,
        split_is_public=split.public_file_digest is not None,
        has_data=bool(phase.page.data_url or phase.page.data_manifest_url),
        not_checked=not_checked(phase.challenge, whole),
        entries_private=phase.policy.entries_private,
        run_rule=phase.policy.run_rule(has_deadline=phase.closes_at is not None),
        url=f"/?phase={phase.id}#board",
    )


def choose_phase(session: Session, query: BoardQuery, *, with_hidden: bool = False) -> Phase | None:
    """Return the phase asked for, else the first by position, then in the order of challenges.

    Returns:
        None where no phase is named and there is none at all.

    Raises:
        NotFound: The phase does not exist, or is not of the challenge that is asked for.
    """
    phases = list_phases(session, with_hidden=with_hidden and query.phase is not None)
    if query.phase is not None:
        found = next((phase for phase in phases if phase.id == query.phase), None)
        if found is None:
            raise NotFound("phase", query.phase)
        if query.challenge is not None and found.challenge != query.challenge:
            raise NotFound(f"phase of the {query.challenge} challenge", query.phase)
        return found
    order = [query.challenge] if query.challenge else list(CHALLENGES)
    offered = [phase for phase in phases if phase.challenge in order]
    if query.challenge is not None and not offered:
        raise NotFound("phase of the challenge", query.challenge)
    return min(offered, key=lambda phase: _front_page_order(phase, order), default=None)


def featured_protocol(session: Session) -> ProtocolDocument:
    """Return the protocol of the phase on the front page; without any, the newest packaged one."""
    phase = choose_phase(session, BoardQuery())
    if phase is None:
        return packaged_protocol(NEWEST)
    return find_protocol(session, phase.protocol_digest)


def _front_page_order(phase: Phase, challenges: Sequence[str]) -> tuple[bool, float, int]:
    """Where a phase stands among those that may be the front page."""
    position = inf if phase.position is None else phase.position
    return phase.visibility == "archived", position, challenges.index(phase.challenge)


def choose_board(session: Session, phase: Phase, query: BoardQuery) -> BoardRow | None:
    """Return the board of a phase that is asked for; None where it has none yet.

    Raises:
        NotFound: The protocol or the board does not exist, or no late entry counts now.
    """
    if query.view == "late":
        row = late_board(session, phase.id)
        if row is None:
            raise NotFound("late view of the phase", phase.id, ": no late entry counts on it now")
        return row
    if query.board is not None:
        return find_board(session, phase.id, query.board)
    if query.protocol is not None:
        digest = shown_protocol(session, query.protocol).digest
        row = latest_public_board(session, phase.id, digest)
        if row is None:
            raise NotFound("board of this phase under protocol", query.protocol)
        return row
    if query.until is not None:
        row = board_at(session, phase.id, query.until)
        if row is None:
            raise NotFound("board of this phase as of", query.as_of_text)
        return row
    return current_board(session, phase.id)


def find_chosen_board(session: Session, query: BoardQuery) -> BoardRow:
    """Return the board that `choose_board` finds.

    Raises:
        NotFound: There is none.
    """
    phase = choose_phase(session, query)
    if phase is None:
        raise NotFound("phase", "", " yet")
    row = choose_board(session, phase, query)
    if row is None:
        raise NotFound("such board of the phase", phase.id)
    return row


def asked_entries(
    session: Session, query: BoardQuery
) -> tuple[Board, ProtocolDocument, FactsOfBoard]:
    """Return a board with the entries that are asked for, its protocol, and what its teams tell now.

    Raises:
        NotFound: There is no such board.
    """
    row = find_chosen_board(session, query)
    board = parsed_board(row)
    facts = facts_on(session, board)
    protocol = find_protocol(session, row.protocol_digest)
    return selected_board(board, query, facts), protocol, facts


def _board_before(session: Session, row: BoardRow) -> BoardBefore | None:
    """The board that was shown before this one was first shown; None for the first."""
    before = (
        select(func.max(BoardFlip.id))
        .where(BoardFlip.phase_id == row.phase_id, BoardFlip.id < _first_flip(row))
        .scalar_subquery()
    )
    query = (
        select(
            BoardRow.number,
            ProtocolRow.version,
            SplitRow.revision,
            SplitRow.part,
            BoardRow.told_at,
        )
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .join(ProtocolRow, ProtocolRow.digest == BoardRow.protocol_digest)
        .join(Phase, Phase.id == BoardRow.phase_id)
        .join(SplitRow, is_what_counts())
        .where(BoardFlip.id == before)
    )
    found = session.execute(query).first()
    return None if found is None else BoardBefore(*found, left=_entries_that_left(session, row))


def _first_flip(row: BoardRow) -> ScalarSelect[int]:
    return (
        select(func.min(BoardFlip.id))
        .where(BoardFlip.phase_id == row.phase_id, BoardFlip.board_id == row.id)
        .scalar_subquery()
    )


def _entries_that_left(session: Session, row: BoardRow) -> tuple[EntryNews, ...]:
    """What ranked on the board before this one, and is not on it; none where its news do not name all."""
    news = session.scalar(select(BoardFlip.news).where(BoardFlip.id == _first_flip(row)))
    entries = news.entries if news and not news.n_more else ()
    return tuple([each for each in entries if each.has_left and each.rank is not None])


def protocol_versions(session: Session, phase_id: str) -> tuple[str, ...]:
    """Versions under which this phase has a board, oldest first."""
    used = public_protocols(session, phase_id)
    query = select(ProtocolRow.version).where(ProtocolRow.digest.in_(used))
    return tuple(session.scalars(query.order_by(ProtocolRow.created_at)))


def read_feed(session: Session, query: BoardQuery) -> Feed:
    """Read what happened to a phase: its newest boards, news, dates.

    Raises:
        NotFound: The phase does not exist, or there is none at all.
    """
    phase = choose_phase(session, query)
    if phase is None:
        raise NotFound("phase", "", " yet")
    newest = (
        select(BoardFlip, BoardRow)
        .join(BoardRow, BoardRow.id == BoardFlip.board_id)
        .where(BoardFlip.phase_id == phase.id)
        .order_by(BoardFlip.at.desc(), BoardFlip.id.desc())
        .limit(_NEWEST_BOARDS)
    )
    changes = update_words(session, phase.id)
    boards = [
        _board_item(session, phase, flip, row, changes.get(flip.id, ()))
        for flip, row in session.execute(newest)
    ]
    news = [
        FeedItem(
            row.published_at,
            row.title,
            f"/phases/{phase.id}#news-{row.id}",
            summary=plain_text(row.text),
        )
        for row in news_of(session, phase.id)
    ]
    items = _phase_items(phase, _shown_since(session, phase), database_now(session))
    return Feed(phase.id, phase.title, (*boards, *news, *items))


def _shown_since(session: Session, phase: Phase) -> datetime:
    """Return since when readers find the phase: its making, or when it was hidden no more."""
    query = (
        select(AuditLine)
        .where(AuditLine.subject == phase.id, AuditLine.action == "phase changed")
        .where(AuditLine.at >= phase.created_at)
        .order_by(AuditLine.id.desc())
    )
    for line in session.scalars(query):
        if "hidden" in line.detail.get("visibility", ()):
            return line.at
    return phase.created_at


def _phase_items(phase: Phase, shown_since: datetime, now: datetime) -> Iterator[FeedItem]:
    """Events of a phase, newest first, dated so that feed readers notice each when it happens."""

    def item(what: str, at: datetime, words: str) -> FeedItem:
        return FeedItem(at, words, f"/phases/{phase.id}", f"#{what}-{iso(at)}")

    if phase.closes_at is not None and phase.closes_at <= now:
        yield item("closed", phase.closes_at, f"{phase.title} has closed")
    if phase.opens_at is not None:
        if phase.opens_at <= now:
            yield item("opened", phase.opens_at, f"{phase.title} is open for submissions")
        if shown_since < phase.opens_at:
            words = f"{phase.title} opens {minute(phase.opens_at)}"
            yield item("announced", shown_since, words)


def _board_item(
    session: Session, phase: Phase, flip: BoardFlip, row: BoardRow, what_changed: tuple[str, ...]
) -> FeedItem:
    """Tell of a board as it was shown once: what is new, what an update changed, who leads.

    The reason of an update stays with the organizers.
    """
    said = _SAID.get(row.told) or _SAID.keep(row.told, _said_of(session, row), 1)
    is_again = flip.at != row.told_at
    title = f"Board {row.number} of {phase.title}"
    news = f"{title} is shown again" if is_again else said.news
    short = "shown again" if is_again else said.news
    told = [news, *what_changed, said.findings, f"Protocol {said.protocol}"]
    return FeedItem(
        flip.at,
        f"{title}: {short.rstrip('.')}" if short else title,
        f"/?phase={phase.id}&board={row.number}",
        f"#again-{flip.id}" if is_again else "",
        " ".join(f"{words.rstrip('.')}." for words in told if words),
    )


def _said_of(session: Session, row: BoardRow) -> _Said:
    board, protocol = parsed_board(row), find_protocol(session, row.protocol_digest)
    said = headline(board, challenge_of(board), protocol)
    moves = "; ".join(moves_on(board, _entries_that_left(session, row)))
    news = f"{moves[0].upper()}{moves[1:]}." if moves else ""
    return _Said(news, " ".join(said.findings), protocol.version)
