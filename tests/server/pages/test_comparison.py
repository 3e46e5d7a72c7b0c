"""Two entries side by side."""

import re
from typing import Any

import pytest
from tests.server.pages.invented_board import KEYS, STILL
from tests.server.pages.page_site import fill

from exceptiondrive_schemas.board import Board, PairedComparison
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import BreakdownRow, PairedDifference
from exceptiondrive_server.boards.comparison import (
    Comparison,
    Sheets,
    default_pair,
    difference_table,
    family_value,
    find_pair,
    is_sure,
)
from exceptiondrive_server.boards.families import dot_plot
from exceptiondrive_server.entries.compare import against, verdict
from exceptiondrive_server.web.numbers import Digits
from exceptiondrive_server.web.templating import macro

PROTOCOL = packaged_protocol()


def entry(board: Board, method: str) -> Any:
    return next(entry for entry in board.entries if entry.method.startswith(method))


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        ("Kestrel", "LaneKeeper", "overlap; these two were not compared sample by sample, which"),
        ("Kestrel", "nerve", "The ranks that each could have do not overlap."),
        ("nerve", "Kestrel", "nerve is flagged: Blind to the edit."),
        ("Kestrel", "half", "half-a-file has no HCC"),
        ("half", "Kestrel", "half-a-file has no HCC"),
        ("CONSTANT", "Kestrel", "Their intervals do not overlap"),
    ],
)
def test_the_verdict_never_says_more_than_the_data(
    lively_board: Board, a: str, b: str, words: str
) -> None:
    pair = entry(lively_board, a), entry(lively_board, b)
    assert words in Comparison(lively_board, *pair, Digits()).verdict


def test_ranks_that_follow_another_metric_are_not_said_to_overlap(lively_board: Board) -> None:
    first, last = entry(lively_board, "Kestrel"), entry(lively_board, "nerve")
    a, b = (
        one.model_copy(update={"rank": other.rank, "rank_interval": other.rank_interval})
        for one, other in ((first, last), (last, first))
    )
    said = Comparison(lively_board, a, b, Digits()).verdict
    assert "HCC: Kestrel-2 is" in said
    assert "The ranks that each could have do not overlap." in said


def test_equal_published_values_are_called_equal(lively_board: Board) -> None:
    one = entry(lively_board, "Kestrel")
    both = Comparison(lively_board, one, one, Digits())
    assert both.verdict == "Both stand at 61.40 % HCC."


def test_nobody_is_ahead_in_a_family_without_a_pair(lively_board: Board) -> None:
    pair = entry(lively_board, "Kestrel"), entry(lively_board, "nerve")
    assert Comparison(lively_board, *pair, Digits()).families_sentence == ""


def test_ahead_in_a_family_is_who_is_surely_better_there(lively_board: Board) -> None:
    board = with_pairs(lively_board)
    first, second, third = board.entries[:3]
    rest = "in 1 family the split does not tell them apart."
    sure = Comparison(board, first, third, Digits()).families_sentence
    assert sure == f"Kestrel-2 is ahead in lane blockage scenes; {rest}"
    turned = Comparison(board, third, first, Digits()).families_sentence
    assert turned == f"Kestrel-2 is ahead in lane blockage scenes; {rest}"
    open_ = Comparison(board, first, second, Digits()).families_sentence
    assert open_ == "In no family is one surely ahead."


def test_where_there_is_no_interval_nothing_is_said_to_be_open(lively_board: Board) -> None:
    """As of a split of one scene: no verdict but that there is none, and no rank ranges to look at."""
    board = with_pairs(lively_board)

    def bare(told: dict[str, PairedDifference]) -> dict[str, PairedDifference]:
        none = {"interval": None, "verdict": "no interval"}
        return {key: found.model_copy(update=none) for key, found in told.items()}

    pairs = [
        each.model_copy(update={"overall": bare(each.overall), "families": bare(each.families)})
        for each in board.comparisons
    ]
    board = board.model_copy(update={"comparisons": tuple(pairs)})
    first, second = board.entries[:2]
    both = Comparison(board, first, second, Digits())
    assert both.families_sentence == ""
    assert both.verdict.endswith("Sample by sample, HCC gives no interval here.")
    told = Comparison(board.model_copy(update={"min_scenes": 5}), first, second, Digits()).verdict
    assert told.endswith("gives no interval here. This split has too few scenes to say how sure a number is: "
                         "intervals take 5 in each family.")  # fmt: skip
    assert against(board, first, second, Digits()).note == "no interval"


