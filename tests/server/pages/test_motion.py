"""Scenes in motion: whose they are, what they say, and that the scorer says the same."""

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from tests.server.pages.invented_board import MANIFEST, PROTOCOL
from tests.server.pages.page_site import real_drawings
from tests.server.pages.reading import read

from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.drawing import EntryDrawings, SampleDrawing
from exceptiondrive_scoring.clearance import clearance_m
from exceptiondrive_scoring.region import prepare_regions
from exceptiondrive_server.entries.motion import motion

LEADER, SECOND = "s0000000kq", "s0000003kq"
SCENES = "/scenes?phase=sample"
MOVING = ("edited", "footprints", "tube", "clearances_m")
HIT_FROM_M = PROTOCOL.geometry.contact_tolerance_m


def scorer_says(sample: SampleDrawing) -> list[float]:
    """The clearance of what was driven until each time step after t = 0, by the scoring code."""
    path, region = np.array([sample.edited]), prepare_regions(np.array([sample.region]))
    return [
        float(clearance_m(path[:, : step + 1], region, PROTOCOL.geometry)[0])
        for step in range(1, len(sample.edited))
    ]


def scenes_of(drawings: EntryDrawings) -> list[SampleDrawing]:
    return [each.drawing for each in drawings.samples if each.chosen_as == "scene"]


def readings(html: str) -> list[tuple[str, list[float], list[str]]]:
    """Name, clearances and levels of every entry in every scene, as the page carries them."""
    found = re.findall(
        r'<li data-clear="([\d. ]*)" data-levels="([a-z ]*)">.*?mo-name">([^<]+)<', html, re.DOTALL
    )
    return [(name, [*map(float, clear.split())], level.split()) for clear, level, name in found]


@pytest.fixture
def drawn_site(lively_site: Any) -> Any:
    lively_site.publish_split()
    lively_site.keep_drawings(LEADER, 1)
    lively_site.keep_drawings(SECOND, 0)
    return lively_site


