"""What pages, pictures and exports claim of made boards is true of the boards' numbers.

Every board here hangs together: its entries have scenes of their own, from which all numbers follow.
Each claim is read off what was rendered, and worked out anew from the document.
"""

import asyncio
import csv
import io
import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from statistics import fmean
from typing import Any
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from tests.server.pages.made_boards import made_boards, with_curve
from tests.server.pages.page_site import Site, open_site, sheet_of
from tests.server.pages.reading import Node, read

from exceptiondrive_schemas.board import Board, BoardEntry, PairedComparison
from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING, STRATEGY, Challenge
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.score_sheet import Interval, MetricRow
from exceptiondrive_server.boards.pictures import board_picture
from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.table import short_title
from exceptiondrive_server.entries.pictures import entry_picture
from exceptiondrive_server.entries.queries import read_entry

PHASES = {PLANNING.id: "claims", STRATEGY.id: "strategy-claims"}
ATOM = {"a": "http://www.w3.org/2005/Atom"}


# What the document says, worked out here.


def challenge_of(board: Board) -> Challenge:
    return CHALLENGES[board.challenge]


def is_barred(entry: BoardEntry) -> bool:
    return any(flag.code not in FLAGS or FLAGS[flag.code].bars_leading for flag in entry.flags)


def ranked(board: Board) -> list[BoardEntry]:
    return [entry for entry in board.entries if entry.rank is not None]


def contenders(board: Board) -> list[BoardEntry]:
    return [entry for entry in ranked(board) if not is_barred(entry)]


def leader_of(board: Board) -> BoardEntry | None:
    return min(contenders(board), key=lambda entry: entry.rank or 0, default=None)


def percent(value: float | None) -> str | None:
    return None if value is None else f"{value * 100:.2f}"


def labels(entry: BoardEntry) -> list[str]:
    return [flag.label for flag in entry.flags]


def own(board: Board) -> list[BoardEntry]:
    return [entry for entry in board.entries if entry.source != "reported"]


# What was rendered.


def sentence(node: Node) -> str:
    """The text of an element, without the blanks that the reading puts before stops."""
    return re.sub(r" (?=[,.:;])", "", node.text)


def check_the_title(title: str, board: Board) -> None:
    """What the lede gives as a number, as a small fraction; never more certain than it is."""
    leader, second = leader_of(board), challenge_of(board).metrics[1]
    if leader is None:
        assert title == challenge_of(board).words.headline.question
        return
    share = leader.micro[second.key] or 0.0
    share = 1 - share if re.search("stays out|careful enough", title) else share
    if "every time" in title:
        assert share == 1
        return
    found = re.search(r"in (about |over |less than )?(one|\d+) of (\d+) samples\.", title)
    assert found is not None, title
    near, hits, of = found.groups()
    said = Fraction(1 if hits == "one" else int(hits), int(of))
    assert 0 < said < 1
    if near == "over ":
        assert said < share < 1
    elif near == "less than ":
        assert 0 < share < said
    else:
        assert abs(said - share) <= (0.015 if near else 1e-9), title


def could_stand_at(board: Board, entry: BoardEntry, place: int) -> bool:
    """Its range reaches the place, and no interval that is told puts it behind the leader.

    Nor, where none is told of it, one that ranks above it.
    """
    leader = leader_of(board)
    higher = challenge_of(board).metrics[0].better == "higher"
    told = {
        pair.b: pair.overall[challenge_of(board).metrics[0].key].interval
        for pair in board.comparisons
        if leader and pair.a == leader.submission_id
    }
    behind = {
        name for name, ends in told.items() if ends and (ends[0] > 0 if higher else ends[1] < 0)
    }
    is_behind = entry.submission_id in behind or (
        entry.submission_id not in told
        and any(
            (other.rank or 0) < (entry.rank or 0)
            for other in ranked(board)
            if other.submission_id in behind
        )
    )
    return bool(entry.rank_interval and entry.rank_interval[0] <= place and not is_behind)


