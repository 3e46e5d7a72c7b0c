"""The board page as one value: the records for a query, and what is derived from them.

What depends only on a board and a query is computed once, as boards never change.
"""

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, lru_cache
from typing import Any, Generic, NamedTuple, TypeVar
from urllib.parse import urlencode

from markupsafe import Markup

from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.phases.policy import is_pseudonym
from exceptiondrive_schemas.api.participation import DisqualificationNote
from exceptiondrive_schemas.api.phase_settings import PhaseNow, Visibility
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.drawing import ProtocolDrawing, packaged_drawing
from exceptiondrive_schemas.method_facts import NO_FACTS, FactsOfBoard
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.charts import (
    Curves,
    best_entries,
    curve_chart,
    effect_lines,
    scatter_chart,
)
from exceptiondrive_server.boards.comparison import MAX_COMPARED, Comparison, default_pair
from exceptiondrive_server.boards.entry_facts import board_fields
from exceptiondrive_server.boards.families import Tasks, dot_plot, families_of
from exceptiondrive_server.boards.headline import (
    BoardBefore,
    ChangeLine,
    Headline,
    change_line,
    headline,
)
from exceptiondrive_server.boards.query import AVERAGE_TITLES, Average, BoardQuery
from exceptiondrive_server.boards.scene_drawing import answers_to, scene_drawing
from exceptiondrive_server.boards.table import BoardTable, board_table
from exceptiondrive_server.web.numbers import day, minute
from exceptiondrive_server.web.templating import macro

NARROW_PX = (350, 400)
T = TypeVar("T")


class Same(Generic[T]):
    """Wraps a value with equality by identity: a cached document needs no other key."""

    def __init__(self, value: T) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.value is other.value


class ShownBoard(NamedTuple):
    """What follows from a board, its protocol and a query; `rows` are the rows of nobody's own.

    `compared_fields` name it to the comparison, `change` tells what is new since the board before.
    """

    table: BoardTable
    headline: Headline
    change: ChangeLine | None
    head: Markup
    rows: dict[str, Markup]
    charts: Markup
    families: Markup
    compared_fields: tuple[tuple[str, str], ...]


MADE_OF_A_BOARD = 8
_MADE: Memory[Same[Board], Memory[Hashable, Any]] = Memory(4_000)
"""What was made of the boards that were shown last; it weighs what it keeps alive: entries, about as
many as parsed boards are kept."""


def of_board(board: Board, what: Hashable, make: Callable[[], T]) -> T:
    """Return what is derived from a board, cached while there is room."""
    same = Same(board)
    made = _MADE.get(same)
    if made is None:
        made = _MADE.keep(same, Memory(MADE_OF_A_BOARD), 1 + len(board.entries))
    found: T | None = made.get(what)
    return found if found is not None else made.keep(what, make(), 1)


def _make_shown(
    board: Board,
    protocol: ProtocolDocument,
    curves: Curves,
    tasks: Tasks,
    facts: FactsOfBoard,
    query: BoardQuery,
    is_current: bool,
    before: BoardBefore | None,
) -> ShownBoard:
    """Takes everything that the result depends on, which is its key in the cache of `BoardPage.shown`."""
    table = board_table(board, protocol, query, is_current, facts)
    digits, average = table.builder.digits, table.builder.average
    set_row, pair = macro("boards/table.html", "board_row"), default_pair(board)
    narrow, low = NARROW_PX
    families = families_of(board)
    charts = macro("boards/charts.html", "board_charts")(
        table=table,
        chart=scatter_chart(board, average),
        narrow_chart=scatter_chart(board, average, width=narrow, height=low),
        curves_chart=curve_chart(curves, average, digits),
        narrow_curves=curve_chart(curves, average, digits, width=narrow, height=low),
        effects=effect_lines(board, digits),
        both=Comparison(board, *pair, digits) if pair else None,
        pair_plot=dot_plot(board, pair, digits, order=families.order) if pair else None,
        compared_fields=board_fields(board, is_current),
    )
    return ShownBoard(
        table=table,
        headline=headline(board, table.builder.challenge, protocol),
        change=change_line(board, before) if board.view == "main" else None,
        head=macro("boards/table.html", "table_head")(table),
        rows={row.key: set_row(row, table, False) for row in table.rows},
        charts=charts,
        families=macro("boards/families.html", "families_section")(
            table=table,
            shown=families,
            plot=dot_plot(board, best_entries(board, query.chosen), digits, order=families.order),
            tasks=tasks,
            protocol=protocol,
        ),
        compared_fields=board_fields(board, is_current),
    )


