"""External boards: imported beside a phase, and withdrawn; each step on a page of its own."""

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response

from exceptiondrive_records.boards.reported import (
    MAX_FILE,
    MAX_TITLE,
    find_reported_board,
    import_board,
    withdraw_reported_board,
)
from exceptiondrive_records.boards.reported_files import MAX_CITE
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_server.boards.reported import reported_of
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_at,
)
from exceptiondrive_server.web.path_ids import PhaseId

router = APIRouter(prefix="/organize/phases/{phase_id}/reported", include_in_schema=False)
ReportedId = Annotated[str, Path(max_length=64)]


@router.get("")
def show_reported_boards(browser: OrganizerBrowser, phase_id: PhaseId) -> Response:
    """List the imported boards of a phase."""
    with browser.services.database.read() as session:
        phase = find_phase(session, phase_id)
        boards = reported_of(session, phase, with_withdrawn=True)
    template = "boards/organizer_reported.html"
    return organizer_page(browser, template, "phases", phase=phase, boards=boards)


@step_at(router, "/new")
def board_import(services: ServicesOf, phase_id: PhaseId) -> Step:
    """Put the rows of another board beside a phase."""
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
    keys = CHALLENGES[phase.challenge].metric_keys
    columns = f"method, team, split, split_revision, protocol, protocol_digest, average, n_samples, {', '.join(keys)}"
    return _step(
        phase,
        title=f"Import an external board beside {phase.title}",
        meaning="Its rows appear on a page of their own, each with what differs from this phase; they "
        "are never ranked, and no board changes. Either the whole file is imported or nothing. It is a "
        "CSV file, such as this software exports for a board.",
        button="Import the rows",
        fields=(
            FormField("title", "Title", hint="name of the other board", is_required=True,
                      max_length=MAX_TITLE),
            FormField("cite", "Source", hint="its address, or a citation", is_required=True,
                      max_length=MAX_CITE),
            FormField("file", "File", "lines", "paste its whole text", is_required=True,
                      max_length=MAX_FILE),
        ),
        facts=(("Columns", columns), ("Required", "method, split, split_revision, protocol, one metric")),
        command=f'exceptiondrive organizer phases import-reported {phase.id} FILE --title "…" --cite "…"',
        take=partial(import_board, phase_id=phase_id),
        done="reported_imported",
    )  # fmt: skip


@step_at(router, "/{reported_id}/withdraw")
def board_withdrawal(services: ServicesOf, phase_id: PhaseId, reported_id: ReportedId) -> Step:
    """Take the rows of another board away."""
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
        row = find_reported_board(session, phase_id, reported_id)
    return _step(
        phase,
        title=f"Withdraw {row.title}",
        meaning="Its rows are removed from the page of external boards. They can be imported again.",
        button="Withdraw the rows",
        fields=(REASON,),
        facts=(("Source", row.cite), ("Rows", str(len(row.rows.rows)))),
        command=f'exceptiondrive organizer phases withdraw-reported {phase.id} {row.id} --reason "…"',
        blockers=() if row.withdrawn_at is None else ("These rows are already withdrawn.",),
        take=partial(withdraw_reported_board, phase_id=phase_id, reported_id=reported_id),
        done="reported_withdrawn",
    )


def _step(phase: Phase, **words: Any) -> Step:
    here = f"/organize/phases/{phase.id}/reported"
    return Step(section="phases", back=here, back_words="External boards", **words)
