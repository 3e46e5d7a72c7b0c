"""Pictures of cameras beside the drawings: what is shown, how it is served, and what never is."""

import re
from typing import Any

import pytest
from tests.server.pages.camera_pictures import keep_pictures, scene_ids
from tests.server.pages.invented_board import MANIFEST

from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.splits.pictures import show_pictures

LEADER = "s0000000kq"
PICTURE = re.compile(r'<img\s+src="(/splits/[^"]+\.jpg)"(.*?)>', re.DOTALL)


@pytest.fixture
def drawn_site(lively_site: Any) -> Any:
    lively_site.publish_split()
    lively_site.keep_drawings(LEADER, 1)
    return lively_site


@pytest.mark.parametrize(
    ("path", "n_scenes"),
    [
        ("/scenes?phase=sample", 6),
        (f"/entries/{LEADER}", 6),
        (f"/entries/{LEADER}/samples/scene-lane_blockage", 1),
    ],
)
async def test_both_pictures_stand_beside_the_drawing_with_the_words_of_the_licence(
    drawn_site: Any, path: str, n_scenes: int
) -> None:
    assert not PICTURE.findall((await drawn_site.get(path)).text)
    keep_pictures(drawn_site, scene_ids())
    html = (await drawn_site.get(path)).text
    found = PICTURE.findall(html)
    assert len(found) == 2 * n_scenes
    for place, (_, attributes) in enumerate(found):
        width, height, words = (
            (60, 30, "with the hazard: ") if place % 2 else (64, 40, "original scene")
        )
        assert f'width="{width}"' in attributes
        assert f'height="{height}"' in attributes
        assert 'loading="lazy"' in attributes
        assert words in attributes
    assert html.count("Pictures: CC &lt;b&gt;0&lt;/b&gt; &amp; kin") == n_scenes
    assert "style=" not in html


async def test_a_sample_without_pictures_stands_as_it_did(drawn_site: Any) -> None:
    keep_pictures(drawn_site, scene_ids()[:1])
    html = (await drawn_site.get("/scenes?phase=sample")).text
    assert len(PICTURE.findall(html)) == 2
    assert html.count('class="mo-shots"') == 1
    assert html.count('<figure class="mo card"') == 6


async def test_a_picture_is_served_as_what_it_is_and_asked_for_again(drawn_site: Any) -> None:
    jpeg = keep_pictures(drawn_site, scene_ids())
    address = PICTURE.findall((await drawn_site.get("/scenes?phase=sample")).text)[0][0]
    answer = await drawn_site.get(address)
    assert (answer.status_code, answer.content) == (200, jpeg)
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert (answer.headers["x-accel-expires"], answer.headers["cache-control"]) == ("5", "no-cache")
    again = await drawn_site.get(address, If_None_Match=answer.headers["etag"])
    assert (again.status_code, again.content) == (304, b"")


async def test_other_files_of_the_store_are_no_pictures(drawn_site: Any) -> None:
    """An attacker who knows the digest of an upload, or of a withheld split, gets nothing of it."""
    keep_pictures(drawn_site, scene_ids())
    files = drawn_site.app.state.services.files
    upload, _ = files.put_stream([b"an upload of a team"], limit_bytes=2**20)
    address = PICTURE.findall((await drawn_site.get("/scenes?phase=sample")).text)[0][0]
    hexadecimal = address.rpartition("/")[2].removesuffix(".jpg")
    tried = [
        f"/splits/sample/pictures/{upload.removeprefix('sha256:')}.jpg",
        f"/splits/sample/pictures/{'5' * 64}.jpg",
        f"/splits/other/pictures/{hexadecimal}.jpg",
        f"/splits/sample/pictures/{hexadecimal.upper()}.jpg",
        f"/splits/sample/pictures/sha256:{hexadecimal}.jpg",
        "/splits/sample/pictures/..%2F..%2Fetc.jpg",
    ]
    for each in tried:
        assert (await drawn_site.get(each)).status_code in {400, 404}, each


async def test_what_is_taken_away_is_gone_from_pages_and_addresses_at_once(drawn_site: Any) -> None:
    keep_pictures(drawn_site, scene_ids())
    address = PICTURE.findall((await drawn_site.get("/scenes?phase=sample")).text)[0][0]
    with drawn_site.database.write() as session:
        split = find_public_split(session, MANIFEST.ref)
        assert split is not None
        show_pictures(session, split, [], "", "test")
    assert not PICTURE.findall((await drawn_site.get("/scenes?phase=sample")).text)
    assert (await drawn_site.get(address)).status_code == 404