@lru_cache(maxsize=16)
def _metrics(challenge: Same[Challenge], average: Average) -> Markup:
    return macro("web/macros/icons.html", "metrics")(challenge.value, average)


@lru_cache(maxsize=16)
def _scene(
    drawing: Same[ProtocolDrawing], protocol: Same[ProtocolDocument], challenge: Same[Challenge]
) -> Markup:
    scene = scene_drawing(drawing.value, protocol.value)
    caption = challenge.value.words.scene_caption.format(
        clearance_m=scene.clearance_m, d_safe_m=scene.d_safe_m, hcc=scene.hcc
    )
    tasks = protocol.value.tasks
    task = next((each for each in tasks if each.id == scene.task_id), tasks[0])
    answers = () if challenge.value.has_waypoints else answers_to(task)
    return macro("boards/charts.html", "scene_figure")(scene, caption, task, answers)


class Choice(NamedTuple):
    """One option of a select field."""

    value: str
    title: str
    is_current: bool


@dataclass(frozen=True)
class PhaseLink:
    """A phase that a visitor may switch to."""

    id: str
    title: str
    challenge: Challenge
    n_samples: int
    is_open: bool
    is_ahead: bool
    """Whether it has not opened yet."""
    takes_late: bool
    """Whether it has closed, and what comes now is ranked on its late view."""
    is_current: bool
    visibility: Visibility
    description: str
    """Markdown."""
    opens_at: datetime | None
    closes_at: datetime | None
    quota_per_day: int
    rejected_per_day: int
    """How many faulty files a day are accepted from a team."""
    split: str
    split_is_public: bool
    has_data: bool
    """Whether its page says where scenes and pictures are had."""
    not_checked: tuple[str, ...]
    """What nobody checks of a file for it, in sentences."""
    entries_private: bool
    """Whether an entry stands nowhere until its team publishes it."""
    run_rule: str
    """Which run of a method stands, in a sentence."""
    url: str

    @property
    def state_words(self) -> str:
        """Say whether the phase takes submissions, and until or from when."""
        if self.visibility != "shown":
            return self.visibility.capitalize()
        if self.is_ahead and self.opens_at:
            return f"Opens {minute(self.opens_at)}"
        if self.is_open:
            return (
                f"Open until {minute(self.closes_at)}" if self.closes_at else "Open for submissions"
            )
        return f"Closed since {minute(self.closes_at)}" if self.closes_at else "Closed"

    @property
    def state_word(self) -> str:
        """Say it in a word where it is not open: `closed`, `opens 3 Dec 2026`."""
        if self.is_ahead and self.opens_at:
            return f"opens {day(self.opens_at)}"
        return "" if self.is_open else "closed" if self.is_shown else self.visibility

    @property
    def is_shown(self) -> bool:
        """Whether it is neither archived nor hidden."""
        return self.visibility == "shown"

    @property
    def is_past(self) -> bool:
        """Whether it has closed, or was put away."""
        return (
            self.is_shown and not (self.is_open or self.is_ahead)
        ) or self.visibility == "archived"

    @property
    def takes_files(self) -> bool:
        """Whether it takes submissions now, be it for the late view."""
        return self.is_open or self.takes_late

    @property
    def page_url(self) -> str:
        """Address of the page about it."""
        return f"/phases/{self.id}"


@dataclass(frozen=True)
class Notice:
    """A sentence above the board, with a way out."""

    words: str
    url: str = ""
    link_words: str = ""


