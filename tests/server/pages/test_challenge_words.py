"""Pages say what the challenge registry says; none of them asks which challenge it is."""

import re
from pathlib import Path
from typing import Any

import pytest
from tests.server.pages.reading import read

import exceptiondrive_server
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import Coverage
from exceptiondrive_server.web.templating import marked, with_article

FOLDERS = [Path(exceptiondrive_server.__path__[0])]
IDS = "|".join(challenge_id for challenge_id in CHALLENGES)
NAMED = re.compile(rf"""["']({IDS})["']|\b({IDS.upper()})\b|challenge\.id\s*[=!]=|is_strategy""")


def branches(text: str) -> list[str]:
    """Places that name a challenge, or compare its id."""
    return [found.group() for found in NAMED.finditer(text)]


@pytest.mark.parametrize(
    "code",
    [
        '{% if view.challenge.id == "planning" %}',
        "if challenge.id == STRATEGY.id:",
        "WORDS = {'strategy': 1}",
        "{% if page.is_strategy %}",
    ],
)
def test_a_branch_would_be_found(code: str) -> None:
    assert branches(code)


def test_no_page_branches_on_a_challenge() -> None:
    files = [
        path
        for folder in FOLDERS
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".py", ".html", ".svg")
        and not {"launcher", "operations"} & set(path.relative_to(folder).parts)
    ]
    assert len(files) > 50
    found = {str(path): branches(path.read_text()) for path in files}
    assert {path: places for path, places in found.items() if places} == {}


@pytest.mark.parametrize("challenge", CHALLENGES.values(), ids=lambda one: one.id)
def test_every_template_of_words_can_be_filled(challenge: Challenge) -> None:
    words = challenge.words
    shares = [least for least, _ in words.headline.by_share]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == 0
    for _, text in words.headline.by_share:
        assert "{" not in text.format(
            the="The", even_the="Even the", often="in one of 3", rest="in 2 of 3"
        )
    assert words.scene_caption.format(clearance_m=1.0, d_safe_m=2.0, hcc=0.5).count("**") % 2 == 0
    assert set(words.covered) <= set(Coverage.model_fields)
    assert {part.metric for part in words.outcome} <= set(challenge.metric_keys)
    assert {words.chart.x, words.chart.y} <= set(challenge.metric_keys)


async def test_the_strategy_board_never_speaks_of_planners(shown_site: Any) -> None:
    text = (await shown_site.get("/?phase=strategy")).text
    body = text[text.index("<main") : text.index("</main>")].lower()
    assert "planner" not in body
    assert "trajector" not in re.sub(r"<figure.*?</figure>", "", body, flags=re.DOTALL)
    assert "agent.json.gz" in body


async def test_the_strategy_board_draws_answers_and_no_path_that_is_scored(shown_site: Any) -> None:
    drawn = {
        phase: read((await shown_site.get(f"/?phase={phase}")).text).one("figure", "scene")
        for phase in ("sample", "strategy")
    }
    assert drawn["sample"].all("g", "tube")
    assert not drawn["strategy"].all("g", "tube")
    task = next(each for each in packaged_protocol().tasks if each.id == "BG1")
    letters = {
        kind: {
            group.one("text", "ans-l").text
            for group in drawn["strategy"].all("g", kind)
            if group.all("text")
        }
        for kind in ("right", "careless")
    }
    assert letters == {"right": set(task.acceptable), "careless": set(task.under_warning)}
    assert task.title.lower() in drawn["strategy"].one("title").text


def test_bold_words_are_escaped_too() -> None:
    assert marked("a **<b>** c", "**", "b") == "a <b>&lt;b&gt;</b> c"


@pytest.mark.parametrize(("noun", "said"), [("planner", "a planner"), ("agent", "an agent")])
def test_nouns_take_their_article(noun: str, said: str) -> None:
    assert with_article(noun) == said
