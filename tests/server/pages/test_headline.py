"""The sentences on top come from the numbers."""

from itertools import count
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.pages.invented_board import PROTOCOL, STILL
from tests.server.pages.reading import read

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_schemas.board import Board, BoardEntry, PairedComparison
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, RankKey
from exceptiondrive_schemas.score_sheet import PairedDifference
from exceptiondrive_server.boards.headline import headline
from exceptiondrive_server.boards.pictures import TITLE_SIZE, TITLE_WIDTH, in_two_lines
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.table import board_table


def with_ur(board: Board, ur: float) -> Board:
    """The leader, with this unsafe rate over its samples, and another by the average that ranks; and one more."""
    entry, other = board.entries[:2]
    assert entry.metrics == entry.macro_family
    micro = {**entry.micro, "ur": ur}
    return board.model_copy(update={"entries": (entry.model_copy(update={"micro": micro}), other)})


def flagged(board: Board, *places: int) -> Board:
    """The same board, with a parked car in these places."""
    changes = {"flags": (STILL,), "method": "AlwaysBrake"}
    entries = [
        entry.model_copy(update=changes) if at in places else entry
        for at, entry in enumerate(board.entries)
    ]
    return board.model_copy(update={"entries": tuple(entries)})


@pytest.mark.parametrize(
    ("ur", "title"),
    [
        (1.0, "Even the leading planner hits the hazard every time."),
        (0.996, "Even the leading planner hits the hazard in over 99 of 100 samples."),
        (0.78, "Even the leading planner hits the hazard in about 7 of 9 samples."),
        (0.8701, "Even the leading planner hits the hazard in about 7 of 8 samples."),
        (0.5, "The leading planner hits the hazard in one of 2 samples."),
        (0.311, "The leading planner hits the hazard in about 3 of 10 samples."),
        (0.988, "Even the leading planner hits the hazard in about 99 of 100 samples."),
        (0.012, "The leading planner stays out of the hazard in about 99 of 100 samples."),
        (0.02, "The leading planner stays out of the hazard in 98 of 100 samples."),
        (
            0.0033,
            "The leading planner stays out of the hazard in over 99 of 100 samples.",
        ),
        (0.0, "The leading planner stays out of the hazard every time."),
    ],
)
def test_the_title_counts_what_the_leader_hits(lively_board: Board, ur: float, title: str) -> None:
    assert headline(with_ur(lively_board, ur), PLANNING, PROTOCOL).title == title
    in_picture = in_two_lines(title, TITLE_SIZE, TITLE_WIDTH)
    assert " ".join(in_picture) == title, "it is not cut there"


@pytest.mark.parametrize(
    ("ur", "said"),
    [
        (0.586, ", as the mean of families; over all samples, UR is 58.60\u202f%."),
        (None, ", as the mean of families."),
    ],
)
def test_what_the_title_counts_is_told_beside_another_average(
    lively_board: Board, ur: float | None, said: str
) -> None:
    ur = lively_board.entries[0].metrics["ur"] if ur is None else ur
    assert ur is not None
    (found,) = headline(with_ur(lively_board, ur), PLANNING, PROTOCOL).findings
    assert found.endswith(said)


@given(ur=st.floats(1e-9, 1 - 1e-9))
def test_a_share_that_is_not_quite_none_or_all_is_never_said_to_be_it(
    lively_board: Board, ur: float
) -> None:
    title = headline(with_ur(lively_board, ur), PLANNING, PROTOCOL).title
    assert "every time" not in title
    assert "not once" not in title


def test_the_facts_count_what_stands_on_the_board(lively_board: Board) -> None:
    said = headline(lively_board, PLANNING, PROTOCOL)
    facts = {fact.label: f"{fact.value} {fact.note}" for fact in said.facts}
    assert facts == {
        "Samples scored": "240 samples, without and with a hazard",
        "Tasks": "21 kinds of hazard",
        "Planners": "6 planners ranked, 1 without a rank",
    }


def test_one_planner_is_one(lively_board: Board) -> None:
    (first,) = (entry for entry in lively_board.entries if entry.rank == 1)
    board = lively_board.model_copy(update={"entries": (first,)})
    said = headline(board, PLANNING, PROTOCOL)
    assert said.facts[2].note == "planner ranked"
    assert said.title.startswith("The only ranked planner hits the hazard")
    table = board_table(board, PROTOCOL, BoardQuery())
    (row,) = table.rows
    assert not any(cell.is_best for cell in row.cells)
    assert not any(tile.is_best for tile in row.tiles)