@dataclass(frozen=True)
class BoardPage:
    """What the records say for a query: phases, the board to show, its protocol, what else there is.

    The board holds no reported rows. `current_protocol` is the version in force; `is_current` says whether the phase shows this board
    now, or its late view; `before` is the board that was shown before it.
    """

    query: BoardQuery
    phases: tuple[PhaseLink, ...]
    phase: PhaseLink | None
    board: Board | None
    protocol: ProtocolDocument
    protocol_versions: tuple[str, ...]
    current_protocol: str
    is_current: bool = True
    drawing: ProtocolDrawing = field(default_factory=packaged_drawing)
    before: BoardBefore | None = None
    now: PhaseNow | None = None
    has_late_view: bool = False
    curves: Curves = ()
    """Clearance curves of the best entries."""
    tasks: Tasks = ()
    """Tasks, hardest first, as far as the sheets of the best entries tell them."""
    facts: FactsOfBoard = field(default_factory=lambda: NO_FACTS)
    """What teams tell of their methods now; not of the board, whose bytes never change."""
    disqualified: tuple[DisqualificationNote, ...] = ()
    """What readers are told of who stands on no board any more."""
    has_reported: bool = False
    """Whether the phase also shows what a paper reports, which has a page of its own."""
    n_reported: int = 0
    """How many rows of external boards stand on another page beside the phase."""

    @cached_property
    def shown(self) -> ShownBoard | None:
        """The board as a page shows it.

        Raises:
            InvalidRecord: This board has nothing of the name that the query sorts by.
        """
        board = self.board
        if board is None:
            return None
        read = (self.protocol, self.curves, self.tasks, self.facts)
        asked = (self.query, self.is_current, self.before)
        key = (*(Same(each) for each in read), *asked)
        return of_board(board, key, lambda: _make_shown(board, *read, *asked))

    @property
    def challenge(self) -> Challenge:
        """The challenge of the phase; without one, the first."""
        return self.phase.challenge if self.phase else next(iter(CHALLENGES.values()))

    @cached_property
    def headline(self) -> Headline:
        """The sentences on top."""
        if self.shown is not None:
            return self.shown.headline
        return headline(None, self.challenge, self.protocol)

    @property
    def most_compared(self) -> int:
        """How many rows may be chosen to be compared."""
        return MAX_COMPARED

    @property
    def withheld(self) -> str:
        """What is withheld of the split; empty if the split is public."""
        is_hidden = self.phase is not None and not self.phase.split_is_public
        return self.challenge.words.withheld if is_hidden else ""

    @property
    def scene(self) -> Markup:
        """The drawing of what the protocol measures."""
        return _scene(Same(self.drawing), Same(self.protocol), Same(self.challenge))

    @property
    def metrics(self) -> Markup:
        """What the numbers mean, as the average that is shown."""
        shown = self.shown.table.builder.average if self.shown else self.protocol.grading.headline
        return _metrics(Same(self.challenge), shown)

    @cached_property
    def phase_title(self) -> str:
        """What the page is about."""
        if self.phase is not None:
            return self.phase.title
        return self.board.phase if self.board else "ExceptionDrive"

    @cached_property
    def protocols(self) -> list[Choice]:
        """The protocol in force, which needs no name, and the others; a date has its own."""
        shown = self.board.protocol.version if self.board else self.current_protocol
        if self.query.as_of is not None and shown != self.current_protocol:
            first, unnamed = shown, Choice("", f"{shown} (of that date)", True)
        else:
            first = self.current_protocol
            unnamed = Choice("", f"{first} (current)", shown == first)
        others = [version for version in self.protocol_versions if version != first]
        return [unnamed, *(Choice(each, each, each == shown) for each in others)]

    @property
    def averages(self) -> list[Choice]:
        """Both averages; the one that ranks needs no name."""
        if self.board is None:
            return []
        headline_average = self.board.headline
        shown = self.query.average or headline_average
        return [
            Choice("", f"{title.capitalize()} (ranks)", average == shown)
            if average == headline_average
            else Choice(average, title.capitalize(), average == shown)
            for average, title in AVERAGE_TITLES.items()
        ]

    @property
    def kept_fields(self) -> list[tuple[str, str]]:
        """Hidden fields of the filter form."""
        kept = ("challenge", "phase", "view", "source", "fact", "more")
        return [(key, value) for key, value in self.query.pairs() if key in kept]

    @cached_property
    def address(self) -> str | None:
        """The query that names this very board."""
        return urlencode(board_fields(self.board)) if self.board else None

    @property
    def canonical(self) -> str | None:
        """The canonical query for search engines: always the live board."""
        return urlencode(board_fields(self.board, is_current=True)) if self.board else None

    @property
    def exports(self) -> list[tuple[str, str]]:
        """Title and address of each form in which the board is given."""
        board, here = self.board, self.address
        if board is None:
            return []
        number = f"boards/{board.phase}/{board.board}"
        return [
            ("CSV", f"/export/board.csv?{here}"),
            ("JSON", f"/api/v1/{f'leaderboard?{here}' if board.view == 'late' else number}"),
            ("LaTeX", f"/export/board.tex?{here}"),
            ("BibTeX", f"/export/board.bib?{here}"),
            ("Atom", f"/feed.atom?phase={board.phase}"),
        ]

    @property
    def picture(self) -> str:
        """Address of the picture that other sites show; a board's own never changes."""
        if self.board is None or self.board.view == "late":
            return "/pictures/board.png" + (f"?phase={self.phase.id}" if self.phase else "")
        return f"/pictures/board.png?{self.address}"

    @cached_property
    def notice(self) -> Notice | None:
        """Say that a board is history."""
        board = self.board
        if board is None or self.is_current:
            return None
        asked = f", the board as of {self.query.as_of_text}" if self.query.as_of else ""
        words = (
            f"This is history{asked}: board {board.board} of {minute(board.published_at)}, "
            f"scored under protocol {board.protocol.version}. It is not the current one."
        )
        return Notice(words, f"/?phase={board.phase}#board", "Show the current board")

    @property
    def shows_new(self) -> str:
        """Where and when new scores are shown."""
        takes_late = self.phase is not None and self.phase.takes_late
        where = f"on the {'late view' if takes_late else 'board'}"
        after = []
        if self.phase is not None and self.phase.entries_private:
            after.append("your team publishes the entry")
        if self.now is not None and self.now.frozen_since is not None:
            after.append("the organizers reveal the board")
        return f"{where} once {' and '.join(after)}" if after else f"{where} within seconds"

    @property
    def banners(self) -> tuple[Notice, ...]:
        """What the phase keeps back now, or shows apart."""
        if self.board is None or self.now is None or not self.is_current:
            return ()
        late = _late_notices(self.board, self.has_late_view)
        return (*late, *_kept_back(self.board, self.now))

    @property
    def scenes(self) -> str | None:
        """The query under which scenes in motion stand; None where none can be drawn.

        A phase whose split is withheld shows those of another one.
        """
        can_be_drawn = any(
            link.split_is_public and link.challenge.has_waypoints for link in self.phases
        )
        if self.board is None or not self.challenge.has_waypoints or not can_be_drawn:
            return None
        return urlencode(board_fields(self.board, self.is_current))

    @property
    def submit_url(self) -> str:
        """Where a submission to the phase begins."""
        return f"/submit?phase={self.phase.id}" if self.phase else "/submit"

    @property
    def check_command(self) -> tuple[str, str]:
        """The command that checks a file against the phase's samples, in two parts."""
        phase = self.phase.id if self.phase else "sample"
        return f"exceptiondrive check {self.challenge.words.code.file}", f"--phase {phase}"

    @property
    def submit_command(self) -> tuple[str, str]:
        """The command that submits a file to the phase, in two parts."""
        code, phase = self.challenge.words.code, self.phase.id if self.phase else "sample"
        return (
            f"exceptiondrive submit {code.file}",
            f'--phase {phase} --method "{code.method}" --wait',
        )


def _late_notices(board: Board, has_late_view: bool) -> Iterator[Notice]:
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
            f"The board is frozen since {minute(now.frozen_since)}. What is scored from then on is shown "
            "when the organizers reveal the board, for which there is no date."
        )
        yield Notice(words)
    if board.part is not None:
        words = (
            f"This board counts {board.n_samples:,} samples, the {board.part} part of the split."
        )
        if board.part == "public":
            words += " The others count when the organizers reveal them after the deadline."
        yield Notice(words)
    if now.families_shown_from is not None:
        yield Notice(f"Families are shown from {minute(now.families_shown_from)}.")
    if now.is_anonymous or any(is_pseudonym(entry.team) for entry in board.entries):
        words = "Teams and methods stand under pseudonyms until the organizers show names."
        yield Notice(words)
