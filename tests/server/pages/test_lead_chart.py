"""Who led, over time: steps, names and changes of protocol are those of the boards that were shown."""

import re
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from tests.server.pages.reading import Node, read

from exceptiondrive_records.boards.boards import Lead, leads
from exceptiondrive_schemas.board import Board, BoardLeader
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_server.boards.lead_chart import lead_chart, takers
from exceptiondrive_server.web.numbers import Digits

START = datetime(2026, 3, 1, tzinfo=UTC)
HCC = PLANNING.metrics[0]


def lead(day: int, method: str, value: float, protocol: str = "1.0") -> Lead:
    leader = BoardLeader(submission_id=f"of-{method}", method=method, team="T", value=value)
    return Lead(START + timedelta(days=day), day + 1, protocol, "sha256:a", None, leader)


STORY = (
    lead(0, "First", 0.20),
    lead(2, "First", 0.20),  # another board, the same lead
    lead(5, "First", 0.24),
    lead(10, "Second", 0.31),
    lead(15, "Second", 0.28, "1.1"),
)


def test_whose_pseudonym_is_lifted_takes_no_lead() -> None:
    before, after = lead(0, "Method EG2", 0.20), lead(2, "Named", 0.20)
    assert before.leader is not None
    assert after.leader is not None
    same = after.leader.model_copy(update={"submission_id": before.leader.submission_id})
    assert takers((before, after._replace(leader=same))) == [before]
    assert takers((before, after)) == [after, before]


def corners(step: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in (point.split(",") for point in step.split())]


@pytest.mark.parametrize("width", [640, 350])
def test_a_step_is_as_long_as_the_lead_and_as_high_as_its_value(width: int) -> None:
    chart = lead_chart(STORY, START + timedelta(days=20), HCC, Digits(), width=width)
    assert chart is not None
    assert chart.description.startswith("HCC of the leader, in per cent over time. 1 Mar")
    left, right = chart.frame.across
    ticks = [(float(tick.at), float(tick.text)) for tick in chart.y_ticks]
    (y0, v0), (y1, v1) = ticks[0], ticks[-1]
    days = [20 * (x - left) / (right - left) for step in chart.steps for x, _ in corners(step)]
    values = [
        v0 + (y - y0) / (y1 - y0) * (v1 - v0) for step in chart.steps for _, y in corners(step)
    ]
    assert days == pytest.approx([0, 5, 5, 10, 10, 15, 15, 20], abs=0.1)
    assert values == pytest.approx([20, 20, 24, 24, 31, 31, 28, 28], abs=0.1)
    assert len(chart.steps) == 2  # none crosses the change of protocol
    assert [mark.words for mark in chart.marks] == ["protocol 1.0", "protocol 1.1"]
    assert [label.text for label in chart.labels] == ["First", "Second"]
    assert [point.is_new for point in chart.points] == [True, False, True, False]
    assert chart.points[2].title == (
        "11 Mar 2026, 00:00 UTC: Second leads with HCC 31.00 %, protocol 1.0"
    )


@pytest.mark.parametrize(
    ("span", "title", "ends"),
    [
        (timedelta(minutes=2), "time of day, UTC, 1 Mar 2026", ("00:00:00", "00:02:00")),
        (timedelta(hours=2), "time of day, UTC, 1 Mar 2026", ("00:00", "02:00")),
        (timedelta(days=2), "time (UTC)", ("1 Mar 00:00", "3 Mar 00:00")),
        (timedelta(days=20), "time (UTC)", ("1 Mar 2026", "21 Mar 2026")),
    ],
)
def test_the_axis_says_what_it_is_and_names_no_moment_twice(
    span: timedelta, title: str, ends: tuple[str, str]
) -> None:
    chart = lead_chart(STORY[:1], START + span, HCC, Digits(), width=640)
    assert chart is not None
    texts = [tick.text for tick in chart.x_ticks]
    assert (chart.x_title, (texts[0], texts[-1])) == (title, ends)
    assert len(set(texts)) == len(texts)


def test_names_of_protocols_of_one_day_do_not_lie_on_one_another() -> None:
    hours = ("1.2", "1.3", "1.4", "1.5")
    day = [
        STORY[0]._replace(at=START + timedelta(days=12, hours=n), number=20 + n, protocol=version)
        for n, version in enumerate(hours)
    ]
    chart = lead_chart((*STORY[:4], *day), START + timedelta(days=20), HCC, Digits())
    assert chart is not None
    assert [mark.words for mark in chart.marks] == ["protocol 1.0", "", "", "", "protocol 1.5"]
    assert len({mark.x for mark in chart.marks}) == 5, "each change has its line"


