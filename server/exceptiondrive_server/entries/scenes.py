"""The scenes that all entries of a public split share, one a family, and the entries shown in them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from urllib.parse import urlencode

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.splits.drawings import drawn_submissions, entry_drawings
from exceptiondrive_records.splits.pictures import pictures_of
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.drawing import EntryDrawings, SampleDrawing
from exceptiondrive_server.boards.charts import labels_of
from exceptiondrive_server.boards.comparison import LONGEST_NAME
from exceptiondrive_server.boards.entry_facts import board_fields, entry_key, entry_url
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.entries.motion import Motion, motion, scene_of_family

MAX_SHOWN = 3
MAX_OFFERED = 50


@dataclass(frozen=True)
class Scenes:
    """Scenes with those who drive them.

    `asked` is the board that was asked for, `shown` the one whose planners are shown: another one
    where the split of the first is withheld. `offered` are the entries to choose from.
    """

    asked: BoardPage
    shown: BoardPage
    chosen: tuple[BoardEntry, ...]
    offered: tuple[BoardEntry, ...]
    scenes: tuple[Motion, ...]

    @property
    def is_borrowed(self) -> bool:
        """Whether these are the scenes and planners of another phase."""
        return self.shown is not self.asked

    @property
    def choices(self) -> list[tuple[str, str]]:
        """Key and name of each entry that may join the first."""
        named = zip(self.offered, labels_of(self.offered, LONGEST_NAME), strict=True)
        return [(entry_key(each), name) for each, name in named if each is not self.chosen[0]]

    @property
    def others(self) -> tuple[str, str]:
        """Keys of the second and third entry; empty where there is none."""
        keys = [*(entry_key(entry) for entry in self.chosen[1:]), "", ""]
        return keys[0], keys[1]

    @property
    def kept_fields(self) -> tuple[tuple[str, str], ...]:
        """What names the board that was asked for."""
        board = self.asked.board
        if board is None:
            return (("phase", self.asked.phase.id),) if self.asked.phase else ()
        return board_fields(board, self.asked.is_current)

    @property
    def address(self) -> str:
        """The query that shows the same again."""
        more = [("with", key) for key in self.others if key]
        return urlencode([*self.kept_fields, *more])


def read_scenes(session: Session, query: BoardQuery, keys: Sequence[str] = ()) -> Scenes:
    """Read the scenes of a board: those of its leader, and of up to two more entries.

    A phase whose split is withheld borrows scenes and planners of the first phase of its challenge
    whose split is public. Before anything is drawn, there are no scenes.

    Raises:
        NotFound: There is no such board, or an entry is not drawn there.
    """
    asked = read_board(session, query)
    shown = (
        asked
        if asked.phase is None or asked.phase.split_is_public
        else _phase_with_scenes(session, asked)
    )
    if shown is None or shown.board is None:
        return Scenes(asked, shown or asked, (), (), ())
    drawn = _drawn_entries(session, shown.board, is_current=shown.is_current)
    if not drawn:
        return Scenes(asked, shown, (), (), ())
    leader = shown.board.leader if shown.board.leader in drawn else drawn[0]
    by_key = {entry_key(entry): entry for entry in drawn}
    chosen = [leader]
    for key in dict.fromkeys(key for key in keys if key):
        if key not in by_key:
            raise NotFound("entry that is drawn", key)
        if by_key[key] is not leader:
            chosen.append(by_key[key])
    chosen = chosen[:MAX_SHOWN]
    offered = [*drawn[:MAX_OFFERED], *(entry for entry in chosen if entry in drawn[MAX_OFFERED:])]
    drawings = [_drawings_of(session, shown.board, entry) for entry in chosen]
    scenes = tuple(_scenes(session, shown, chosen, drawings))
    return Scenes(asked, shown, tuple(chosen), tuple(offered), scenes)


def _phase_with_scenes(session: Session, asked: BoardPage) -> BoardPage | None:
    """The first phase of the same challenge whose split is public and which has a board."""
    for link in asked.phases:
        if link.split_is_public and link.challenge is asked.challenge:
            reading = read_board(session, BoardQuery(phase=link.id))
            if reading.board is not None:
                return reading
    return None


def _drawn_entries(session: Session, board: Board, *, is_current: bool) -> list[BoardEntry]:
    """Entries that have drawings, in the order of the board; nothing of what was withdrawn."""
    drawn = drawn_submissions(session, board.protocol.digest, board.split.revision)
    if not is_current:
        withdrawn = select(Submission.id).where(Submission.status == SubmissionStatus.WITHDRAWN)
        drawn -= set(session.scalars(withdrawn.where(Submission.phase_id == board.phase)))
    return [entry for entry in board.entries if entry.submission_id in drawn]


def _drawings_of(session: Session, board: Board, entry: BoardEntry) -> EntryDrawings:
    assert entry.submission_id is not None
    key = (entry.submission_id, board.protocol.digest, board.split.revision)
    found = entry_drawings(session, *key)
    if found is None:
        raise NotFound("entry that is drawn", entry.submission_id)
    return found


def _scenes(
    session: Session,
    shown: BoardPage,
    chosen: Sequence[BoardEntry],
    drawings: Sequence[EntryDrawings],
) -> Iterator[Motion]:
    assert shown.board is not None
    drawn_ids = [each.drawing.sample_id for each in drawings[0].samples]
    pictures = pictures_of(session, shown.board.split, drawn_ids)
    path, _, query = entry_url(chosen[0], shown.board, shown.is_current).partition("?")
    for family in shown.protocol.families:
        runs: list[tuple[str, SampleDrawing]] = []
        for entry, each in zip(chosen, drawings, strict=True):
            scene = scene_of_family(each.samples, family.id)
            if scene is not None:
                runs.append((entry.method, scene))
        if runs:
            url = f"{path}/samples/scene-{family.id}" + (f"?{query}" if query else "")
            shots = pictures.get(runs[0][1].sample_id, ())
            yield motion(runs, shown.protocol, url, shots)
