"""View data for the pages of an entry and of its drawn samples."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple
from urllib.parse import urlencode

from markupsafe import Markup

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.drawing import SampleDrawing, outcome, shapes
from exceptiondrive_schemas.protocol import PlausibilitySection
from exceptiondrive_schemas.score_sheet import BreakdownRow, Interval, Plausibility
from exceptiondrive_schemas.taxonomy import Task
from exceptiondrive_server.boards.charts import best_entries, clearance_bars, curve_chart
from exceptiondrive_server.boards.entry_facts import (
    board_fields,
    challenge_of,
    entry_key,
    entry_url,
    values_of,
)
from exceptiondrive_server.boards.families import DOT_WIDE, dot_plot
from exceptiondrive_server.boards.query import AVERAGE_TITLES, OTHER_AVERAGE
from exceptiondrive_server.boards.table import (
    NO_OTHER,
    SMALL_FAMILY,
    OutcomeBar,
    Row,
    RowBuilder,
    outcome_bar,
)
from exceptiondrive_server.entries.motion import Motion, motion
from exceptiondrive_server.entries.queries import EntryData
from exceptiondrive_server.entries.sheet_tables import effect_table, sheet_tables
from exceptiondrive_server.web.numbers import Digits, Scale, nice_scale, percent
from exceptiondrive_server.web.templating import template_filter

WHOLE = Scale((0.0, 1.0), (0.0, 100.0), ())
"""The axis on which all entries of a board stand, references too."""


class Part(NamedTuple):
    """One family or task of an entry."""

    id: str
    title: str
    hazard: str
    """Of a task; a family has none of its own."""
    row: BreakdownRow
    interval: Interval | None
    """Of the first metric."""
    is_family: bool

    @property
    def is_small(self) -> bool:
        """Whether its numbers come from few samples."""
        return self.row.n is not None and self.row.n < SMALL_FAMILY


@template_filter
def bar_of(part: Part, challenge: Challenge, digits: Digits) -> OutcomeBar | None:
    """Return the outcome bar of a part; None where the scorer did not count its shares."""
    return outcome_bar(challenge, part.row.metrics, digits)


def entry_page(reading: EntryData) -> dict[str, Any]:
    """Return what `entry.html` shows of an entry."""
    board, entry, sheet = reading.board, reading.entry, reading.sheet
    challenge, publication = challenge_of(board), reading.protocol.publication
    digits = Digits.of(publication, has_fine_intervals=board.has_fine_intervals)
    builder = RowBuilder(board, board.headline, digits, is_current=reading.is_current)
    row, plausibility = builder.row(entry), reading.protocol.plausibility
    other = OTHER_AVERAGE[board.headline]
    effects = effect_table(board, entry, digits)
    curve = sheet.clearance_curve if sheet else None
    shown = panels(reading)
    curves = ((entry, curve),) if curve else ()
    others = [other for other in best_entries(board) if other is not entry][:2]
    beside = [entry, *others] if others and not shown else []  # where no scene of it can be drawn
    board_query = urlencode(board_fields(board, reading.is_current))
    return {
        "reading": reading,
        "challenge": challenge,
        "digits": digits,
        "small_family": SMALL_FAMILY,
        "row": row,
        "position": position_of(row, board),
        "axis": WHOLE,
        "averages": (AVERAGE_TITLES[board.headline], AVERAGE_TITLES[other]),
        "other": values_of(entry, board, other),
        "parts": tuple(_family_parts(reading, challenge.metrics[0])),
        "metrics": [metric for metric in challenge.metrics if metric.shown != "details"],
        "details": _detail_metrics(board, entry),
        "beside_others": dot_plot(board, beside, digits),
        "beside_wide": dot_plot(board, beside, digits, DOT_WIDE),
        "board_query": board_query,
        "curve": curve_chart(curves, board.headline, digits),
        "bars": clearance_bars(curve) if curve else (),
        "narrow_curve": curve_chart(curves, board.headline, digits, width=350, height=300),
        "plausibility": plausibility_lines(sheet.plausibility, plausibility) if sheet else (),
        "past_axis": _past_axis(reading, challenge.metrics[0]),
        "panels": shown,
        "scenes": motions(reading, tuple(each for each in shown if each.group == "scene")),
        "beside": f"{board_query}&{urlencode({'with': entry_key(entry)})}",
        "tables": (
            *([effects] if effects.lines else ()),
            *(sheet_tables(sheet, reading.protocol, digits) if sheet else ()),
        ),
        "neighbours": _neighbour_links(reading),
        "board_url": f"/?{board_query}#board",
        "picture_url": f"/pictures/entries/{entry_key(entry)}.png?{_picture_query(board)}",
    }  # fmt: skip


def _family_parts(reading: EntryData, first: Metric) -> Iterator[Part]:
    """Each family of an entry, followed by its tasks where a score sheet is known."""
    tasks = reading.sheet.tasks if reading.sheet else {}
    for head in reading.board.families:
        cell = reading.entry.families.get(head.id)
        if cell is not None:
            yield Part(head.id, head.title, "", cell, cell.intervals.get(first.key), True)
            for task in reading.protocol.taxonomy.tasks_of(head.id):
                if task.id in tasks:
                    yield Part(task.id, task.title, task.hazard, tasks[task.id], None, False)


def _detail_metrics(board: Board, entry: BoardEntry) -> list[Metric]:
    """Metrics that are no columns, as far as the entry has them; shares of the bar stand with it."""
    challenge = challenge_of(board)
    drawn = {part.metric for part in challenge.words.outcome}
    return [
        metric
        for metric in challenge.metrics
        if metric.shown == "details"
        and metric.key not in drawn
        and any(row.get(metric.key) is not None for row in (entry.metrics, entry.micro))
    ]


def _past_axis(reading: EntryData, metric: Metric) -> Scale:
    """One axis for all protocols under which the entry stood."""
    values: list[float | None] = []
    for past in reading.past:
        interval = past.entry.intervals.get(metric.key) or ()
        values += [past.entry.metrics.get(metric.key), *interval]
    known = [value for value in values if value is not None]
    return nice_scale(known, (0.0, 100.0), n_ticks=4, floor=0.0, ceiling=1.0)


def _picture_query(board: Board) -> str:
    """A picture of the late view follows it; one of a board never changes."""
    given = (("phase", board.phase),) if board.view == "late" else board_fields(board)
    return urlencode(given)


def _neighbour_links(reading: EntryData) -> list[tuple[str, BoardEntry, str]]:
    """Comparisons with the entries just above and below on this board: words, entry, address."""
    board, entry = reading.board, reading.entry
    ranked = [other for other in board.entries if other.rank is not None]
    if entry not in ranked:
        others = [("the leader", other) for other in ranked[:1]]
    else:
        place = ranked.index(entry)
        others = [("the entry above", other) for other in ranked[max(place - 1, 0) : place]]
        others += [("the entry below", other) for other in ranked[place + 1 : place + 2]]
    given = (*board_fields(board, reading.is_current), ("a", entry_key(entry)))
    base = f"/compare?{urlencode(given)}&b="
    return [(words, other, base + entry_key(other)) for words, other in others]


class Position(NamedTuple):
    """The rank of an entry as its page, badge and picture say it."""

    rank: str
    """The rank held on the board; a dash where none is held."""
    note: str
    """Small print under the rank."""
    reason: tuple[str, str] | None
    """Why no rank is held: what it is called, and the sentence; None where one is held."""
    summary: str
    """All of it in one line."""


def position_of(row: Row, board: Board) -> Position:
    """Say what rank an entry holds. One that came after the deadline holds none on any board."""
    if row.entry.is_late:
        reason = "It came after the deadline, so it holds no rank and moves none."
        if row.rank is None:
            return Position("–", "", ("Late.", f"{reason} {_sentence(row.rank_words)}"), "late")
        n_ranked = sum(1 for entry in board.entries if entry.rank is not None)
        reason += f" Among all {n_ranked} of the late view it would be number {row.rank}."
        summary = f"late, not ranked; it would be number {row.rank}"
        return Position("–", f"would be {row.rank}", ("Late.", reason), summary)
    if row.rank is None:
        return Position("–", "", ("Not ranked.", _sentence(row.rank_words)), row.rank_words)
    note = f"{row.rank_interval} possible" if row.rank_interval else ""
    if row.entry.rank_interval is not None and not note:
        note = NO_OTHER.format(percent(board.confidence))
    return Position(row.rank, note, None, row.rank_words)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith(".") else ".")


class PlausibilityLine(NamedTuple):
    """One share: what it counts, its value, what raises a flag, whether it is raised."""

    words: str
    share: float | None
    threshold: str
    is_raised: bool


def plausibility_lines(
    plausibility: Plausibility, section: PlausibilitySection
) -> list[PlausibilityLine]:
    """Return a line for every share that the score sheet publishes, known ones first."""
    still = f"end less than {section.stationary_below_m:g} m from the start, or are missing"
    turning = f"turning tighter than {section.min_turn_radius_m:g} m"
    first = "or with an impossible first step"
    shares = {key: share or 0.0 for key, share in plausibility.shares.items()}
    more = "more than {:g} points above the share in the original scenes"
    known = {  # share to its words, its threshold in words and as a number, the flag that it may raise
        "edited_stationary": (
            f"paths with the hazard that {still}",
            more.format(100 * section.flag_edited_stationary_excess),
            shares.get("source_stationary", 0.0) + section.flag_edited_stationary_excess,
            "stands_still",
        ),
        "source_stationary": (
            f"paths in the original scenes that {still}",
            f"above {percent(section.flag_source_stationary)}",
            section.flag_source_stationary,
            "source_stands_still",
        ),
        "edited_behind": (
            "paths with the hazard that end behind the start",
            more.format(100 * section.flag_reverses_excess),
            shares.get("source_behind", 0.0) + section.flag_reverses_excess,
            "reverses",
        ),
        "source_behind": ("paths in the original scenes that end behind the start", "", 1.0, ""),
        "blind": (
            f"pairs of paths, without and with the hazard, less than {section.blind_shift_below_m:g} m apart",
            f"above {percent(section.flag_blind)}",
            section.flag_blind,
            "blind_to_the_edit",
        ),
        "impossible": (
            f"paths with the hazard above {section.max_acceleration_mps2:g} m/s\u00b2, {turning}, {first}",
            f"above {percent(section.flag_impossible)}",
            section.flag_impossible,
            "impossible_motion",
        ),
        "first_step": (
            "paths with the hazard whose first step the speed in the original scene does not allow",
            f"above {percent(section.flag_first_step)}",
            section.flag_first_step,
            "impossible_motion",
        ),
        "same_answer": (
            "answers that are the most frequent one",
            f"above {percent(section.flag_same_answer)}",
            section.flag_same_answer,
            "same_answer",
        ),
    }
    raised = {flag.code for flag in plausibility.flags}
    lines = []
    for key in sorted(plausibility.shares, key=lambda key: [*known, key].index(key)):
        share = plausibility.shares[key]
        words, threshold, limit, flag = known.get(key, (key.replace("_", " "), "", 1.0, ""))
        is_raised = flag in raised and share is not None and share > limit
        lines.append(PlausibilityLine(words, share, threshold, is_raised))
    return lines


GROUPS = ("scene", "worst", "middle")


@dataclass(frozen=True)
class Panel:
    """One drawn sample: who, what happened, where its own page is."""

    group: str
    """`scene`, `worst` or `middle` of its family."""
    place: str
    url: str
    sample: SampleDrawing
    family: str
    task: Task

    @property
    def outcome(self) -> str:
        """What happened, in a sentence without capital and full stop."""
        return outcome(self.sample)

    @property
    def words(self) -> str:
        """What the picture shows, for those who do not see it."""
        happened = self.outcome
        return f"{self.task.label}: {self.sample.hazard}. {happened[0].upper()}{happened[1:]}."


def panels(reading: EntryData) -> tuple[Panel, ...]:
    """Return the drawn samples of an entry: of each family the scene, the worst, the middle one."""
    path, _, query = entry_url(reading.entry, reading.board, reading.is_current).partition("?")
    families = {family.id: family.title for family in reading.protocol.families}
    found = []
    for drawn in reading.drawings.samples if reading.drawings else ():
        sample = drawn.drawing
        place = f"{drawn.chosen_as}-{sample.family}"
        url = f"{path}/samples/{place}" + (f"?{query}" if query else "")
        task = reading.protocol.taxonomy.task(sample.task)
        found.append(Panel(drawn.chosen_as, place, url, sample, families[sample.family], task))
    return tuple(sorted(found, key=lambda panel: GROUPS.index(panel.group)))


def motions(reading: EntryData, drawn: tuple[Panel, ...]) -> tuple[Motion, ...]:
    """Return drawn samples of an entry in motion."""
    name = reading.entry.method
    return tuple(
        motion(
            [(name, each.sample)],
            reading.protocol,
            each.url,
            reading.pictures.get(each.sample.sample_id, ()),
        )
        for each in drawn
    )


@template_filter
def drawn(sample: SampleDrawing, width: int, height: int) -> Markup:
    """Draw a sample as SVG shapes for a box; colours come from the style sheet."""
    return Markup(shapes(sample, width, height))


def sample_page(reading: EntryData, place: str) -> dict[str, Any] | None:
    """Return what `sample.html` shows of one drawn sample; None where none stands at this place."""
    drawn = panels(reading)
    index = next((i for i, panel in enumerate(drawn) if panel.place == place), None)
    if index is None:
        return None
    challenge, values = challenge_of(reading.board), drawn[index].sample.metrics
    parts = [challenge.metric(part.metric) for part in challenge.words.outcome]
    outcome = next((part for part in parts if values.get(part.key) == 1), None)
    told = {"ur", *(part.key for part in parts)} if outcome else ()
    return {
        "reading": reading,
        "panel": drawn[index],
        "scene": motions(reading, drawn[index : index + 1])[0],
        "outcome": outcome,
        "metrics": [metric for metric in challenge.metrics if metric.key not in told],
        "digits": Digits.of(reading.protocol.publication),
        "before": drawn[index - 1] if index else None,
        "after": drawn[index + 1] if index + 1 < len(drawn) else None,
        "entry_url": entry_url(reading.entry, reading.board, reading.is_current),
    }
