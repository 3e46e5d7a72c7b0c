"""Words with a pop-over: each that a template asks for is explained, and each explained is asked for."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.server.pages.reading import read

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_scoring.interval import draws_cut_off, wilson_at_the_ends
from exceptiondrive_server.web.glossary import TERMS
from exceptiondrive_server.web.templating import FOLDER

TEMPLATES = sorted(Path(FOLDER).parent.glob("*/templates/**/*.html"))
ASKED = re.compile(r"""\b(?:term|what)\(\s*"([a-z0-9_]+)\"""")
METRICS = {key for challenge in CHALLENGES.values() for key in challenge.metric_keys}
METRICS |= {metric.key for each in CHALLENGES.values() for metric in each.of_controls}


def test_every_term_of_a_template_is_explained_and_none_is_left_over() -> None:
    asked = {key for path in TEMPLATES for key in ASKED.findall(path.read_text())}
    assert asked - TERMS.keys() == set()
    assert TERMS.keys() - METRICS - asked == set()


def test_every_metric_has_its_words() -> None:
    assert METRICS <= TERMS.keys()
    assert all(term.title and term.meaning.endswith(".") for term in TERMS.values())


def test_no_term_counts_what_a_protocol_names() -> None:
    counted = re.compile(r"(\d|two|three|four|five|six|seven|eight|nine|ten) (kinds|famil|tasks)")
    assert not [term.title for term in TERMS.values() if counted.search(term.meaning)]


def test_a_missing_answer_is_told_of_both_challenges() -> None:
    meaning = TERMS["coverage"].meaning
    assert "driving into it" in meaning
    assert "a missing strategy as wrong and too careless" in meaning


def test_at_least_as_many_draws_as_the_words_say_lie_within_a_bar() -> None:
    """More where scenes are few; `draws_cut_off` leaves out so many at each end."""
    assert (
        "in at least 95 of 100 such draws it stays within the bar of a 95 % interval"
        in TERMS["interval"].meaning
    )
    outside = [2 * draws_cut_off(1000, 0.95, n) for n in (2, 5, 6, 20, 60, 150, 1e6)]
    assert outside == sorted(outside)
    assert max(outside) <= 50


def test_a_range_of_ranks_that_is_wider_than_a_comparison_is_explained() -> None:
    meaning = TERMS["rank"].meaning
    assert "For a withheld split it follows from the rounded intervals" in meaning
    assert "Each pair is judged by itself" in meaning
    assert "planner" not in meaning, "it stands on boards of every challenge"


def test_a_bar_that_no_draw_makes_is_explained() -> None:
    assert "no draw moves from 0 or 100 % has Wilson's interval" in TERMS["interval"].meaning
    low, high = wilson_at_the_ends(np.array([1.0, 1.0]), np.array(120.0), 0.95)
    assert (round(float(low), 3), high) == (0.969, 1)


@pytest.mark.parametrize("path", ["/", "/?phase=strategy", "/entries/s0000000kq"])
async def test_a_page_holds_each_meaning_once_that_it_asks_for(shown_site: Any, path: str) -> None:
    page = read((await shown_site.get(path)).text)
    asked = {button["popovertarget"] for button in page.all("button") if button["popovertarget"]}
    ids = [node["id"] for node in page.all() if node["id"]]
    assert asked
    assert all(ids.count(target) == 1 for target in asked)
