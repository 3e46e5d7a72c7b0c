"""What a protocol update or a new split revision changed, as the public sees it."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.views import public_run
from exceptiondrive_schemas.api.rescoring import PublicRun
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.rescoring.preview import compared
from exceptiondrive_server.rescoring.steps import change_words
from exceptiondrive_server.web.browser_session import browser_sees_hidden
from exceptiondrive_server.web.responses import Values, public_page

router = APIRouter(include_in_schema=False)


@router.get("/rescoring/{run_id}")
def show_update(
    request: Request,
    run_id: Annotated[str, Path(max_length=64)],
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> Response:
    """Compare every entry before and after a run that was applied; others have no address."""

    def read(session: Session) -> Values:
        run = public_run(session, run_id, with_hidden=browser_sees_hidden(session, request))
        phase = find_phase(session, run.phase)
        protocol = find_protocol(session, run.to_protocol.digest)
        return {
            "run": run,
            "phase_title": phase.title,
            "change": change_words(session, run),
            "sentences": _sentences(run, protocol),
            **compared(run.comparison, protocol, page, phase),
        }

    return public_page(request, "rescoring/update.html", "board", read)


def _sentences(run: PublicRun, protocol: ProtocolDocument) -> list[str]:
    """What changed: in the words of the new protocol, if there is one, then point by point."""
    words = [protocol.changes] if run.from_protocol != run.to_protocol else []
    return words + [change.sentence for change in run.difference.changes]