def check_the_findings(text: str, board: Board) -> None:
    """Who leads, by how much, among how many; and every one that ranks above, with its flags."""
    leader, metrics = leader_of(board), challenge_of(board).metrics[:2]
    text = " ".join(text.split())
    if not ranked(board):
        assert "is ranked on this board." in text
        return
    if leader is None:
        assert "Nobody leads" in text
        assert all(label in text for entry in ranked(board) for label in labels(entry))
        return
    n_ranked = len(ranked(board))
    assert f"Of {n_ranked} ranked" in text if n_ranked > 1 else "only ranked" in text
    first, second = (f"{percent(leader.metrics[metric.key])} %" for metric in metrics)
    numbers = challenge_of(board).words.headline.leads.format(first=first, second=second)
    assert f"{leader.method}" in text
    of_all = f"{percent(leader.micro[metrics[1].key])} %"
    numbers += ", as the mean of families" + (
        f"; over all samples, {metrics[1].label} is {of_all}" if of_all != second else ""
    )
    assert f"{numbers}." in text or f"{numbers}; flagged" in text
    above = [entry for entry in ranked(board) if (entry.rank or 0) < (leader.rank or 0)]
    level = [e for e in contenders(board) if e is not leader and e.rank == leader.rank]
    above, named = (each if len(each) <= 3 else [] for each in (above, level))
    assert set(re.findall(r"Planner\d+x", text)) == {e.method for e in (leader, *above, *named)}
    assert ("leads, level with" in text) == bool(level)
    others = [entry for entry in contenders(board) if entry.rank != leader.rank]
    place = leader.rank or 0
    could = sum(could_stand_at(board, entry, place) for entry in others)
    words = "could be first" if place == 1 else "could lead"
    said = re.search(rf"leads(?:, level with [^:]+?)?, though (\d+) others? {words}:", text)
    assert (int(said[1]) if said else 0) == could
    for entry in (leader, *above):
        assert all(label in text for label in labels(entry))


def check_the_counts(page: Node, board: Board) -> None:
    said = [fact.one("dd").text for fact in page.one("dl", "stats").all("div")]
    n_listed = sum(entry.source == "scored" and entry.rank is None for entry in board.entries)
    assert said[0].startswith(f"{board.n_samples:,} ")
    assert re.match(rf"{len(ranked(board))} \w+ ranked", said[2])
    assert (f"{n_listed} without a rank" in said[2]) == (n_listed > 0)


def lacks(entry: BoardEntry) -> str:
    """What a row without a rank says of itself."""
    barring = [flag.label for flag in entry.flags if flag.code in entry.unranked_flags]
    return ", ".join(barring) or entry.unranked_because or ""


def rows_of(page: Node) -> list[Node]:
    return [row for row in page.one("table", "board").all("tr") if row["id"].startswith("e-")]


