"""A phase as one tar for a paper or an archive; it holds only what readers may see."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from fastapi.responses import Response
from pydantic import BaseModel
from pydantic_core import to_jsonable_python
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.boards import (
    current_board,
    latest_public_board,
    parsed_board,
    public_protocols,
    served_body,
)
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.operations.site import site_links
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol, find_protocol_row
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.submissions.views import published_sheets
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.method_facts import EntryFacts
from exceptiondrive_schemas.printable import spreadsheet_text
from exceptiondrive_schemas.score_sheet import MetricRow, ScoreSheet
from exceptiondrive_server.boards.exports import EXPORTS
from exceptiondrive_server.boards.queries import facts_on, without_reported
from exceptiondrive_server.boards.reported import reported_of
from exceptiondrive_server.phases.every_eval_ever import record_of, record_path
from exceptiondrive_server.phases.report import board_before_reveal, has_ended, report_of
from exceptiondrive_server.submissions.download import tar_answer, tar_stream, written_down
from exceptiondrive_server.web.numbers import minute
from exceptiondrive_server.web.services import Services

Members = Iterator[tuple[str, bytes]]


def export_phase(
    services: Services, principal: Principal, phase_id: str, site_url: str
) -> Response:
    """Return a phase as a tar; the same records give the same bytes.

    Raises:
        NotFound: There is no such phase, or it shows no board.
    """
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
        row = current_board(session, phase.id)
        if row is None:
            raise NotFound("board of the phase", phase.id)
        folder, number = f"exceptiondrive-{phase.id}-board-{row.number}", row.number
        members = (
            (f"{folder}/{name}", data) for name, data in _members(session, phase, row, site_url)
        )
        parts = written_down(tar_stream(members, row.told_at))
    with services.database.write() as session:
        audit(session, principal.actor, "phase exported", phase_id, {"board": number})
    return tar_answer(parts, f"{folder}.tar")


def _members(session: Session, phase: Phase, row: BoardRow, site_url: str) -> Members:
    board = without_reported(parsed_board(row))
    facts = facts_on(session, board)
    sheets = _sheets(session, phase, board)
    citation = site_links(session).citation
    yield "README.md", _readme(phase, board, len(sheets)).encode()
    if has_ended(session, phase):
        yield "report.json", canonical_json(report_of(session, phase))
    yield "history.json", _canonical(board_history(session, phase.id))
    if reported := reported_of(session, phase):
        yield "reported.json", _canonical(reported)
    for each in _boards(session, phase, row):
        name = f"boards/board-{each.number}"
        yield f"{name}.json", served_body(each).encode()
        document = without_reported(parsed_board(each))
        protocol = find_protocol(session, each.protocol_digest)
        for form, export in EXPORTS.items():
            text = export.write(document, protocol, site_url, facts_on(session, document), citation)
            yield f"{name}.{form}", text.encode()
    yield from _tables(board, sheets)
    yield "facts.json", _canonical(facts)
    for key, sheet in sheets.items():
        yield f"sheets/{key}.json", canonical_json(sheet)
    for digest in sorted(public_protocols(session, phase.id)):
        stored = find_protocol_row(session, digest)
        yield f"protocols/{stored.version}.toml", stored.toml.encode()
    datasheet = find_split(session, board.split.name, board.split.revision).datasheet
    if datasheet is not None:
        yield "datasheet.json", canonical_json(datasheet)
    for entry in board.entries:
        key = entry.submission_id or ""
        if entry.source == "scored" and key in sheets:
            told = facts.get(key, EntryFacts())
            record = record_of(board, entry, sheets[key], told, site_url)
            yield f"every_eval_ever/{record_path(record)}", canonical_json(record)


def _canonical(documents: Sequence[BaseModel] | Mapping[str, BaseModel]) -> bytes:
    return canonical_json(to_jsonable_python(documents, by_alias=True))


def _boards(session: Session, phase: Phase, row: BoardRow) -> list[BoardRow]:
    """The board of now, the last one before a reveal, and the last one under each protocol."""
    digests = public_protocols(session, phase.id)
    of_protocols = [latest_public_board(session, phase.id, digest) for digest in digests]
    found = (row, board_before_reveal(session, phase, row), *of_protocols)
    by_number = {each.number: each for each in found if each is not None}
    return [by_number[number] for number in sorted(by_number)]


def _sheets(session: Session, phase: Phase, board: Board) -> dict[str, ScoreSheet]:
    """The sheets of the entries on a board, by submission, as the page of each entry shows them."""
    ids = [entry.submission_id for entry in board.entries if entry.submission_id]
    found = published_sheets(session, phase, set(ids), database_now(session))
    return {key: found[key] for key in ids if key in found}


def _tables(board: Board, sheets: dict[str, ScoreSheet]) -> Members:
    """Every number of every sheet, one line per entry and average, family or task."""
    import pandas as pd  # takes most of a second, which nobody else shall wait for

    by_id = {entry.submission_id: entry for entry in board.entries}
    lines = [
        {
            "phase": board.phase,
            "board": board.board,
            "protocol": board.protocol.version,
            "split_revision": board.split.revision,
            "submission_id": key,
            "method": spreadsheet_text(by_id[key].method),
            "team": spreadsheet_text(by_id[key].team),
            "source": by_id[key].source,
            "rank": by_id[key].rank,
            "scope": scope,
            "id": name,
            "n": n,
            **values,
        }
        for key, sheet in sheets.items()
        for scope, name, n, values in _rows(sheet)
    ]
    frame = pd.DataFrame(lines)
    if not frame.empty:
        frame = frame.astype({"rank": "Int64", "n": "Int64"})
    yield "results.csv", frame.to_csv(index=False, lineterminator="\n").encode()
    yield "results.parquet", frame.to_parquet(index=False)


def _rows(sheet: ScoreSheet) -> Iterable[tuple[str, str, int | None, MetricRow]]:
    yield "average", "micro", sheet.n, sheet.micro
    yield "average", "macro_family", sheet.n, sheet.macro_family
    for scope, rows in (("family", sheet.families), ("task", sheet.tasks)):
        for name, row in rows.items():
            yield scope, name, row.n, row.metrics


def _readme(phase: Phase, board: Board, n_sheets: int) -> str:
    part = f", the {board.part} part" if board.part else ""
    licence = (
        f"Licence of its scenes: {phase.page.data_licence}\n\n" if phase.page.data_licence else ""
    )
    return f"""# {phase.title}

