"""Pictures for other sites: real PNGs of the board's numbers, cached, and named by absolute addresses."""

import re
import struct
from typing import Any

import pytest

from exceptiondrive_server.boards.pictures import (
    FONTS,
    fitted,
    in_two_lines,
    is_latin,
    paint_png,
    width_of,
)

BOARD = "/pictures/board.png?phase=sample&board=1"
ENTRY = "/pictures/entries/s0000000kq.png?phase=sample&board=1"


def size_of(png: bytes) -> tuple[int, int]:
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", png[16:24])
    return width, height


@pytest.mark.parametrize(
    "path",
    [
        BOARD,
        ENTRY,
        "/pictures/board.png",
        "/pictures/board.png?phase=unpublished",
        "/pictures/board.png?phase=empty",
        "/pictures/board.png?phase=strategy",
        "/pictures/entries/reference-freeze.png?phase=sample",
        "/pictures/entries/a0000000kq.png?phase=strategy",
    ],
)
async def test_every_board_and_entry_has_a_picture(shown_site: Any, path: str) -> None:
    answer = await shown_site.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    assert size_of(answer.content) == (1200, 630)
    again = await shown_site.get(path, if_none_match=answer.headers["etag"])
    assert (again.status_code, again.content) == (304, b"")


async def test_pictures_differ_by_what_they_show(shown_site: Any) -> None:
    paths = (BOARD, ENTRY, "/pictures/board.png?phase=strategy", "/pictures/board.png?phase=paper")
    tags = {(await shown_site.get(path)).headers["etag"] for path in paths}
    assert len(tags) == len(paths)


async def test_what_is_not_there_has_no_picture(shown_site: Any) -> None:
    for path in ("/pictures/board.png?phase=nowhere", "/pictures/entries/nobody.png"):
        assert (await shown_site.get(path)).status_code == 404


def test_words_are_painted_by_our_own_fonts() -> None:
    def picture(family: str, weight: int, words: str) -> bytes:
        text = f'<text y="40" font-family="{family}" font-weight="{weight}">{words}</text>'
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" width="200" height="60">{text}</svg>'
        return paint_png(svg)

    assert len(FONTS) == 3
    blank = picture("Inter", 400, "")
    drawn = {picture(*face, "Møller 61.40") for face in (("Inter", 400), ("Inter", 600))}
    drawn.add(picture("Newsreader", 500, "Møller 61.40"))
    assert len(drawn) == 3
    assert blank not in drawn


def meta(text: str, name: str) -> str:
    found = re.search(rf'<meta (?:property|name)="{re.escape(name)}" content="([^"]*)"', text)
    assert found is not None, name
    return found.group(1).replace("&amp;", "&")


@pytest.mark.parametrize(
    ("page", "picture"),
    [
        ("/?phase=sample", BOARD),
        ("/entries/s0000000kq", ENTRY),
        ("/compare?phase=sample", BOARD),
        ("/submit", "/pictures/board.png"),
    ],
)
async def test_pages_name_their_picture_and_themselves_absolutely(
    lively_site: Any, page: str, picture: str
) -> None:
    lively_site.app.state.services.settings = lively_site.app.state.services.settings.model_copy(
        update={"public_url": "https://board.example/"}
    )
    text = (await lively_site.get(page)).text
    assert meta(text, "og:image") == f"https://board.example{picture}"
    assert meta(text, "og:url").startswith("https://board.example/")
    assert meta(text, "twitter:card") == "summary_large_image"
    assert meta(text, "og:image:alt") == meta(text, "og:description"), "what it shows, in words"
    assert (await lively_site.get(picture)).status_code == 200


@pytest.mark.parametrize(
    "path",
    ["/feed.atom?phase=sample", "/export/board.tex?phase=sample", "/export/board.bib", "/api"],
)
async def test_what_people_take_away_names_the_public_address(lively_site: Any, path: str) -> None:
    assert "http://site.test" in (await lively_site.get(path)).text
    services = lively_site.app.state.services
    services.settings = services.settings.model_copy(
        update={"public_url": "https://board.example/"}
    )
    text = (await lively_site.get(path)).text
    assert "site.test" not in text
    assert "https://board.example/" in text
    assert "example//" not in text


def test_long_names_are_cut_and_titles_broken_between_words() -> None:
    name = fitted("An exceedingly long name of a planner " * 3, 26, 480)
    assert name.endswith("…")
    assert width_of(name, 26) <= 480
    lines = in_two_lines("The safest planner still meets 3 hazards in 10.", 58, 960)
    assert lines == ("The safest planner still", "meets 3 hazards in 10.")
    assert in_two_lines("W" * 90, 64, 960)[0].endswith("…")
    assert fitted("a\x00b\x1b c", 20, 500) == "a b c"


def test_other_scripts_ask_the_machine_for_fonts() -> None:
    assert is_latin("Møller–Ruiz, 61.40\u202f% …")
    assert not is_latin("規劃器")
