"""Who led a phase over time, and with which score; changes of protocol and samples are marked."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import NamedTuple

from exceptiondrive_records.boards.boards import Lead
from exceptiondrive_records.splits.splits import part_words
from exceptiondrive_schemas.board import BoardLeader
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.boards.charts import Box, Frame, Label, Tick, place_labels, ticks_of
from exceptiondrive_server.web.numbers import Digits, day, minute, nice_scale, px

N_DATES = 4
CHARACTER_WIDTH = 6.5
"""Of the words of marks, in SVG units."""


class LeadPoint(NamedTuple):
    """A board on which the leader, its value or what it is a value of changed; SVG units."""

    x: str
    y: str
    title: str
    is_new: bool
    """Whether another one, or nobody, led before."""


class Mark(NamedTuple):
    """The point from which values are of another protocol, or of other samples."""

    x: str
    words: str
    """Empty where a later change is so near that its words stand here."""
    anchor: str


@dataclass(frozen=True)
class LeadChart:
    """Steps of the best value; a step never crosses a mark, nor a time in which nobody led."""

    frame: Frame
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    steps: tuple[str, ...]
    points: tuple[LeadPoint, ...]
    labels: tuple[Label, ...]
    marks: tuple[Mark, ...]
    x_title: str
    metric: Metric
    description: str


class _Change(NamedTuple):
    lead: Lead
    name: str
    value: float
    is_new_leader: bool
    mark: str
    """What is another than before; empty where nothing is."""
    until: datetime | None = None
    """Since when nobody led any more."""


def lead_chart(
    leads: Sequence[Lead], now: datetime, metric: Metric, digits: Digits, *, width: int = 640
) -> LeadChart | None:
    """Draw who led over time; None if nobody ever led.

    `leads` are every board that was shown, oldest first. The width is 640 for wide screens, 350 for
    phones.
    """
    changes = _changes(leads)
    if not changes:
        return None
    height = 354 if width > 480 else 324
    frame = Frame(width, height, top=30.0, bottom=height - 58.0, left=66.0)
    left, right = frame.across
    start, span = changes[0].lead.at, max(now - changes[0].lead.at, timedelta(minutes=1))

    def along(at: datetime) -> float:
        return left + min(max((at - start) / span, 0.0), 1.0) * (right - left)

    values = [100 * change.value for change in changes]
    scale = nice_scale(values, frame.upwards, floor=0.0, ceiling=100.0)
    places = [(along(change.lead.at), scale.at(100 * change.value)) for change in changes]
    ends = [
        end if change.until is None else along(change.until)
        for change, end in zip(changes, [*(x for x, _ in places[1:]), right], strict=True)
    ]
    steps: list[list[str]] = []
    is_joined = False
    for change, (x, y), end in zip(changes, places, ends, strict=True):
        if change.mark or not is_joined:
            steps.append([])
        steps[-1] += [f"{px(x)},{px(y)}", f"{px(end)},{px(y)}"]
        is_joined = change.until is None
    named = [
        (change.name, x, y)
        for change, (x, y) in zip(changes, places, strict=True)
        if change.is_new_leader
    ]
    marks = [
        (change.mark, x) for change, (x, _) in zip(changes, places, strict=True) if change.mark
    ]
    room = Box(left + 2, frame.top, right + 12, frame.bottom - 2)
    flats = [Box(x, y - 2, end, y + 2) for (x, y), end in zip(places, ends, strict=True) if end > x]
    return LeadChart(
        frame=frame,
        x_ticks=tuple(_dates(start, span, frame, N_DATES if width > 480 else 3)),
        y_ticks=ticks_of(scale),
        steps=tuple(" ".join(each) for each in steps),
        points=tuple(
            LeadPoint(px(x), px(y), _title(change, metric, digits), change.is_new_leader)
            for change, (x, y) in zip(changes, places, strict=True)
        ),
        labels=place_labels(named, room, flats),
        marks=_marks(marks, (left + right) / 2),
        x_title=_time_title(start, now),
        metric=metric,
        description=f"{metric.label} of the leader, in per cent over time. "
        + "; ".join(_title(change, metric, digits) for change in changes[-12:]),
    )


def _marks(marks: Sequence[tuple[str, float]], middle: float) -> tuple[Mark, ...]:
    """Return the marks; of those whose words would lie on one another the last has them."""
    found: list[Mark] = []
    taken: list[tuple[float, float]] = []
    for words, x in reversed(marks):
        width = CHARACTER_WIDTH * len(f"{words}  ")
        begin, end = (x, x + width) if x < middle else (x - width, x)
        is_free = all(end <= low or high <= begin for low, high in taken)
        if is_free:
            taken.append((begin, end))
        anchor = "start" if x < middle else "end"
        found.append(Mark(px(x), words if is_free else "", anchor))
    return tuple(reversed(found))


def takers(leads: Sequence[Lead]) -> list[Lead]:
    """Return the boards with a new leader, newest first."""
    return [change.lead for change in _changes(leads) if change.is_new_leader][::-1]


def _changes(leads: Sequence[Lead]) -> list[_Change]:
    """Boards with a leader that say something else than the one before.

    An entry that was renamed, or whose pseudonym was lifted, still leads.
    """
    found: list[_Change] = []
    led: BoardLeader | None = None
    for lead in leads:
        before = found[-1] if found else None
        if lead.leader is None:
            if before is not None and before.until is None:
                found[-1] = before._replace(until=lead.at)
            continue
        name = lead.leader.method
        is_same = led is not None and led.submission_id == lead.leader.submission_id
        led = lead.leader
        mark = _mark(before, lead)
        is_new = before is None or before.until is not None or (before.name != name and not is_same)
        if before is None or is_new or mark or before.value != lead.leader.value:
            found.append(_Change(lead, name, lead.leader.value, is_new, mark))
    return found


def _mark(before: _Change | None, lead: Lead) -> str:
    """Say what changed in the values' protocol or samples; of the first, its protocol."""
    if before is None or before.lead.protocol != lead.protocol:
        return f"protocol {lead.protocol}"
    if before.lead.part != lead.part:
        return "other samples"
    return "split revised" if before.lead.split_revision != lead.split_revision else ""


def _title(change: _Change, metric: Metric, digits: Digits) -> str:
    part = f", {part_words(change.lead.part)}" if change.lead.part else ""
    until = f", until {minute(change.until)}" if change.until else ""
    return (
        f"{minute(change.lead.at)}{until}: {change.name} leads with {metric.label} "
        f"{digits.text(metric, change.value)} %, protocol {change.lead.protocol}{part}"
    )


def _time_title(start: datetime, now: datetime) -> str:
    """What the horizontal axis is; ticks that are times of day leave the day to it."""
    if now - start >= timedelta(days=1):
        return "time (UTC)"
    days = list(dict.fromkeys(day(at) for at in (start, now)))
    return f"time of day, UTC, {' to '.join(days)}"


def _dates(start: datetime, span: timedelta, frame: Frame, count: int) -> list[Tick]:
    """Evenly placed; days alone only where no two of them are of one day, and seconds where two are of one minute."""
    ticks = []
    for k in range(count):
        share = k / (count - 1)
        at = start + share * span
        if span < timedelta(minutes=count):
            text = f"{at:%H:%M:%S}"
        elif span < timedelta(days=1):
            text = f"{at:%H:%M}"
        elif span < timedelta(days=count):
            text = f"{at.day} {at:%b %H:%M}"
        else:
            text = day(at)
        ticks.append(Tick(px(frame.left + share * (frame.right - frame.left)), text))
    return ticks
