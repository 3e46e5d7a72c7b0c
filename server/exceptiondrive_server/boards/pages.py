"""Routes of the board page, of the list of all boards, of exports and of the feed."""

from fastapi import APIRouter, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.boards.boards import late_board, leads
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.operations.site import site_links
from exceptiondrive_records.phases.disqualified import notes_by_submission
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.submissions.submissions import ids_of_team
from exceptiondrive_schemas.challenges import CHALLENGES, KnownChallenge
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.reported import reported_paper
from exceptiondrive_server.boards.exports import EXPORTS, atom_feed, file_name_header
from exceptiondrive_server.boards.headline import own_entries
from exceptiondrive_server.boards.lead_chart import lead_chart, takers
from exceptiondrive_server.boards.page import NARROW_PX, PhaseLink
from exceptiondrive_server.boards.queries import (
    asked_entries,
    phase_link,
    read_board,
    read_feed,
    read_phases,
)
from exceptiondrive_server.boards.query import (
    BoardQuery,
    BoardQueryOf,
    board_query_of,
    require_known,
)
from exceptiondrive_server.boards.reported import reported_of
from exceptiondrive_server.guide.client_files import client_wheel
from exceptiondrive_server.web.auth import ServicesOf, sees_hidden
from exceptiondrive_server.web.browser_session import (
    Holder,
    browser_sees_hidden,
    holder_of,
    principal_of_browser,
)
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.numbers import Digits
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import (
    SECURITY_HEADERS,
    Values,
    origin_of,
    page,
    public_page,
)
from exceptiondrive_server.web.services import services_of

router = APIRouter(include_in_schema=False)
front = APIRouter(include_in_schema=False)
"""The board alone, which is matched before all other routes: matching costs more than answering."""
MAX_HISTORY = 100
MAX_TAKERS = 8


@front.get("/")
def show_board(request: Request) -> Response:
    """Show the board that the address asks for; a team that signed in finds its rows marked.

    What visitors see is kept for a second.
    """
    asked = request.query_params
    if "apply" in asked or "order" in asked:  # sent by the filter form: its address is made short
        return RedirectResponse(board_query_of(request).url(), status_code=303)
    require_known(request)
    if holder_of(request) is not Holder.VISITOR:
        return _signed_in_board(request)
    return public_page(request, "boards/board.html", "board", lambda it: _public_board(it, request))


def _public_board(session: Session, request: Request) -> Values:
    board = read_board(session, board_query_of(request))
    return {"page": board, "own": None, "wheel": client_wheel(services_of(request))}


def _signed_in_board(request: Request) -> Response:
    query = board_query_of(request)
    with services_of(request).database.read() as session:
        who = principal_of_browser(session, request)
        board = read_board(session, query, with_hidden=sees_hidden(who))
        ids = _own_submissions(session, who, board.phase)
    own = own_entries(board.board, ids, query) if board.board and ids else None
    wheel = client_wheel(services_of(request))
    return page(request, "boards/board.html", "board", page=board, own=own, wheel=wheel)


def _own_submissions(
    session: Session, who: Principal | None, phase: PhaseLink | None
) -> frozenset[str]:
    """Return what the team that signed in, and may read its submissions, sent to the phase."""
    if who is None or who.team_id is None or phase is None or Scope.READ_OWN not in who.scopes:
        return frozenset()
    return ids_of_team(session, who.team_id, phase.id)


@router.get("/history")
def show_history(request: Request, query: BoardQueryOf) -> Response:
    """Show every board that a phase ever had."""
    require_known(request)
    return public_page(request, "boards/history.html", "board", lambda it: _history(it, query))


def _history(session: Session, query: BoardQuery) -> Values:
    phases, phase = read_phases(session, query)
    if phase is None:
        raise NotFound("phase", "", " yet")
    lines, who = board_history(session, phase.id), leads(session, phase.id)
    has_late_view = late_board(session, phase.id) is not None
    now = database_now(session).replace(second=0, microsecond=0)  # the chart ends with this minute
    row = shown_phase(session, phase.id)
    digits = Digits.of(find_protocol(session, row.protocol_digest).publication)
    metric = phase.challenge.metrics[0]
    newest = lines[:MAX_HISTORY]
    listed = {line.board for line in newest}
    return {
        "phase": phase,
        "phases": phases,
        "lines": newest,
        "n_more": len(lines) - len(newest),
        "has_late_view": has_late_view,
        "disqualified": notes_by_submission(session, row),
        "chart": lead_chart(who, now, metric, digits),
        "narrow_chart": lead_chart(who, now, metric, digits, width=NARROW_PX[0]),
        "leaders": {lead.number: lead.leader for lead in who if lead.number in listed},
        "took_the_lead": takers(who)[:MAX_TAKERS],
        "metric": metric,
        "digits": digits,
    }


@router.get("/reported/{challenge}")
def show_reported(request: Request, challenge: KnownChallenge) -> Response:
    """Show what the paper reports, digit for digit: other samples, under another protocol."""
    paper = reported_paper()
    if challenge not in paper.challenges:
        raise NotFound("paper that reports on", challenge)
    return page(
        request,
        "boards/reported.html",
        "board",
        challenge=CHALLENGES[challenge],
        paper=paper,
        reported=paper.challenges[challenge],
        families=packaged_protocol().families,
    )


@router.get("/phases/{phase_id}/reported")
def show_reported_boards(request: Request, phase_id: PhaseId) -> Response:
    """Show external boards beside a phase, each row with what differs; nothing there ranks."""

    def read(session: Session) -> Values:
        phase = shown_phase(session, phase_id, with_hidden=browser_sees_hidden(session, request))
        challenge, boards = CHALLENGES[phase.challenge], reported_of(session, phase)
        protocol = find_protocol(session, phase.protocol_digest)
        return {
            "phase": phase_link(session, phase, True),
            "challenge": challenge,
            "boards": boards,
            "families": {family.id: family.title for family in protocol.families},
            "digits": Digits.of(protocol.publication),
        }

    return public_page(request, "boards/reported_boards.html", "board", read)


@router.get("/export/board.{form}")
def export_board(
    request: Request, services: ServicesOf, query: BoardQueryOf, form: str
) -> Response:
    """Give a board as CSV, LaTeX or BibTeX."""
    export = EXPORTS.get(form)
    if export is None:
        raise NotFound("export", form)
    with services.database.read() as session:
        board, protocol, facts = asked_entries(session, query)
        citation = site_links(session).citation
    text = export.write(board, protocol, origin_of(request), facts, citation)
    headers = {**SECURITY_HEADERS, **file_name_header(board, form)}
    return conditional(request, text.encode(), export.media_type, headers=headers)


@router.get("/feed.atom")
def feed(request: Request, services: ServicesOf, query: BoardQueryOf) -> Response:
    """Tell what happened to a phase as an Atom feed: its newest boards, news, dates."""
    with services.database.read() as session:
        told = read_feed(session, query)
    text = atom_feed(told, origin_of(request))
    return conditional(request, text.encode(), "application/atom+xml", headers=SECURITY_HEADERS)