Phase `{phase.id}` of ExceptionDrive as board {board.board} shows it, published {minute(board.published_at)}:
{board.n_samples} samples of split `{board.split.name}`{part} (`{board.split.revision}`),
protocol {board.protocol.version} (`{board.protocol.digest}`).

{licence}Shares are fractions, lengths are metres; what is undefined is null or empty. Everything here is
what readers of the site may see. Of a withheld split there is no region, no sample's value and no
number that the boards and score sheets do not tell.

- `boards/board-N.json`: the board as it was served: the present one, the last one before a reveal,
  the last one under each protocol. `.csv` for tools, `.tex` a table for a paper, `.bib` its citation.
- `history.json`: every board that readers saw, from when until when, and what changed.
- `reported.json`: rows of external boards, which rank nowhere; missing where there are none.
- `report.json`: how the phase ended; missing while it has not.
- `sheets/ID.json`: score sheets of {n_sheets} entries with families and tasks, by submission.
- `results.csv`, `results.parquet`: the same numbers as one table; `scope` is average, family or task.
  `over_caution` is a share of the controls alone, which `n` leaves out; the datasheet counts them.
- `facts.json`: what teams tell of their methods, by submission.
- `protocols/VERSION.toml`: every constant that made the numbers.
- `datasheet.json`: how the split was made, where its makers say so.
- `every_eval_ever/data/...`: each scored entry as a record of the shared schema Every Eval Ever, in the
  folders of its store; of metrics that have a better direction.
"""
