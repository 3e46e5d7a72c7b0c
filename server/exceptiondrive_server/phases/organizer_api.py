"""Phases, as organizers manage them."""

from collections.abc import Callable, Mapping
from typing import Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import latest_board, parsed_board
from exceptiondrive_records.boards.standings import names_of
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.changes import (
    delete_phase,
    feature_phase,
    freeze_phase,
    reveal_names,
)
from exceptiondrive_records.phases.phases import create_phase, find_phase, phase_view
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.reveal import reveal_split
from exceptiondrive_records.rescoring.showing import change_phase, reveal_board
from exceptiondrive_schemas.api.phase_settings import NewPhase, PhaseChange
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.board import Board
from exceptiondrive_server.phases.export import export_phase
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action
from exceptiondrive_server.web.organizer_rights import require_order_right
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import origin_of
from exceptiondrive_server.web.services import Services

router = APIRouter()


class Reveal(Action):
    """What is to be shown: the board behind a freeze, the names, or the other part of the split."""

    what: Literal["board", "names", "split"]


class LiveBoard(BaseModel):
    """The newest board of a phase, and the names of its entries."""

    is_public: bool
    names: dict[str, tuple[str, str]]
    """Submission to team and method."""
    board: Board


@router.post("/phases", operation_id="createPhase", status_code=201)
def post_phase(services: ServicesOf, organizer: Organizer, phase: NewPhase) -> PhaseView:
    """Create a phase."""
    with services.database.write() as session:
        made = create_phase(session, phase, actor=organizer.actor)
        return _view(session, services, made)


@router.patch("/phases/{phase_id}", operation_id="changePhase")
def patch_phase(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, change: PhaseChange
) -> PhaseView:
    """Change settings of a phase; a change that would break a promise is refused.

    Omitted fields stay, also within `page` and `policy`; null removes a limit or date.
    """
    require_order_right(organizer, change)
    with services.database.write() as session:
        phase = change_phase(session, phase_id, change, actor=organizer.actor)
        return _view(session, services, phase)


@router.post("/phases/{phase_id}/feature", operation_id="featurePhase")
def post_feature(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, step: Action
) -> PhaseView:
    """Feature a phase: it comes first in lists and on the front page."""
    with services.database.write() as session:
        phase = feature_phase(session, phase_id, reason=step.reason, actor=organizer.actor)
        return _view(session, services, phase)


@router.post("/phases/{phase_id}/delete", operation_id="deletePhase")
def post_deletion(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, step: Action
) -> PhaseView:
    """Delete a phase without any submission or rescoring run, with its empty boards."""
    with services.database.write() as session:
        gone = _view(session, services, find_phase(session, phase_id))
        delete_phase(session, phase_id, reason=step.reason, actor=organizer.actor)
    return gone


@router.get(
    "/phases/{phase_id}/export",
    operation_id="exportPhase",
    response_class=Response,
    responses={200: {"content": {"application/x-tar": {}}}},
)
def get_export(
    request: Request, services: ServicesOf, organizer: Organizer, phase_id: PhaseId
) -> Response:
    """Download the public data of a phase, as a tar for a paper or an archive."""
    return export_phase(services, organizer, phase_id, origin_of(request))


@router.post("/phases/{phase_id}/freeze", operation_id="freezePhase")
def post_freeze(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, step: Action
) -> PhaseView:
    """Freeze the public board now; scoring goes on."""
    with services.database.write() as session:
        phase = freeze_phase(session, phase_id, reason=step.reason, actor=organizer.actor)
        return _view(session, services, phase)


@router.post("/phases/{phase_id}/reveal", operation_id="revealPhase")
def post_reveal(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, step: Reveal
) -> PhaseView:
    """Reveal the board behind a freeze, or the names, which cannot be undone.

    `split` starts scoring the revealed part, which only organizers see: it is a rescoring run like any
    other, and the board changes when it is applied.
    """
    with services.database.write() as session:
        phase = _REVEALS[step.what](session, phase_id, reason=step.reason, actor=organizer.actor)
        return _view(session, services, phase)


_REVEALS: Mapping[str, Callable[..., Phase]] = {
    "board": reveal_board,
    "names": reveal_names,
    "split": reveal_split,
}


@router.get("/phases/{phase_id}/board", operation_id="showLiveBoard")
def get_live_board(services: ServicesOf, phase_id: PhaseId) -> LiveBoard:
    """Get the newest board, even behind a freeze, with the names behind its pseudonyms."""
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
        row = latest_board(session, phase.id, key_of_phase(phase))
        if row is None:
            raise NotFound("board of the phase", phase_id)
        board = parsed_board(row)
        return LiveBoard(
            is_public=row.id == phase.current_board_id,
            names=names_of(session, list(board.entries_by_submission)),
            board=board,
        )


def _view(session: Session, services: Services, phase: Phase) -> PhaseView:
    return phase_view(session, phase, max_upload_bytes=services.settings.max_upload_bytes)