def check_the_rows(page: Node, board: Board, average: str) -> None:
    """Ranks, flags, marks, bars and values of every row; and no row of another split."""
    metrics = challenge_of(board).metrics[:2]
    by_name = {entry.method: entry for entry in own(board)}
    rows = rows_of(page)
    shown = [by_name[row.one("a", "pn").text] for row in rows]
    assert sorted(by_name) == sorted(entry.method for entry in shown)
    is_listed = [entry.rank is None for entry in shown if entry.source == "scored"]
    assert is_listed == sorted(is_listed)
    best = {
        metric.key: percent((max if metric.better == "higher" else min)(known))
        for metric in metrics
        if len(known := [values_of(e, average)[metric.key] or 0.0 for e in contenders(board)]) > 1
    }
    for row, entry in zip(rows, shown, strict=True):
        values = values_of(entry, average)
        rank = row.one("td", "rank").one("b").text
        assert rank == (str(entry.rank) if entry.rank else "\u2013")
        tips = row.all("div", "tip")
        assert [label.text for tip in tips for label in tip.all("b")] == labels(entry)
        said = [button.text for button in row.all("button", "flag")]
        is_unranked = entry.source == "scored" and entry.rank is None
        assert ("listed" in row.classes) == is_unranked
        if is_unranked:
            assert said == [f"Not ranked: {lacks(entry)}"]
            assert f"Not ranked: {entry.unranked_because}" in row.text
        else:
            assert [words.lstrip("23 ") for words in said] == (
                [", ".join(labels(entry))] if entry.flags else []
            )
        check_the_range(row, entry)
        assert ("first" in row.classes) == could_stand_at(board, entry, 1)
        for metric in metrics:
            interval = entry.intervals.get(metric.key) if average != "micro" else None
            cell = row.one("td", metric.key)
            check_the_number(cell, metric.label, values[metric.key], interval, board)
            is_best = entry in contenders(board) and percent(values[metric.key]) == best.get(
                metric.key, ""
            )
            number = row.one("td", metric.key).one("b")
            assert ("best" in number.classes) == is_best
        check_the_bar(row.all("svg", "sb"), values, challenge_of(board))


def check_the_range(row: Node, entry: BoardEntry) -> None:
    """The ranks that an entry could have stand beside its rank, where there are several."""
    low, high = entry.rank_interval or (0, 0)
    said = [small.text for small in row.one("td", "rank").all("small")]
    assert said == ([f"{low}\u2013{high}"] if entry.rank and low < high else [])


def check_the_number(
    cell: Node, label: str, known: float | None, interval: Interval | None, board: Board
) -> None:
    """One decimal in the cell, all of them on hover; beside it how far the interval reaches."""
    value = known or 0.0
    assert abs(float(cell.one("b").text) - 100 * value) <= 0.0501
    assert f"{label} {percent(value)}" in cell["title"]
    said = [small.text for small in cell.all("small")]
    if interval is None:
        assert said == []
        return
    below, above = 100 * (value - interval[0]), 100 * (interval[1] - value)
    ways = {text[0]: float(text[1:]) for text in said[0].split()}
    if set(ways) == {"\u00b1"}:
        assert abs(ways["\u00b1"] - max(below, above)) <= 0.0501
        assert (
            max(below, above) <= min(1.5 * min(below, above), 100 * value, 100 - 100 * value) + 0.01
        )
    else:
        for sign, way in (("\u2212", below), ("+", above)):
            assert abs(ways.get(sign, 0.0) - way) <= (0.0501 if sign in ways else 0.0051)
    assert span_words(interval, board) in cell["title"]


def values_of(entry: BoardEntry, average: str) -> MetricRow:
    return entry.micro if average == "micro" else entry.macro_family


def check_the_bar(bars: list[Node], values: MetricRow, challenge: Challenge) -> None:
    """Each part as wide as its share, one beside the other; no bar where one was not counted."""
    parts = challenge.words.outcome
    if any(values.get(part.metric) is None for part in parts):
        assert bars == []
        return
    (bar,) = bars
    start = 0.0
    for part, drawn in zip(parts, bar.all("rect"), strict=True):
        share = 100 * (values[part.metric] or 0.0)
        assert drawn.classes == {f"b-{part.kind}"}
        assert float(drawn["x"].rstrip("%")) == pytest.approx(start, abs=0.06)
        assert float(drawn["width"].rstrip("%")) == pytest.approx(share, abs=0.06)
        assert f"{part.words} {share:.2f} %" in (bar["aria-label"] or bar.one("title").text)
        start += share
    assert start == pytest.approx(100, abs=0.05)


def check_who_could_be_first(page: Node, board: Board) -> None:
    could = [entry for entry in board.entries if could_stand_at(board, entry, 1)]
    foot = sentence(page.one("div", "foot"))
    if not could:
        assert "could be first" not in foot
    elif len(could) == 1:
        assert f"{could[0].method}, which alone could be first" in foot
    else:
        assert f"the {len(could)} that could be first" in foot
    few = "too few scenes to say how sure"
    assert (few in page.text) == (board.min_scenes is not None)
    assert ("interval, how far" in foot) == (board.min_scenes is None)