def test_a_family_without_an_interval_is_not_counted_as_open(lively_board: Board) -> None:
    board = with_pairs(lively_board)
    pairs = [
        each.model_copy(
            update={
                "families": {
                    **each.families,
                    "road_surface_hazard": each.families["lane_blockage"].model_copy(
                        update={"interval": None, "verdict": "no interval"}
                    ),
                }
            }
        )
        for each in board.comparisons
    ]
    board = board.model_copy(update={"comparisons": tuple(pairs)})
    first, _, third = board.entries[:3]
    said = Comparison(board, first, third, Digits()).families_sentence
    assert said.endswith("; in 1 family the split does not tell them apart.")


async def test_two_teams_with_one_name_of_a_method_are_told_apart(
    site: Any, lively_board: Board
) -> None:
    board = with_pairs(lively_board)
    first, second, third, *others = board.entries
    alike = [
        each.model_copy(update={"method": "In time", "team": team})
        for each, team in ((first, "Alpha"), (third, "Beta"))
    ]
    board = board.model_copy(update={"entries": (alike[0], second, alike[1], *others)})
    pairs = [
        each.model_copy(
            update={
                "overall": {
                    key: found.model_copy(update={"verdict": "In time is better"})
                    for key, found in each.overall.items()
                }
            }
        )
        for each in board.comparisons
    ]
    site.create_phase("sample", shows_reported=True)
    site.publish(board.model_copy(update={"comparisons": tuple(pairs)}))
    two = "/compare?phase=sample&a=s0000000kq&b=s0000002kq"
    for address in (two, f"{two}&more=s0000001kq", "/?phase=sample"):
        text = re.sub(r"\s+", " ", (await site.get(address)).text)
        alone = re.findall(r"[^<>]*In time(?!, (?:Alpha|Beta)| of (?:Alpha|Beta))[^<>]*", text)
        if address.startswith("/compare"):
            assert "In time, Alpha is" in text
            assert "In time, Alpha is better" in text
            assert alone == []
        else:
            assert "Compare In time of Alpha" in text
            assert "Compare In time of Beta" in text
    beside = (
        await site.get("/compare?phase=sample&a=s0000000kq&b=s0000001kq&more=s0000002kq")
    ).text
    assert '<h2 class="blk">In time, Alpha against LaneKeeper' in beside
    assert "HCC: In time, Alpha is" in beside


async def test_a_range_of_one_rank_is_not_told_twice(site: Any, lively_board: Board) -> None:
    first, *others = lively_board.entries
    sure = first.model_copy(update={"rank": 1, "rank_interval": (1, 1)})
    site.create_phase("sample", shows_reported=True)
    site.publish(lively_board.model_copy(update={"entries": (sure, *others)}))
    text = (await site.get("/compare?phase=sample&a=s0000000kq&b=s0000001kq")).text
    ranks = text.split('<th scope="row">Rank</th>')[1].split("</tr>")[0]
    assert re.findall(r"<td>\s*1\s*(<small>.*?)?</td>", ranks) == [""]


async def test_ranks_that_each_could_have_are_named_where_there_are_any(
    site: Any, lively_board: Board
) -> None:
    site.create_phase("sample", shows_reported=True)
    site.publish(lively_board)
    site.create_phase("bare")
    entries = [each.model_copy(update={"rank_interval": None}) for each in lively_board.entries]
    changes = {"entries": tuple(entries), "phase": "bare"}
    site.publish(lively_board.model_copy(update=changes))
    for phase, is_told in (("sample", True), ("bare", False)):
        text = (await site.get(f"/compare?phase={phase}&a=s0000000kq&b=s0000001kq")).text
        assert ("comes from the ranks that each could have" in text) == is_told


def test_of_families_that_are_not_told_nothing_is_said(lively_board: Board) -> None:
    board = with_pairs(lively_board)
    pairs = [each.model_copy(update={"families": {}}) for each in board.comparisons]
    board = board.model_copy(update={"comparisons": tuple(pairs)})
    first, second = board.entries[:2]
    assert Comparison(board, first, second, Digits()).families_sentence == ""


def test_differences_are_first_minus_second(paper_board: Board) -> None:
    both = Comparison(
        paper_board, entry(paper_board, "ST-P3"), entry(paper_board, "Impromptu"), Digits()
    )
    differences = [both.difference(metric) for metric in both.challenge.metrics]
    printed = ("+1.39", "\u22120.81", "\u22120.28", "\u22120.63", "\u22120.31", "\u22120.46")
    by_key = dict(zip(KEYS, printed, strict=True))
    assert differences == [by_key.get(key, "") for key in both.challenge.metric_keys]
    told = [
        Digits().difference(
            both.first, *(family_value(each, head.id, both.first) for each in (both.a, both.b))
        )
        for head in paper_board.families[:2]
    ]
    assert told == ["+0.39", "\u22120.42"]