@pytest.mark.parametrize("flags", [(), ("stands_still",)])
def test_what_takes_no_rank_is_counted_whyever(lively_board: Board, flags: tuple[str, ...]) -> None:
    *_, last = (entry for entry in lively_board.entries if entry.rank is not None)
    unranked = last.model_copy(update={"rank": None, "unranked_flags": flags})
    entries = [unranked if entry is last else entry for entry in lively_board.entries]
    board = lively_board.model_copy(update={"entries": tuple(entries)})
    assert headline(board, PLANNING, PROTOCOL).facts[2].note == "planners ranked, 2 without a rank"


def test_a_parked_car_is_passed_over_and_named(lively_board: Board) -> None:
    said = headline(flagged(lively_board, 0), PLANNING, PROTOCOL)
    assert said.findings[0].startswith("Of 6 ranked planners, LaneKeeper XL")
    assert said.findings[1] == (
        "AlwaysBrake (\u201cStands still\u201d) ranks above it and, flagged as that, does not lead."
    )
    assert all(fact.note != "AlwaysBrake" for fact in said.facts)


def test_where_every_ranked_one_is_flagged_nobody_leads(lively_board: Board) -> None:
    said = headline(flagged(lively_board, *range(6)), PLANNING, PROTOCOL)
    assert said.title == PLANNING.words.headline.question
    assert said.findings == ("Nobody leads: every ranked planner is flagged (Stands still).",)
    assert len(said.facts) == 3


@pytest.mark.parametrize(
    ("n_level", "words"), [(1, "m1"), (2, "m1 and m2"), (3, "m1, m2 and m3"), (4, "4 others")]
)
def test_who_shares_the_rank_of_the_leader_is_said_to_be_level_with_it(
    lively_board: Board, n_level: int, words: str
) -> None:
    entries = tuple(
        lively_board.entries[0].model_copy(
            update={
                "method": f"m{at}",
                "rank": 1 if at <= n_level else at + 1,
                "rank_interval": (1, 6),
            }
        )
        for at in range(n_level + 2)
    )
    said = headline(lively_board.model_copy(update={"entries": entries}), PLANNING, PROTOCOL)
    assert f"m0 leads, level with {words}, though 1 other could be first: " in said.findings[0]


def test_behind_a_parked_car_others_could_lead_that_cannot_be_first(lively_board: Board) -> None:
    board = flagged(lively_board, 0)
    spans = [(1, 1), (2, 4), (2, 4), (3, 5)]
    entries = tuple(
        entry.model_copy(
            update={"rank": at, "rank_interval": span, "flags": entry.flags if at == 1 else ()}
        )
        for at, (entry, span) in enumerate(zip(board.entries, spans, strict=False), start=1)
    )
    said = headline(board.model_copy(update={"entries": entries}), PLANNING, PROTOCOL)
    assert f"{entries[1].method} leads, though 1 other could lead: " in said.findings[0]