def check_the_average(page: Node, average: str) -> None:
    """The words and the formulas are of the numbers that the page shows."""
    words = {"macro_family": "mean of families", "micro": "mean of samples"}
    assert f"Every number is the {words[average]}:" in sentence(page.one("div", "foot"))
    means = [part.text for part in page.one("section", id="metrics").all("math")]
    assert means
    assert all(mean.startswith("1 F") == (average == "macro_family") for mean in means)


def span_words(span: tuple[float, float], board: Board) -> str:
    """Where all of a board are of whole per cents, as of withheld splits, none claims decimals.

    Those of entries count, and where an entry has none those of its families.
    """
    shares = [metric.key for metric in challenge_of(board).metrics if metric.unit == "fraction"]
    rows = [
        row.intervals
        for entry in board.entries
        for row in ([entry] if any(entry.intervals.values()) else entry.families.values())
    ]
    told = [span, *(row.get(key) for row in rows for key in shares)]
    ends = [end for each in told if each for end in each]
    is_whole = all(abs(100 * end - round(100 * end)) <= 1e-6 for end in ends)
    return " to ".join(str(percent(end)).removesuffix(".00" if is_whole else "") for end in span)


def check_the_chart(page: Node, board: Board, average: str) -> None:
    """Every point says its entry's own numbers; who has not both of them is named.

    References alone are no picture.
    """
    if all(entry.source == "reference" for entry in own(board)):
        assert not page.all("svg", "wide")
        return
    words = challenge_of(board).words.chart
    y, x = (challenge_of(board).metric(key) for key in (words.y, words.x))
    pairs = {
        entry.method: (values_of(entry, average).get(y.key), values_of(entry, average).get(x.key))
        for entry in own(board)
    }
    known = [
        entry
        for entry in own(board)
        if None not in pairs[entry.method]
        or (entry.source == "reference" and pairs[entry.method][0] is not None)
    ]
    others = [pairs[entry.method][0] or 0 for entry in known if entry.source != "reference"]
    beyond = [
        entry
        for entry in known
        if entry.source == "reference"
        and not challenge_of(board).words.chart.same_scale
        and others
        and (pairs[entry.method][0] or 0) > 2 * max(others)
    ]
    said = set()
    for entry in known:
        if entry in beyond:
            continue
        up, along = (percent(value) for value in pairs[entry.method])
        flags = f" ({', '.join(labels(entry))})" if entry.flags else ""
        right = "not defined" if along is None else f"{along} %"
        said.add(f"{entry.method}{flags}: {y.label} {up} %, {x.label} {right}")
    kinds = ("p-scored", "p-listed", "p-reference")
    groups = [group for kind in kinds for group in page.all("g", kind)]
    points = {group.one("title").text for group in groups if group.all("title")}
    assert points == said
    left = " ".join(line.text for line in page.all("p", "outside")) if points else ""
    missing = {entry.method for entry in own(board) if entry not in known or entry in beyond}
    missing = missing if points else set()
    assert set(re.findall(r"Planner\d+x", left)) == missing