async def test_one_difference_of_two_is_told_wherever_the_page_tells_it(paired_site: Any) -> None:
    """Sample by sample it is 4.00 points; the two HCC lie 4.09 apart."""
    text = (await paired_site.get("/compare?phase=sample&a=s0000000kq&b=s0000002kq")).text
    rows = re.findall(r'<th scope="row">HCC.*?</tr>', text, re.DOTALL)
    told = [re.findall(r"[+\u2212]\d\.\d\d(?!\d)", row)[0] for row in rows]
    assert told == ["+4.00", "+4.00"]
    assert "HCC: Kestrel-2 is 4.00 points better than brake-late." in text


def test_the_leader_and_the_best_beside_it_are_compared_first(
    lively_board: Board, paper_board: Board, empty_board: Board
) -> None:
    best = default_pair(lively_board)
    assert best is not None
    assert [e.rank for e in best] == [1, 2]
    first, *others = lively_board.entries
    parked = first.model_copy(update={"flags": (STILL,)})
    unflagged = default_pair(lively_board.model_copy(update={"entries": (parked, *others)}))
    assert unflagged is not None
    assert [e.rank for e in unflagged] == [2, 3]
    assert default_pair(paper_board) is None
    assert default_pair(empty_board) is None


async def test_the_compare_page_takes_two_keys(lively_site: Any) -> None:
    answer = await lively_site.get("/compare?phase=sample&a=s0000005kq&b=s0000000kq")
    assert answer.status_code == 200
    assert "nerve against Kestrel-2" in answer.text
    assert (await lively_site.get("/compare?phase=sample&a=reported-st-p3")).status_code == 404
    assert (await lively_site.get("/compare?a=unknown")).status_code == 404


@pytest.mark.parametrize(
    ("given", "pair"),
    [
        ("a=s0000000kq", "Kestrel-2 against LaneKeeper XL"),
        ("b=s0000001kq", "Kestrel-2 against LaneKeeper XL"),
        ("a=s0000001kq", "LaneKeeper XL (bypass head, 3 s) against Kestrel-2"),
        ("b=s0000000kq", "LaneKeeper XL (bypass head, 3 s) against Kestrel-2"),
        ("a=s0000005kq", "nerve against Kestrel-2"),
    ],
)
async def test_one_that_is_named_alone_stands_beside_the_best_other(
    lively_site: Any, given: str, pair: str
) -> None:
    assert pair in (await lively_site.get(f"/compare?phase=sample&{given}")).text


async def test_without_a_board_there_is_nothing_to_compare(site: Any) -> None:
    answer = await site.get("/compare")
    assert answer.status_code == 200
    assert "not two entries to compare" in answer.text


def paired(low: float, high: float, verdict: str) -> PairedDifference:
    middle = (low + high) / 2
    return PairedDifference(
        difference=middle, interval=(low, high), discordant=None, verdict=verdict
    )


def with_pairs(board: Board) -> Board:
    """The first is surely better than the third and fifth, and not told from the second."""
    ids = [entry.submission_id or "" for entry in board.entries[:5]]
    sure = paired(0.01, 0.07, "Kestrel-2 is better")
    open_ = paired(-0.02, 0.07, "not separable on this split")
    found = {1: open_, 2: sure, 4: sure}
    pairs = tuple(
        PairedComparison(
            a=ids[0],
            b=ids[at],
            overall={"hcc": each},
            families={"lane_blockage": each, "sudden_emergence": open_},
            tasks={"LB1": each, "LB2": open_},
        )
        for at, each in found.items()
    )
    return board.model_copy(update={"comparisons": pairs})


@pytest.fixture
def paired_site(site: Any, lively_board: Board) -> Any:
    site.create_phase("sample", shows_reported=True)
    site.publish(with_pairs(lively_board))
    for each in lively_board.entries:
        if each.source == "scored" and each.rank is not None:
            site.keep_submission(each)
    return site