def test_nobody_who_led_nothing_to_draw() -> None:
    assert lead_chart((), START, HCC, Digits()) is None
    nobody = STORY[0]._replace(leader=None)
    assert lead_chart((nobody,), START, HCC, Digits()) is None


@pytest.mark.parametrize(
    ("later", "words", "told"),
    [
        ({"split_revision": "sha256:b", "part": "private"}, "other samples", ", the private part"),
        ({"split_revision": "sha256:b"}, "split revised", ""),
    ],
)
def test_no_step_crosses_a_change_of_the_samples_that_count(
    later: dict[str, Any], words: str, told: str
) -> None:
    leads_told = (lead(0, "First", 0.20), lead(5, "First", 0.20)._replace(**later))
    chart = lead_chart(leads_told, START + timedelta(days=10), HCC, Digits())
    assert chart is not None
    assert [len(corners(step)) for step in chart.steps] == [2, 2]
    assert [mark.words for mark in chart.marks] == ["protocol 1.0", words]
    assert [point.is_new for point in chart.points] == [True, False]
    assert chart.points[1].title.endswith(f"HCC 20.00 %, protocol 1.0{told}")


@pytest.mark.parametrize("then", ["nobody", "First", "Second"])
def test_a_step_ends_where_nobody_leads_any_more(then: str) -> None:
    gone = [lead(day, "First", 0.20)._replace(leader=None) for day in (5, 6)]
    after = [] if then == "nobody" else [lead(15, then, 0.20)]
    told = (lead(0, "First", 0.20), *gone, *after)
    chart = lead_chart(told, START + timedelta(days=20), HCC, Digits())
    assert chart is not None
    left, right = chart.frame.across
    days = [[20 * (x - left) / (right - left) for x, _ in corners(step)] for step in chart.steps]
    ends = [[0, 5], [15, 20]][: 1 + len(after)]
    assert days == [pytest.approx(each, abs=0.1) for each in ends]
    assert chart.points[0].title.startswith(
        "1 Mar 2026, 00:00 UTC, until 6 Mar 2026, 00:00 UTC: First leads with"
    )
    assert [mark.words for mark in chart.marks] == ["protocol 1.0"]
    assert [each.at for each in takers(told)] == [each.at for each in [*after, told[0]]]


def titles(page: Node) -> list[str]:
    (wide,) = (svg for svg in page.all("svg", "wide"))
    return [circle.one("title").text for circle in wide.all("circle")]


async def test_the_history_names_who_led_each_board_and_draws_it(
    lively_site: Any, lively_board: Board
) -> None:
    first, second, *others = lively_board.entries
    changed = second.model_copy(update={"metrics": {**second.metrics, "hcc": 0.5}})
    metrics = {**first.metrics, "hcc": 0.6511}
    better = first.model_copy(
        update={"metrics": metrics, "method": "Newcomer", "submission_id": "s0000077kq"}
    )
    newer = lively_board.model_copy(update={"entries": (better, changed, *others)})
    lively_site.publish(newer)
    lively_site.change_protocol(lively_board)
    page = read((await lively_site.get("/history?phase=sample")).text)
    said = [re.sub(r"^.* UTC: ", "", title) for title in titles(page)]
    assert said == [
        "Kestrel-2 leads with HCC 61.40 %, protocol 1.0",
        "Newcomer leads with HCC 65.11 %, protocol 1.0",
        "Kestrel-2 leads with HCC 61.40 %, protocol 1.1",
    ]
    rows = [row.text for row in page.one("ol", "hist").all("li") if row.all("p", "no")]
    assert "Kestrel-2 leads, 61.40" in rows[0]
    assert "Newcomer leads, 65.11" in rows[1]
    assert f"Newcomer {first.team} came onto the board at rank 1, HCC 65.11 %" in rows[1]
    was = f"{100 * (second.metrics['hcc'] or 0.0):.2f}"
    assert f"{second.method} {second.team} HCC {was} % to 50.00 % (" in rows[1]
    assert "The first board of the phase." in rows[2]
    led = [row.text for row in page.one("ol", "led").all("li")]
    assert [words.split()[0] for words in led] == ["Kestrel-2", "Newcomer", "Kestrel-2"]
    with lively_site.database.read() as session:
        told = leads(session, "sample")
    assert [each.number for each in told] == [1, 2, 3]


async def test_a_flagged_first_entry_does_not_lead_the_history(
    lively_site: Any, lively_board: Board
) -> None:
    with lively_site.database.read() as session:
        (only,) = leads(session, "sample")
    assert lively_board.leader is not None
    assert only.leader is not None
    assert only.leader.method == lively_board.leader.method


async def test_a_phase_without_a_board_has_no_chart(site: Any) -> None:
    site.create_phase("sample")
    page = read((await site.get("/history?phase=sample")).text)
    assert page.all("svg", "wide") == []