def check_what_is_hardest(page: Node, board: Board) -> None:
    """Columns, the last line and the first sentence follow the mean of all that are ranked."""
    metric = challenge_of(board).metrics[0]
    sections = page.all("section", id="families")
    if all(entry.source == "reference" for entry in own(board)):
        assert sections == []
        return
    (section,) = sections
    shown = [a["title"].partition(":")[0] for a in section.one("thead").all("a")]
    if not ranked(board):
        assert shown == [head.title for head in board.families]
        assert section.all("tfoot") == []
        assert "is hardest" not in section.text
        return

    def value(entry: BoardEntry, family: str) -> float:
        return entry.families[family].metrics[metric.key] or 0.0

    head_of = {head.title: head for head in board.families}
    means = {h.title: fmean(value(e, h.id) for e in ranked(board)) for h in board.families}
    expected = sorted(means, key=lambda title: means[title], reverse=metric.better == "lower")
    assert shown == expected
    foot, n_ranked = section.one("tfoot"), len(ranked(board))
    whose = "the only one ranked" if n_ranked == 1 else f"all {n_ranked} ranked"
    assert foot.one("th").text == f"Mean of {whose}"
    said = [span.text.split()[0] for span in foot.all("span")]
    assert [float(text) for text in said] == [
        pytest.approx(100 * means[title], abs=0.0051) for title in expected
    ]
    large = [title for title in expected if head_of[title].n >= 30]
    first, last = large[0], large[-1]
    of = " of those with at least 30 samples" if len(large) < len(expected) else ""
    claim = f"{first} is hardest and {last} easiest{of}, by the mean of {whose}"
    assert (claim in section.text) == (means[first] != means[last])
    stars = [span.text for span in foot.all("span") if "hardest" in span.text]
    assert stars == [f"{said[expected.index(first)]} hardest"]
    check_the_dots(section, board, expected)
    check_the_tasks(section, board)


def check_the_dots(section: Node, board: Board, expected: list[str]) -> None:
    """The leader and the next four: each says its number and its interval, where they stand."""
    metric = challenge_of(board).metrics[0]
    leader = leader_of(board)
    best = sorted(ranked(board), key=lambda e: (e is not leader, e.rank))[:5]
    svg = section.one("svg", "dots")
    true = []
    for title in expected:
        head = next(head for head in board.families if head.title == title)
        for entry in best:
            cell = entry.families[head.id]
            words = f"{entry.method} {percent(cell.metrics[metric.key])} %"
            span = cell.intervals.get(metric.key)
            if span:
                words += f" ({span_words(span, board)})"
            true.append(f"{short_title(title)}: {words}")
    groups = [group for group in svg.all("g") if group.all("title")]
    assert [group.one("title").text for group in groups] == true
    ticks = [line for line in svg.all("line", "gr") if line["x1"] and line["x1"] == line["x2"]]
    numbers = [float(text.text) for text in svg.all("text", "t-ax")]
    low, high = float(ticks[0]["x1"]), float(ticks[-1]["x1"])
    for group, words in zip(groups, true, strict=True):
        share = float(re.findall(r" (\d+\.\d+) %", words)[0])
        at = low + (share - numbers[0]) / (numbers[-1] - numbers[0]) * (high - low)
        for circle in group.all("circle"):
            assert float(circle["cx"]) == pytest.approx(min(at, high + 60), abs=0.2)
    names = [key.text for key in section.all("span", "key")]
    assert names[: len(best)] == [entry.method for entry in best]


def check_the_tasks(section: Node, board: Board) -> None:
    """Where sheets tell tasks: their means over the ranked entries, the least first."""
    items = section.all("ol", "tasks2")
    if board.challenge != PLANNING.id:
        assert items == []
        return
    tables = [sheet_of(entry).tasks for entry in ranked(board)]
    means = {task: fmean(t[task].metrics["hcc"] or 0.0 for t in tables) for task in tables[0]}
    is_mean = re.search(
        rf"Mean HCC of {len(tables)} ranked planners, .* best of them", section.text
    )
    assert bool(is_mean) == (len(tables) > 1)
    assert ("HCC of the only ranked planner, in per cent." in section.text) == (len(tables) == 1)
    told = {li.one("code").text: float(li.one("b").text) for li in items[0].all("li")}
    assert set(told) == set(means)
    assert list(told.values()) == sorted(told.values())
    for task, number in told.items():
        assert number == pytest.approx(100 * means[task], abs=0.0051)