async def test_several_are_set_side_by_side_and_each_against_each(paired_site: Any) -> None:
    address = (
        "/compare?phase=sample&a=s0000000kq&b=s0000001kq&more=s0000002kq&more=reference-freeze"
    )
    text = (await paired_site.get(address)).text
    assert "4 planners side by side" in text
    assert (
        "Of those that no flag bars, Kestrel-2 has the best HCC; it is surely better than brake-late; "
        "this split does not tell it from LaneKeeper XL (bypass head, 3 s); against FREEZE no paired "
        "interval is known. FREEZE is flagged: Stands still."
    ) in text
    table = text[text.index('id="against"') :]
    assert table.index("surely better") < table.index("surely worse")
    assert text.count('name="more"') == 3
    assert all(f'class="chart dots {width}"' in text for width in ("wide", "nar"))
    assert set(re.findall(r'class="chart (\w+)', text[: text.index("Sample by sample")])) == {
        "dots"
    }


def test_several_name_who_is_level_with_the_best(lively_board: Board) -> None:
    first, second, third = lively_board.entries[:3]
    second = second.model_copy(update={"metrics": first.metrics})
    words = verdict(with_pairs(lively_board), (first, second, third), Digits())
    assert words.startswith(
        f"Of these, {first.method} has the best HCC, level with {second.method}; it is surely better "
        f"than {third.method}."
    )


def test_of_several_a_flagged_one_that_is_surely_better_is_said_to_be(lively_board: Board) -> None:
    """The best of the others is not better than a parked car that a protocol ranks first."""
    parked = lively_board.entries[0].model_copy(update={"flags": (STILL,)})
    best, other = lively_board.entries[2:4]
    words = verdict(with_pairs(lively_board), (parked, best, other), Digits())
    assert words.startswith(
        f"Of those that no flag bars, {best.method} has the best HCC; it is surely worse than "
        f"{parked.method};"
    )


async def test_a_comparison_says_what_its_differences_are_of_and_how_many_are_chance(
    paired_site: Any,
) -> None:
    answer = await paired_site.get("/compare?phase=sample&a=s0000000kq&b=s0000001kq")
    text = " ".join(answer.text.split())
    assert (
        "on the samples where both have a value: for a metric that can be undefined on a sample, this "
        "may differ from the difference of the two means above."
    ) in text
    assert (
        "Between equal planners with symmetric differences, up to about 5 % of the lines look certain by "
        "chance, and more if one is usually a little better and rarely much worse."
    ) in text


async def test_every_page_names_the_confidence_of_its_intervals_as_it_is(
    site: Any, lively_board: Board
) -> None:
    fill(site, with_pairs(lively_board.model_copy(update={"confidence": 0.995})))
    compared = "/compare?phase=sample&a=s0000000kq&b=s0000001kq"
    for path in ("/", compared, "/entries/s0000000kq"):
        answer = await site.get(path)
        said = set(re.findall(r"([\d.]+)\s?% interval", answer.text))
        assert said - {"95"} == {"99.5"}, path
    assert "up to about 0.5 % of the lines" in " ".join((await site.get(compared)).text.split())


async def test_anyone_on_the_board_is_found_by_typing_a_name(lively_site: Any) -> None:
    """By label, by part of one that only one entry has, and chosen alone by ticks."""
    typed = "/compare?phase=sample&a=nerve&b=brake-late,+Osprey&more=M%C3%B8ller"
    answer = await lively_site.get(typed)
    keyed = "/compare?phase=sample&a=s0000005kq&b=s0000002kq&more=s0000003kq"
    assert (answer.status_code, answer.headers["location"]) == (303, keyed)
    ticked = await lively_site.get("/compare?phase=sample&more=s0000005kq&more=s0000002kq")
    assert "nerve against brake-late" in ticked.text
    assert '<option value="half-a-file, Team Aurora"></option>' in ticked.text
    unclear = await lively_site.get("/compare?phase=sample&a=Halden&b=nerve")
    assert unclear.status_code == 404


async def test_the_address_of_a_comparison_holds_all_of_it(paired_site: Any) -> None:
    address = "/compare?phase=sample&board=1&a=s0000000kq&b=s0000001kq&more=s0000002kq"
    text = (await paired_site.get(address.replace("&board=1", ""))).text
    assert f'href="{address.replace("&", "&amp;")}"' in text
    swapped = "/compare?phase=sample&amp;a=s0000001kq&amp;b=s0000000kq&amp;more=s0000002kq"
    assert f'href="{swapped}"' in text
    same = "/compare?phase=sample&a=s0000000kq&b=s0000001kq&more=s0000000kq&more="
    assert "side by side" not in (await paired_site.get(same)).text
    unknown = await paired_site.get(f"{address}&more=nobody")
    assert unknown.status_code == 404


async def test_at_most_six_are_compared_at_once(paired_site: Any) -> None:
    more = "".join(f"&more=s000000{at}kq" for at in range(2, 6)) + "&more=reference-freeze"
    text = (await paired_site.get(f"/compare?a=s0000000kq&b=s0000001kq{more}")).text
    assert "6 planners side by side" in text
    assert "add one more" not in text


