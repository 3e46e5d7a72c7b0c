"""The page of a phase: its task, rules, terms and prize, dates, data, contact."""

from fastapi import APIRouter, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import find_board, parsed_board
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.news.news import news_of
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.phases.policy import frozen_since, shows_pseudonyms
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_server.boards.headline import what_else_tells
from exceptiondrive_server.boards.queries import phase_link
from exceptiondrive_server.news.views import news_view
from exceptiondrive_server.phases.report import has_ended, report_of
from exceptiondrive_server.web.browser_session import browser_sees_hidden
from exceptiondrive_server.web.numbers import Digits
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import Values, public_page

router = APIRouter(include_in_schema=False)


@router.get("/phases/{phase_id}")
def show_phase(request: Request, phase_id: PhaseId) -> Response:
    """Show what a phase is about; a hidden one to organizers alone."""

    def read(session: Session) -> Values:
        phase = shown_phase(session, phase_id, with_hidden=browser_sees_hidden(session, request))
        now, freezes_at = database_now(session), phase.policy.freezes_at
        return {
            "phase": phase_link(session, phase, True),
            "text": phase.page,
            "news": [news_view(row) for row in news_of(session, phase.id)],
            "protocol": find_protocol(session, phase.protocol_digest).version,
            "part": find_split(session, phase.split_name, phase.split_revision).part,
            "quota_total": phase.quota_total,
            "freezes_at": freezes_at if freezes_at and freezes_at > now else None,
            "frozen_since": frozen_since(phase, now),
            "shows_pseudonyms": shows_pseudonyms(session, phase),
            "terms_required": phase.policy.terms_required,
            "has_report": has_ended(session, phase),
        }

    return public_page(request, "phases/phase.html", "board", read)


@router.get("/phases/{phase_id}/report")
def show_report(request: Request, phase_id: PhaseId) -> Response:
    """Show how a phase ended; before its end there is no such page."""

    def read(session: Session) -> Values:
        phase = shown_phase(session, phase_id, with_hidden=browser_sees_hidden(session, request))
        report = report_of(session, phase)
        board = parsed_board(find_board(session, phase.id, report.board))
        protocol = find_protocol(session, report.protocol.digest)
        challenge = CHALLENGES[report.challenge]
        could = board.contenders(protocol.ranking.order_of(challenge)[0])
        return {
            "report": report,
            "challenge": challenge,
            "flags": FLAGS,
            "digits": Digits.of(protocol.publication, has_fine_intervals=board.has_fine_intervals),
            "told_by": what_else_tells(board, could),
        }

    return public_page(request, "phases/report.html", "board", read)