def check_ahead_in(text: str, board: Board, pair: PairedComparison | None) -> None:
    """`Ahead in` a family is who is better in the whole paired interval there, and nobody else."""
    said = {
        (name, family)
        for name, families in re.findall(r"(Planner\d+x) is ahead in ([^;.]*) scenes", text)
        for family in re.split(r", | and (?=[a-z])", families)
    }
    if pair is None:
        assert said == set()
        assert "tell them apart" not in text
        return
    by_id = {entry.submission_id: entry.method for entry in board.entries}
    true, n_open = set(), 0
    for head in board.families:
        interval = pair.families[head.id].interval
        low, high = interval or (0, 0)
        if low > 0 or high < 0:
            sooner = by_id[pair.a if low > 0 else pair.b]
            true |= {(sooner, part) for part in re.split(" and ", short_title(head.title).lower())}
        elif interval is not None:
            n_open += 1
    assert {(name, part) for name, family in said for part in family.split(" and ")} == true
    if n_open and true:
        assert re.search(rf"in {n_open} famil(y|ies) the split does not tell them apart", text)


def check_the_verdict(text: str, board: Board, a: BoardEntry, b: BoardEntry) -> None:
    """Who is better by how much, whether that is sure, and every flag of the two."""
    first = challenge_of(board).metrics[0]
    x, y = a.metrics[first.key] or 0.0, b.metrics[first.key] or 0.0
    if percent(x) == percent(y):
        assert f"Both stand at {percent(x)}" in text
        return
    ahead, behind = (a, b) if (x > y) == (first.better == "higher") else (b, a)
    gap = percent(abs(x - y))
    assert f"{ahead.method} is {gap} points better than {behind.method}" in text
    for entry in (a, b):
        if entry.flags:
            assert f"{entry.method} is flagged: {', '.join(labels(entry))}." in text


def check_the_csv(text: str, board: Board) -> None:
    leader = leader_of(board)
    rows = list(csv.DictReader(io.StringIO(text)))
    by_name = {entry.method: entry for entry in own(board)}
    assert [row["method"] for row in rows] == [entry.method for entry in own(board)]
    for row in rows:
        entry = by_name[row["method"]]
        assert (row["leads"] == "True") == (entry is leader)
        assert row["flags"].split() == [flag.code for flag in entry.flags]
        assert row["rank"] == str(entry.rank or "")
        assert row["unranked_because"] == (entry.unranked_because or "")
        for key in challenge_of(board).metric_keys:
            value = entry.metrics.get(key)
            assert (float(row[key]) if row[key] else None) == value


def check_the_latex(text: str, board: Board) -> None:
    leader = leader_of(board)
    assert re.findall(r"\\textbf\{(.*?)\}", text) == ([leader.method] if leader else [])
    assert f"% leads: {leader.method if leader else 'nobody'}\n" in text
    lines = {m: line for line in text.splitlines() for m in re.findall(r"& .*?(Planner\d+x)", line)}
    assert set(lines) == {entry.method for entry in own(board)}
    for entry in own(board):
        assert all(label in lines[entry.method] for label in labels(entry))
        assert lines[entry.method].startswith(f"{entry.rank or '--'} & ")


def check_the_card(svg: str, board: Board) -> None:
    """The social card of the board: its title, and the first rows with their flags."""
    picture = read(svg)
    title = " ".join(line.text for line in picture.all("text", "h", x="62"))
    check_the_title(title, board)
    rows, flags = (picture.all("text", x=x) for x in ("116", "117"))
    first = sorted(ranked(board), key=lambda entry: entry.rank or 0)[:5]
    assert [row.text for row in rows] == [entry.method for entry in first]
    assert [line.text for line in flags] == [", ".join(labels(e)) for e in first if e.flags]
    for row, entry in zip(rows, first, strict=True):
        assert ("b" in row.classes) == (entry is leader_of(board) or not entry.flags)