async def test_the_page_says_at_every_time_step_what_the_scorer_measures(drawn_site: Any) -> None:
    html = (await drawn_site.get(f"{SCENES}&with={SECOND}")).text
    told = readings(html)
    by_planner = [scenes_of(real_drawings(1)), scenes_of(real_drawings(0))]
    assert len(told) == 12  # six families, two planners
    n_below = {"clear": 0, "close": 0, "hit": 0}
    for place, (_, clear, levels) in enumerate(told):
        sample = by_planner[place % 2][place // 2]
        measured = scorer_says(sample)
        assert clear[1:] == [pytest.approx(value, abs=0.005) for value in measured]
        for level, value in zip(levels[1:], measured, strict=True):
            expected = (
                "hit" if value <= HIT_FROM_M else "close" if value < sample.d_safe_m else "clear"
            )
            assert level == expected
            n_below[level] += 1
    assert min(n_below.values()) > 0  # each is seen


def test_a_line_changes_where_the_clearance_passes_what_is_required_and_ends_red_at_zero() -> None:
    for planner in (0, 1, 2, 3):
        for sample in scenes_of(real_drawings(planner)):
            run = motion([("one", sample)], PROTOCOL).runs[0]
            x, y = run.axes
            required_y = y.at(sample.d_safe_m)
            for stretch in run.stretches:
                points = [
                    [float(at) for at in point.split(",")] for point in stretch.points.split()
                ]
                heights = [height for _, height in points]
                for at, height in points:
                    value = np.interp(at, [x.at(step) for step in range(7)], sample.clearances_m)
                    assert height == pytest.approx(y.clamped(float(value)), abs=0.3)
                if stretch.level == "clear":
                    assert max(heights) <= required_y + 0.06
                else:
                    assert min(heights) >= required_y - 0.06
                if stretch.level == "hit":
                    assert set(heights) == {y.at(0)}
            assert [mark.level for mark in run.marks] == run.levels.split()
            assert [float(mark.x) for mark in run.marks] == pytest.approx(
                [x.at(step) for step in range(7)], abs=0.06
            )
            levels = [stretch.level for stretch in run.stretches]
            assert all(one != other for one, other in pairwise(levels))
            has_hit = any(stretch.level == "hit" for stretch in run.stretches)
            assert has_hit == (sample.metrics["ur"] == 1)


async def test_the_leader_stands_first_and_up_to_two_more_are_laid_over(drawn_site: Any) -> None:
    alone = (await drawn_site.get(SCENES)).text
    assert {name for name, _, _ in readings(alone)} == {"Kestrel-2"}
    assert len(re.findall(r'<figure class="mo card"', alone)) == 6
    both = (await drawn_site.get(f"{SCENES}&with={SECOND}&with={LEADER}")).text
    assert [name for name, _, _ in readings(both)][:2] == ["Kestrel-2", "Møller–Ruiz world model"]
    assert len(readings(both)) == 12
    assert f'<option value="{SECOND}" selected>' in both
    assert f'<option value="{LEADER}"' not in both  # it is there already
    unknown = await drawn_site.get(f"{SCENES}&with=s0000005kq")  # on the board, not drawn
    assert unknown.status_code == 404


async def test_where_the_leader_is_not_drawn_the_best_that_is_stands_alone(
    lively_site: Any,
) -> None:
    lively_site.publish_split()
    lively_site.keep_drawings(SECOND, 0)
    told = readings((await lively_site.get(SCENES)).text)
    assert {name for name, _, _ in told} == {"Møller–Ruiz world model"}


def test_who_answered_nothing_is_told_so_beside_the_clearances_of_the_others() -> None:
    sample = scenes_of(real_drawings(1))[0]
    silent = sample.model_copy(update=dict.fromkeys(MOVING, ()))
    words = motion([("one", sample), ("none", silent)], PROTOCOL).line_words
    assert words.endswith("; none no answer.")


async def test_what_was_withdrawn_drives_no_more_on_an_old_board(
    drawn_site: Any, empty_board: Board
) -> None:
    with drawn_site.database.write() as session:
        session.get_one(Submission, SECOND).status = SubmissionStatus.WITHDRAWN
    drawn_site.publish(empty_board)
    old = f"{SCENES}&board=1"
    assert SECOND not in (await drawn_site.get(old)).text
    assert (await drawn_site.get(f"{old}&with={SECOND}")).status_code == 404


async def test_a_phase_with_withheld_regions_borrows_scenes_and_says_whose(
    drawn_site: Any, lively_board: Board
) -> None:
    names = [f"Hidden {number}" for number in range(len(lively_board.entries))]
    entries = tuple(
        entry.model_copy(update={"method": name, "submission_id": f"h000000{at}kq"})
        for at, (entry, name) in enumerate(zip(lively_board.entries, names, strict=True))
    )
    withheld = MANIFEST.model_copy(update={"name": "test", "revision": "sha256:" + "7" * 64})
    drawn_site.create_phase("final", manifest=withheld)
    update = {"phase": "final", "entries": entries, "split": withheld.ref}
    drawn_site.publish(lively_board.model_copy(update=update))
    html = (await drawn_site.get("/scenes?phase=final")).text
    words = read(html).text
    assert "The hazard regions of Final are withheld, so nothing of it is drawn." in words
    assert "driven by the planners of that phase" in words
    assert {name for name, _, _ in readings(html)} == {"Kestrel-2"}
    assert "Kestrel-2 of Sample" in words
    assert "leads" not in read(html).one("form", "mo-form").text
    assert not any(name in html for name in names)
    front = (await drawn_site.get("/?phase=final")).text
    assert 'data-scenes="/scenes?phase=final"' in front
    assert "scenes and planners are those of a development phase" in read(front).text
    entry = (await drawn_site.get("/entries/h0000000kq?phase=final")).text
    assert 'src="/scenes.svg?phase=final"' in entry
    assert "none is of Final, and the planner in them is not this entry" in read(entry).text
    assert read(entry).one("section", "blk", **{"aria-labelledby": "hd"}).all("g")
    assert 'data-scenes="/scenes?phase=final"' in entry
    for path in ("/?phase=sample", "/entries/s0000000kq"):
        own = (await drawn_site.get(path)).text
        assert "those of a development phase" not in own
        assert "nothing is drawn" not in own


async def test_before_anything_is_drawn_the_page_says_so(lively_site: Any) -> None:
    lively_site.publish_split()
    assert "Nothing is drawn yet" in (await lively_site.get(SCENES)).text
    picture = await lively_site.get("/scenes.svg?phase=sample")
    assert (picture.status_code, "Nothing is drawn yet" in picture.text) == (200, True)


async def test_without_any_public_split_the_board_offers_no_scenes(lively_site: Any) -> None:
    assert 'id="scenes"' not in (await lively_site.get("/")).text
    words = read((await lively_site.get(SCENES)).text).text
    assert "This phase has no drawings" in words
    assert "#scenes" not in (await lively_site.get(SCENES)).text, "the board has no such place"
    assert "within seconds" not in words
    assert "One scene of each hazard family" not in words
    assert "/scenes" not in (await lively_site.get("/splits/sample")).text


async def test_the_page_of_a_public_split_leads_to_its_scenes(drawn_site: Any) -> None:
    assert 'href="/scenes?phase=sample"' in (await drawn_site.get("/splits/sample")).text
    assert 'href="/?phase=sample#scenes"' in (await drawn_site.get(SCENES)).text


async def test_the_picture_for_those_without_script_is_a_picture_of_the_same(
    drawn_site: Any,
) -> None:
    answer = await drawn_site.get("/scenes.svg?phase=sample")
    assert answer.headers["content-type"].startswith("image/svg+xml")
    assert answer.text.count('class="draw mo-top"') == 6
    assert "Kestrel-2" in answer.text
    again = await drawn_site.get("/scenes.svg?phase=sample", If_None_Match=answer.headers["etag"])
    assert again.status_code == 304


async def test_entries_and_samples_have_the_same_player(drawn_site: Any) -> None:
    entry = (await drawn_site.get(f"/entries/{LEADER}")).text
    assert len(readings(entry)) == 6
    assert "player.js" in entry
    for place in ("scene-lane_blockage", "worst-lane_blockage"):
        sample = (await drawn_site.get(f"/entries/{LEADER}/samples/{place}")).text
        (told,) = readings(sample)
        (drawn,) = (
            each.drawing
            for each in real_drawings(1).samples
            if f"{each.chosen_as}-{each.drawing.family}" == place
        )
        assert told[1][1:] == [pytest.approx(value, abs=0.005) for value in scorer_says(drawn)]
    plain = (await drawn_site.get("/entries/s0000005kq")).text
    assert "player.js" not in plain