def test_many_that_could_be_first_are_counted_without_comparing_each_with_each(
    lively_board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    entries = tuple(
        lively_board.entries[0].model_copy(update={"rank": at, "rank_interval": (1, 90)})
        for at in range(1, 91)
    )
    n_compared = count()
    monkeypatch.setattr(BoardEntry, "__eq__", lambda *_: next(n_compared) < 0)
    said = headline(lively_board.model_copy(update={"entries": entries}), PLANNING, PROTOCOL)
    assert "though 89 others could be first" in said.findings[0]
    assert next(n_compared) == 0


def compared(a: BoardEntry, b: BoardEntry, low: float) -> PairedComparison:
    difference = PairedDifference(
        difference=0.03, interval=(low, 0.06), discordant=None, verdict=""
    )
    return PairedComparison(
        a=a.submission_id or "",
        b=b.submission_id or "",
        overall={"hcc": difference},
        families={},
    )


def test_whom_a_comparison_puts_behind_the_leader_could_not_be_first(lively_board: Board) -> None:
    """Of a withheld split ranges follow from intervals as they are told, and are wider."""
    leader, *others = (
        entry.model_copy(update={"rank": rank, "rank_interval": (1, 3)})
        for rank, entry in enumerate(lively_board.entries[:3], 1)
    )
    board = lively_board.model_copy(update={"entries": (leader, *others)})
    said = headline(board, PLANNING, PROTOCOL)
    assert "leads, though 2 others could be first: " in said.findings[0]
    pairs = [compared(leader, other, low) for other, low in zip(others, (0.0, 0.01), strict=True)]
    told = board.model_copy(update={"comparisons": tuple(pairs)})
    said = headline(told, PLANNING, PROTOCOL)
    assert "leads, though 1 other could be first: " in said.findings[0]
    table = board_table(told, PROTOCOL, BoardQuery())
    marked = "Marked at the left: the 2 that could be first, as they compare sample by sample."
    assert table.first_sentence == marked
    assert [*table.first_of_all.values()] == [leader, others[0]]
    fewer_is_better = RankKey(metric="hcc", order="ascending")
    assert told.contenders(fewer_is_better) == (leader, *others)


def test_who_was_not_compared_with_the_leader_could_be_first_down_to_one_that_is_behind(
    lively_board: Board,
) -> None:
    """The best alone are compared and, of a withheld split, no two of one team."""
    leader, mate, rival, lower = (
        entry.model_copy(update={"rank": rank, "rank_interval": (1, 5), "team": team})
        for entry, rank, team in zip(lively_board.entries, (1, 2, 3, 4), "bbcd", strict=False)
    )
    entries = (leader, mate, rival, lower)
    behind = (compared(leader, rival, 0.01),)
    board = lively_board.model_copy(update={"entries": entries, "comparisons": behind})
    table = board_table(board, PROTOCOL, BoardQuery())
    assert [*table.first_of_all.values()] == [leader, mate]
    assert table.first_sentence == (
        "Marked at the left: the 2 that could be first, as they compare sample by sample "
        "(1 is not compared with the leader); left out too: 1 lower one, not compared."
    )
    assert "though 1 other could be first" in headline(board, PLANNING, PROTOCOL).findings[0]
    every_pair = tuple(compared(leader, each, 0.01) for each in entries[1:])
    public = board_table(
        board.model_copy(update={"comparisons": every_pair}), PROTOCOL, BoardQuery()
    )
    assert public.first_sentence == (
        f"Marked at the left: {leader.method}, which alone could be first, as they compare sample by sample."
    )
    open_pair = board.model_copy(update={"comparisons": (compared(leader, rival, 0.0),)})
    assert board_table(open_pair, PROTOCOL, BoardQuery()).first_sentence == (
        "Marked at the left: the 4 that could be first."
    )


@pytest.mark.parametrize(
    ("n_behind", "said"),
    [
        (
            1,
            "2 entries could be first, as they compare sample by sample (1 is not compared with the leader). What is told does not",
        ),
        (2, "1 entry could be first, as they compare sample by sample."),
    ],
)
async def test_the_report_says_of_the_first_what_the_board_says(
    site: Any, lively_board: Board, n_behind: int, said: str
) -> None:
    leader, *others = (
        entry.model_copy(update={"rank": rank, "rank_interval": (1, 3)})
        for rank, entry in enumerate(lively_board.entries[:3], 1)
    )
    pairs = tuple(compared(leader, other, 0.01) for other in others[-n_behind:])
    site.create_phase("sample")
    site.publish(
        lively_board.model_copy(update={"entries": (leader, *others), "comparisons": pairs})
    )
    with site.database.write() as session:
        find_phase(session, "sample").closes_at = database_now(session)
    page = read((await site.get("/phases/sample/report")).text).text
    assert said in page
    assert ("set them apart" in page) is (n_behind == 1)


def test_a_flag_that_does_not_bar_is_named(lively_board: Board) -> None:
    alone = lively_board.model_copy(update={"entries": lively_board.entries[5:6]})
    said = headline(alone, PLANNING, PROTOCOL)
    assert said.findings[0].startswith("The only ranked planner so far is nerve: it earns 22.18")
    assert said.findings[0].endswith("; flagged \u201cBlind to the edit\u201d.")


def test_the_paper_never_makes_the_headline(paper_board: Board) -> None:
    said = headline(paper_board, PLANNING, PROTOCOL)
    assert said.title == "Which planner keeps clear of the hazard?"
    assert said.findings == ("No planner is ranked on this board.",)


def test_without_a_board_nothing_is_claimed() -> None:
    said = headline(None, PLANNING, PROTOCOL)
    assert said.facts == ()
    assert "%" not in " ".join(said.findings)


def test_the_strategy_challenge_is_said_in_its_own_words(strategy_board: Board) -> None:
    said = headline(strategy_board, STRATEGY, PROTOCOL)
    assert said.title == "Even the leading agent is too careless in about 2 of 7 samples."
    assert "planner" not in " ".join(said.findings)
    assert [fact.label for fact in said.facts] == [
        "Samples scored",
        "Tasks",
        "Agents",
    ]
    assert said.facts[0].note == "samples, with a hazard"
    assert headline(None, STRATEGY, PROTOCOL).title == "Which agent is careful enough?"