def check_the_entry(page: Node, board: Board, entry: BoardEntry) -> None:
    head = page.one("section", "ehead")
    assert {flag.text for flag in head.all("span", "flag")} == set(labels(entry))
    wide = [svg for svg in head.all("svg", "wideb")]
    check_the_bar(wide, entry.metrics, challenge_of(board))
    if entry.rank is None:
        assert entry.unranked_because is None or entry.unranked_because in head.text.replace(
            "Flagged", "flagged"
        )
    table = page.one("table", "tasks-table")
    families = [row for row in table.all("tr") if "fam" in row.classes]
    for row, head_ in zip(families, board.families, strict=True):
        values = entry.families[head_.id].metrics
        check_the_bar(row.all("svg", "ob"), values, challenge_of(board))
    both = {row.one("th").text: [cell.text for cell in row.all("td")] for row in page.one("table", "both").one("tbody").all("tr")}  # fmt: skip
    for metric in challenge_of(board).metrics[:2]:
        said = next(cells for name, cells in both.items() if name.startswith(f"{metric.label} "))
        assert (said[0], said[2]) == (
            percent(entry.macro_family[metric.key]),
            percent(entry.micro[metric.key]),
        )
    check_the_curve(page, entry)
    if page.all("svg", "bars"):
        check_the_histogram(page, entry)


def check_the_curve(page: Node, entry: BoardEntry) -> None:
    """It starts at 100 - UR, and stands at the share that keeps the whole clearance at 1."""
    lines = [line for line in page.all("polyline") if "cv" in line.classes]
    if not lines:
        return
    svg = next(svg for svg in page.all("svg", "wide") if svg.all("polyline"))
    zero, top = (
        float(tick["y1"]) for tick in (svg.all("line", "gr")[0], svg.all("line", "gr")[-1])
    )
    group = next(group for group in svg.all("g") if group.all("polyline"))
    scale, _, offset = map(float, re.findall(r"-?[\d.]+", group["transform"])[3:])
    y = offset + scale * float(lines[0]["points"].split()[0].split(",")[1])
    assert (y - zero) / (top - zero) == pytest.approx(1 - (entry.metrics["ur"] or 0), abs=0.002)
    said = re.search(rf"{entry.method}: (\S+) % keep the required clearance", sentence(page))
    assert entry.method in [name.text for name in page.all("bdi")], "its numbers stay behind it"
    assert said is not None
    assert said[1] == percent(entry.metrics["clear"])


def check_the_histogram(page: Node, entry: BoardEntry) -> None:
    """Bars are shares of all scenes: those hit are UR, those blue keep the whole clearance."""
    svg = page.one("svg", "bars")
    said = re.findall(r" (hit|\S+\d) (\d+\.\d+) %", svg.one("title").text)
    shares = [float(share) for _, share in said]
    assert sum(shares) == pytest.approx(100, abs=0.05)
    assert shares[0] == pytest.approx(100 * (entry.micro["ur"] or 0), abs=0.006)
    bars = svg.all("rect", "hb")
    blue = [share for bar, share in zip(bars, shares, strict=True) if "clear" in bar.classes]
    assert sum(blue) == pytest.approx(100 * (entry.micro["clear"] or 0), abs=0.03)
    tallest = max(float(bar["height"]) for bar in bars)
    for bar, share in zip(bars, shares, strict=True):
        height = float(bar["height"]) / tallest * max(shares)
        assert height == pytest.approx(share, abs=0.2)


# One site for all boards: each is published on top of the last.


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite: Path) -> Iterator[Site]:
    site = open_site(tmp_path_factory.mktemp("claims"), migrated_sqlite)
    for challenge, phase in PHASES.items():
        site.create_phase(phase, challenge, shows_reported=True)
    yield site
    site.database.dispose()


def publish(site: Site, board: Board) -> None:
    site.publish(board)
    for entry in board.entries:
        if entry.source == "scored" and board.challenge == PLANNING.id:
            site.keep_submission(entry, board.phase, with_curve(sheet_of(entry), entry))


def get(site: Site, path: str) -> str:
    answer = asyncio.run(site.get(path))
    assert answer.status_code == 200, path
    return answer.text