def test_tasks_are_compared_by_what_is_published(lively_board: Board, sheets: Sheets) -> None:
    board = with_pairs(lively_board)
    both = Comparison(board, board.entries[0], board.entries[2], Digits())
    table = difference_table(both, PROTOCOL, sheets)
    assert table is not None
    families = [line for line in table.lines if line.is_family]
    assert (len(families), len(table.lines)) == (6, 6 + 21)
    assert sheets[0] is not None
    assert sheets[1] is not None
    values = [sheet.tasks["LB1"].metrics["hcc"] or 0 for sheet in sheets if sheet]
    line = next(line for line in table.lines if line.title == "Stalled vehicle")
    hcc = PLANNING.metrics[0]
    assert line.value == pytest.approx(values[0] - values[1])
    assert line.interval(hcc, Digits()) == "+1 to +7"
    assert line.found is not None
    assert (line.found.verdict, is_sure(line.found)) == ("Kestrel-2 is better", True)
    family = next(line for line in families if line.title == "Lane Blockage")
    assert family.interval(hcc, Digits()) == "+1 to +7"
    plain = next(line for line in table.lines if line.title == "Occluded pedestrian")
    assert (plain.interval(hcc, Digits()), plain.found, is_sure(plain.found)) == ("", None, False)
    assert plain.value is not None


def test_a_withheld_task_has_no_difference(lively_board: Board, sheets: Sheets) -> None:
    first = sheets[0]
    assert first is not None
    withheld = BreakdownRow.of(7, dict.fromkeys(first.tasks["LB1"].metrics))
    coarse = first.model_copy(update={"tasks": {**first.tasks, "LB1": withheld}})
    both = Comparison(lively_board, lively_board.entries[0], lively_board.entries[2], Digits())
    table = difference_table(both, PROTOCOL, (coarse, sheets[1]))
    assert table is not None
    line = next(line for line in table.lines if line.title == "Stalled vehicle")
    assert line.value is None


def test_a_difference_that_is_not_there_says_why() -> None:
    said = macro("web/macros/tables.html", "difference")
    assert "+1.00" in said("+1.00", 7, 100)
    assert "not told (under 100 samples)" in said("", 7, 100)
    assert "not defined for both" in said("", 100, 100)
    assert "not defined for both" in said("")


async def test_a_column_that_says_nothing_of_any_metric_is_left_out(paired_site: Any) -> None:
    address = "/compare?a=s0000000kq&b=s0000002kq"
    text = (await paired_site.get(address)).text
    assert "Sample by sample" in text
    assert "Scenes that differ" not in text


def test_the_other_order_turns_tasks_too(lively_board: Board) -> None:
    found = find_pair(with_pairs(lively_board), "s0000002kq", "s0000000kq")
    assert found is not None
    assert found.tasks["LB1"].interval == (-0.07, -0.01)
    assert found.tasks["LB1"].verdict == "Kestrel-2 is better"


async def test_the_page_shows_tasks_with_and_without_intervals(paired_site: Any) -> None:
    text = (await paired_site.get("/compare?a=s0000000kq&b=s0000002kq")).text
    assert text.count("<tr") > 27
    assert text.count('<th scope="col" class="tx">Verdict</th>') == 2
    assert "+1 to +7" in text
    other = (await paired_site.get("/compare?a=s0000001kq&b=s0000002kq")).text
    tasks = other[other.index('id="tasks"') :]
    assert "Stalled vehicle" in tasks
    assert "Verdict" not in tasks


def test_a_family_that_none_of_them_tells_is_not_left_blank_in_the_drawing(
    lively_board: Board,
) -> None:
    untold = lively_board.families[0].id
    pair = [
        each.model_copy(
            update={"families": {k: cell for k, cell in each.families.items() if k != untold}}
        )
        for each in lively_board.entries[:2]
    ]
    plot = dot_plot(lively_board, pair, Digits())
    assert plot is not None
    drawn = str(macro("boards/families.html", "dots")(plot, "d"))
    assert drawn.count(">not told</text>") == 1


def test_nothing_is_drawn_where_no_family_is_told(lively_board: Board) -> None:
    cells = {
        head.id: lively_board.entries[0].families[head.id].model_copy(update={"hcc": None})
        for head in lively_board.families
    }
    pair = [each.model_copy(update={"families": cells}) for each in lively_board.entries[:2]]
    assert dot_plot(lively_board, pair, Digits()) is None
