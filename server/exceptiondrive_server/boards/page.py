"""The board page as one value: what was read from the records, set for one visitor."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.drawing import ProtocolDrawing, packaged_drawing
from exceptiondrive_schemas.phase_settings import PhaseNow
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.rescoring import BoardHistoryLine
from exceptiondrive_server.boards.entry_facts import board_fields, entry_key
from exceptiondrive_server.boards.headline import Headline, headline
from exceptiondrive_server.boards.query import AVERAGE_TITLES, AVERAGES, BoardQuery
from exceptiondrive_server.boards.view import BoardView, board_view
from exceptiondrive_server.protocols.scene_drawing import SceneDrawing, scene_drawing
from exceptiondrive_server.web.numbers import Digits, day, listed, minute
from exceptiondrive_server.web.page_parts import Choice, MetricCard, Notice, PhaseLink, metric_cards

# What a board changed since the board before it, in one plain line; and the list of all boards.


MAX_NAMED = 3


@dataclass(frozen=True)
class BoardBefore:
    """The board that was shown before, without its entries."""

    number: int
    protocol: str
    published_at: datetime


@dataclass(frozen=True)
class ChangeLine:
    """The line, and where the whole history stands."""

    words: str
    history_url: str
    protocol_url: str | None
    """The page that says what the new protocol changed."""


def change_line(board: Board, before: BoardBefore | None) -> ChangeLine:
    """Say what is new: the protocol, entries, ranks."""
    history_url = f"/history?phase={board.phase}"
    if before is None:
        return ChangeLine("This is the first board of its phase.", history_url, None)
    is_updated = before.protocol != board.protocol.version
    parts = [f"protocol {before.protocol} became {board.protocol.version}"] if is_updated else []
    parts += _entry_parts(board)
    since = f"Since board {before.number} of {day(before.published_at)}"
    words = f"{since}: {'; '.join(parts)}." if parts else f"{since} no rank moved."
    return ChangeLine(
        words, history_url, f"/protocols/{board.protocol.version}" if is_updated else None
    )


def _entry_parts(board: Board) -> list[str]:
    ranked = [entry for entry in board.entries if entry.rank is not None]
    new = [entry for entry in ranked if entry.previous_rank is None]
    up = [entry for entry in ranked if _steps_up(entry) > 0]
    down = [entry for entry in ranked if _steps_up(entry) < 0]
    parts = []
    if new:
        parts.append(f"{counted(len(new), 'new entry', 'new entries')}{_named(new)}")
    if up:
        parts.append(f"{len(up)} moved up{_named(up)}")
    if down:
        parts.append(f"{len(down)} moved down{_named(down)}")
    return parts


def _named(entries: list[BoardEntry]) -> str:
    """Name a few; of many, none."""
    if len(entries) > MAX_NAMED:
        return ""
    return f" ({listed([f'{entry.method} to rank {entry.rank}' for entry in entries])})"


def _steps_up(entry: BoardEntry) -> int:
    if entry.rank is None or entry.previous_rank is None:
        return 0
    return entry.previous_rank - entry.rank


@dataclass(frozen=True)
class HistoryLine:
    """One stretch of time in which one board was shown."""

    board: int
    url: str
    protocol: str
    shown: str
    is_current: bool
    what_changed: tuple[str, ...]
    comparison: str | None


def history_lines(phase: str, lines: list[BoardHistoryLine]) -> tuple[HistoryLine, ...]:
    """Set the boards that were ever public, newest first."""
    return tuple(
        HistoryLine(
            board=line.board,
            url=f"/?phase={phase}&board={line.board}#board",
            protocol=line.protocol.version,
            shown=f"{minute(line.shown_from)} to "
            + (minute(line.shown_until) if line.shown_until else "now"),
            is_current=line.shown_until is None,
            what_changed=line.what_changed,
            comparison=line.comparison,
        )
        for line in lines
    )


# Which rows of a board are the signed-in team's own: marked for its members and nobody else.


@dataclass(frozen=True)
class OwnEntries:
    """The rows of a team on one board.

    Attributes:
        ids: Submissions of the team that stand on the board.
        words: A sentence about them, with the name under which the team stands there.
        url: The same board with these rows alone.
    """

    ids: frozenset[str]
    words: str
    url: str


def own_entries(
    board: Board, submission_ids: frozenset[str], query: BoardQuery
) -> OwnEntries | None:
    """Return what of a board belongs to a team; None where nothing does.

    Args:
        board: The board as everybody reads it, under pseudonyms perhaps.
        submission_ids: All submissions of the team.
        query: The page that is asked for.
    """
    own = [entry for entry in board.entries if entry.submission_id in submission_ids]
    if not own:
        return None
    ranks = [entry.rank for entry in own if entry.rank is not None]
    count = "one entry" if len(own) == 1 else f"{len(own)} entries"
    place = (
        "without a rank" if not ranks else f"{'' if len(own) == 1 else 'best '}rank {min(ranks)}"
    )
    return OwnEntries(
        ids=frozenset(entry.submission_id for entry in own if entry.submission_id),
        words=f"Your team stands here as {own[0].team}: {count}, {place}.",
        url=query.url(search=own[0].team, source=None),
    )


# What the board page says of the life of its phase: frozen, anonymous, a part, a late view.


def standing_notices(reading: "BoardReading") -> tuple[Notice, ...]:
    """Return a sentence for everything that a reader of this board should know of its phase."""
    if reading.board is None or reading.now is None or not reading.is_current:
        return ()
    return (*_late(reading.board, reading.has_late_view), *_kept_back(reading.board, reading.now))


def _late(board: Board, has_late_view: bool) -> Iterator[Notice]:
    if board.view == "late":
        words = (
            "This is the late view: entries that came after the deadline stand among the others, "
            "as they would rank. No rank of the board moves."
        )
        yield Notice(words, f"/?phase={board.phase}#board", "Show the board")
    elif has_late_view:
        words = "Entries that came after the deadline have a view of their own."
        yield Notice(words, f"/?phase={board.phase}&view=late#board", "Show the late view")


def _kept_back(board: Board, now: PhaseNow) -> Iterator[Notice]:
    if now.frozen_since is not None:
        words = (
            f"The board is frozen since {minute(now.frozen_since)}. Scoring goes on; what came "
            "later is shown when the organizers reveal the board."
        )
        yield Notice(words, "", "")
    if board.part == "public":
        words = (
            f"This board counts {board.n_samples:,} samples, the public part of the split. "
            "The others count when the organizers reveal them after the deadline."
        )
        yield Notice(words, "", "")
    if now.families_shown_from is not None:
        yield Notice(f"Families are shown from {minute(now.families_shown_from)}.", "", "")
    if now.is_anonymous:
        words = "Teams and methods stand under pseudonyms until the organizers reveal them."
        yield Notice(words, "", "")


MAX_CHOICES = 25


@dataclass(frozen=True)
class BoardReading:
    """What the records say: phases, the board to show, its protocol, what else there is."""

    phases: tuple[PhaseLink, ...]
    phase: PhaseLink | None
    board: Board | None
    protocol: Protocol
    protocol_versions: tuple[str, ...]
    current_protocol: str
    is_current: bool
    drawing: ProtocolDrawing = field(default_factory=packaged_drawing)
    before: BoardBefore | None = None
    now: PhaseNow | None = None
    has_late_view: bool = False


@dataclass(frozen=True)
class ColumnGroup:
    """A heading over several columns."""

    title: str
    span: int


@dataclass(frozen=True)
class BoardPage:
    """Everything that `board.html` needs."""

    phase: PhaseLink | None
    phase_title: str
    phases: tuple[PhaseLink, ...]
    protocol: Protocol
    view: BoardView | None
    headline: Headline
    scene: SceneDrawing
    metric_cards: tuple[MetricCard, ...]
    protocols: tuple[Choice, ...]
    averages: tuple[Choice, ...]
    kept_fields: tuple[tuple[str, str], ...]
    column_groups: tuple[ColumnGroup, ...]
    entry_choices: tuple[tuple[str, str], ...]
    exports: tuple[tuple[str, str], ...]
    permalink: str | None
    picture: str
    clear_url: str
    notice: Notice | None
    standing: tuple[Notice, ...]
    """What the phase keeps back now, or shows apart."""
    own: OwnEntries | None
    """The rows of the team that signed in; None for everybody else."""
    change: ChangeLine | None
    submit_command: str
    submit_url: str
    challenge: Challenge
    scene_caption: str
    compared_fields: tuple[tuple[str, str], ...]
    """What names the board when two of its entries are compared."""

    @property
    def submit_command_wrapped(self) -> tuple[str, str]:
        """The command on two lines."""
        head, tail = self.submit_command.split(" --phase", 1)
        return head, f"    --phase{tail}"


def board_page(
    reading: BoardReading, query: BoardQuery, own_ids: frozenset[str] = frozenset()
) -> BoardPage:
    """Set what was read for a query, and mark the submissions of the team that signed in."""
    board = reading.board
    view = board_view(board, reading.protocol, query, reading.is_current) if board else None
    phase = reading.phase
    challenge = phase.challenge if phase else next(iter(CHALLENGES.values()))
    scene = scene_drawing(reading.drawing, reading.protocol)
    return BoardPage(
        phase=phase,
        phase_title=phase.title if phase else board.phase if board else "ExceptionDrive",
        phases=reading.phases,
        protocol=reading.protocol,
        view=view,
        headline=headline(
            board, challenge, len(reading.protocol.tasks), Digits.of(reading.protocol.publication)
        ),
        scene=scene,
        metric_cards=metric_cards(challenge),
        challenge=challenge,
        scene_caption=challenge.words.scene_caption.format(
            clearance_m=scene.clearance_m, d_safe_m=scene.d_safe_m, hcc=scene.hcc
        ),
        protocols=_protocol_choices(reading, query),
        averages=_average_choices(view),
        kept_fields=_kept_fields(query),
        column_groups=_column_groups(view) if view else (),
        entry_choices=entry_choices(board) if board else (),
        exports=_exports(board) if board else (),
        permalink=f"/?{_address(board)}" if board else None,
        picture=_picture(reading),
        clear_url=query.url(search="", source=None),
        notice=_notice(reading, query),
        standing=standing_notices(reading),
        own=own_entries(board, own_ids, query) if board and own_ids else None,
        change=change_line(board, reading.before) if board and board.view == "main" else None,
        compared_fields=board_fields(board, reading.is_current) if board else (),
        submit_url=f"/submit?phase={phase.id}" if phase else "/submit",
        submit_command=submit_command(challenge, phase.id if phase else "sample"),
    )


def submit_command(challenge: Challenge, phase_id: str) -> str:
    """Return the command that submits a file to a phase."""
    code = challenge.words.code
    return f'exceptiondrive submit {code.file} --phase {phase_id} --method "{code.method}" --wait'


def _protocol_choices(reading: BoardReading, query: BoardQuery) -> tuple[Choice, ...]:
    """The protocol in force, which needs no name, and the others; a board of a date has its own."""
    shown = reading.board.protocol.version if reading.board else reading.current_protocol
    unnamed = f"{reading.current_protocol} (current)"
    if query.as_of is not None and shown != reading.current_protocol:
        unnamed = f"{shown} (of that date)"
    names = (v for v in reading.protocol_versions if not unnamed.startswith(f"{v} ("))
    is_named = not unnamed.startswith(f"{shown} (")
    return (
        Choice("", unnamed, not is_named),
        *(Choice(name, name, is_named and name == shown) for name in names),
    )


def _average_choices(view: BoardView | None) -> tuple[Choice, ...]:
    if view is None:
        return ()
    headline_average = view.board.headline
    return tuple(
        Choice(
            "" if average == headline_average else average,
            AVERAGE_TITLES[average] + (" (ranks)" if average == headline_average else ""),
            average == view.average,
        )
        for average in AVERAGES
    )


def _kept_fields(query: BoardQuery) -> tuple[tuple[str, str], ...]:
    """What the filter form carries on unseen."""
    kept = ("challenge", "phase", "view", "source", "sort")
    return tuple((key, value) for key, value in query.pairs() if key in kept)


def _column_groups(view: BoardView) -> tuple[ColumnGroup, ...]:
    primary = sum(column.kind == "primary" for column in view.columns)
    groups = [ColumnGroup("Primary, decide the rank", primary)]
    if len(view.columns) > primary:
        groups.append(ColumnGroup("Diagnostic, not a score", len(view.columns) - primary))
    return tuple(groups)


def entry_choices(board: Board) -> tuple[tuple[str, str], ...]:
    """Return the key and the title of the entries that a comparison offers."""
    suffix = {"scored": "", "reference": " (reference)", "reported": " (reported)"}
    entries = board.entries[:MAX_CHOICES] + tuple(
        entry for entry in board.entries[MAX_CHOICES:] if entry.source != "scored"
    )
    return tuple((entry_key(entry), entry.method + suffix[entry.source]) for entry in entries)


def _exports(board: Board) -> tuple[tuple[str, str], ...]:
    here = _address(board)
    is_late = board.view == "late"
    json = f"leaderboard?{here}" if is_late else f"boards/{board.phase}/{board.board}"
    return (
        ("CSV", f"/export/board.csv?{here}"),
        ("JSON", f"/api/v1/{json}"),
        ("LaTeX", f"/export/board.tex?{here}"),
        ("BibTeX", f"/export/board.bib?{here}"),
        ("Atom", f"/feed.atom?phase={board.phase}"),
    )


def _address(board: Board) -> str:
    """The query that names this very board."""
    return urlencode(board_fields(board))


def _picture(reading: BoardReading) -> str:
    """Address of the picture that other sites show; a board's own never changes."""
    board, phase = reading.board, reading.phase
    if board is None or board.view == "late":
        return "/pictures/board.png" + (f"?phase={phase.id}" if phase else "")
    return f"/pictures/board.png?phase={board.phase}&board={board.board}"


def _notice(reading: BoardReading, query: BoardQuery) -> Notice | None:
    board = reading.board
    if board is None or reading.is_current:
        return None
    asked = f", the board as of {query.as_of_text}" if query.as_of else ""
    words = (
        f"This is history{asked}: board {board.board} of {minute(board.published_at)}, "
        f"scored under protocol {board.protocol.version}. It is not the current one."
    )
    return Notice(words, f"/?phase={board.phase}#board", "Show the current board")