def svg_of(site: Site, draw: Any, read_it: Any, *asked: Any) -> str:
    with site.database.read() as session:
        return str(draw(read_it(session, *asked)))


@pytest.mark.parametrize("challenge", CHALLENGES.values(), ids=lambda one: one.id)
@settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=(
        Phase.reuse,
        Phase.generate,
    ),  # a board is read as it is: to make it smaller takes minutes
)
@given(data=st.data())
def test_every_claim_is_true_of_the_board(site: Site, challenge: Challenge, data: Any) -> None:
    phase = PHASES[challenge.id]
    board = data.draw(made_boards(challenge.id, phase))
    publish(site, board)
    printed = [entry.method for entry in board.entries if entry.source == "reported"]
    everything = []
    for average in ("macro_family", "micro"):
        text = get(site, f"/?phase={phase}&average={average}")
        everything.append(text)
        page = read(text)
        check_the_title(page.one("h1").text, board)
        check_the_findings(page.one("p", "lede").text, board)
        check_the_counts(page, board)
        check_the_rows(page, board, average)
        check_who_could_be_first(page, board)
        check_the_average(page, average)
        check_the_chart(page, board, average)
        check_what_is_hardest(page, board)
    check_the_rows(read(get(site, f"/?phase={phase}&sort={challenge.metrics[1].key}")), board, "")
    for a, b in [*zip(ranked(board), ranked(board)[1:], strict=False)][:2]:
        for one, other in ((a, b), (b, a)):
            path = f"/compare?phase={phase}&a={one.submission_id}&b={other.submission_id}"
            everything.append(get(site, path))
            lede = read(everything[-1]).one("p", "lede").text
            pairs = {frozenset((pair.a, pair.b)): pair for pair in board.comparisons}
            pair = pairs.get(frozenset((a.submission_id or "", b.submission_id or "")))
            check_ahead_in(lede, board, pair)
            check_the_verdict(lede, board, one, other)
            if "clear" in one.metrics:
                check_the_curve(read(everything[-1]), one)
    for entry in [entry for entry in board.entries if entry.source == "scored"][:2]:
        everything.append(get(site, f"/entries/{entry.submission_id}?phase={phase}"))
        check_the_entry(read(everything[-1]), board, entry)
        badge = get(site, f"/badges/{entry.submission_id}.svg?phase={phase}")
        rank = f"rank {entry.rank}" if entry.rank else "not ranked"
        flags = f", flagged: {', '.join(labels(entry))}" if entry.flags else ""
        first = challenge.metrics[0]
        words = f"{rank}, {first.label} {percent(entry.metrics[first.key])} %{flags}"
        assert read(badge).one("title").text == f"ExceptionDrive: {words}"
        card = svg_of(site, entry_picture, read_entry, entry.submission_id, BoardQuery(phase=phase))
        assert ("Flagged: " + ", ".join(labels(entry)) in read(card).text) == bool(entry.flags)
        everything += [badge, card]
    everything.append(svg_of(site, board_picture, read_board, BoardQuery(phase=phase)))
    check_the_card(everything[-1], board)
    for form, check in (("csv", check_the_csv), ("tex", check_the_latex)):
        everything.append(get(site, f"/export/board.{form}?phase={phase}"))
        check(everything[-1], board)
    everything.append(get(site, f"/feed.atom?phase={phase}"))
    newest = Xml.fromstring(everything[-1]).find("a:entry", ATOM)
    assert newest is not None
    summary = newest.findtext("a:summary", "", ATOM)
    new = re.match(r"(\d+) newly ranked(?: \([^)]*\))?(?:; \d+ left(?: \([^)]*\))?)?\. ", summary)
    assert (int(new[1]) if new else 0) == len(ranked(board)), "on a first board all are new"
    check_the_findings(summary[new.end() if new else 0 :], board)
    for text in everything:
        assert not any(f">{name}<" in text or f"{name} (reported)" in text for name in printed)
