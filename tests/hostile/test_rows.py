"""Rows of the table of bad inputs (I01 to I33): one line each says what is done about it.

Content is judged by the worker, which rejects the file with a stable code; the API reads no file.
"""

import gzip
import io
import json
import pickle
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from tests.hostile.site import Site, open_site

from exceptiondrive_schemas.protocol import packaged_protocol

WAY = [[1.0 * step, 0.0] for step in range(1, 7)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite: Path) -> Iterator[Site]:
    with open_site(tmp_path_factory.mktemp("hostile"), migrated_sqlite) as site:
        yield site


def document(**first: Any) -> dict[str, Any]:
    """A sound document; keywords replace keys of its first answer."""
    answers = [{"sample_id": f"s{i}", "source": WAY, "edited": WAY} for i in range(2)]
    answers[0] = {**answers[0], **first}
    return {"schema": "exceptiondrive.planning/1", "split": "tiny", "predictions": answers}


def sound(**first: Any) -> bytes:
    return json.dumps(document(**first)).encode()


def with_number(text: str) -> bytes:
    return sound(edited=[["@", 0.0], *WAY[1:]]).replace(b'"@"', text.encode())


def with_way(way: Any) -> bytes:
    return sound(edited=way)


def with_id(raw: bytes) -> bytes:
    return sound(sample_id="@").replace(b"@", raw)


def answers_of(*ids: str) -> bytes:
    answers = [{"sample_id": key, "source": WAY, "edited": WAY} for key in ids]
    return json.dumps({**document(), "predictions": answers}).encode()


class PickleLoadedError(Exception):
    """Somebody loaded a pickle that was uploaded."""


class _Trap:
    """What loads its pickle raises, in whatever process it does."""

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, (f"raise __import__({__name__!r}, fromlist=['*']).PickleLoadedError",)


def zipped() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("planner.json", sound())
    return buffer.getvalue()


def npz() -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, a=np.zeros(3))
    return buffer.getvalue()


def npy() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


CONTENT: list[tuple[str, bytes, str]] = [
    *(
        ("I01", with_number(text), "non_finite")
        for text in ("NaN", "Infinity", "-Infinity", "1e309")
    ),
    *(("I02", with_number(text), "out_of_bounds") for text in ("1e308", "1e154", "251")),
    ("I03", with_number("1" + "0" * 400), "non_finite"),
    ("I03", with_number("9" * 5000), "non_finite"),
    ("I04", with_way(WAY[:5]), "wrong_waypoint_count"),
    ("I04", with_way([*WAY, [7.0, 0.0]]), "wrong_waypoint_count"),
    ("I04", with_way([]), "wrong_waypoint_count"),
    ("I04", with_way([[1.0], *WAY[1:]]), "wrong_waypoint_shape"),
    ("I04", with_way([[1.0, 0.0, 0.0]] * 6), "wrong_waypoint_shape"),
    *(("I05", with_number(text), "wrong_type") for text in ('"1"', "true", "null", "{}")),
    ("I06", answers_of("s0", "s1", "s1"), "duplicate_sample"),
    ("I06", sound().replace(b'"split"', b'"split": "tiny", "split"'), "duplicate_key"),
    ("I07", answers_of("s0"), "missing_sample"),
    ("I07", answers_of("s0", "s1", "s2"), "unknown_sample"),
    ("I09", b"[" * 200_000, "wrong_type"),
    ("I09", with_number("[" * 50_000 + "]" * 50_000), "nested_too_deeply"),
    ("I09", b"{" + b",".join(b'"%d":0' % i for i in range(10**5)) + b"}", "unknown_key"),
    ("I09", answers_of(*["s0"] * 6_000), "duplicate_sample"),
    ("I10", with_id(rb"\ud800"), "unknown_sample"),
    ("I10", with_id(rb"\u0000"), "unknown_sample"),
    ("I10", with_id(b"\xff"), "not_utf8"),
    ("I10", sound().decode().encode("utf-16"), "wrong_file_kind"),
    ("I10", b"\xef\xbb\xbf" + sound(), "byte_order_mark"),
    ("I14", gzip.compress(b" " * (80 * 2**20)), "inflates_too_large"),
    ("I14", gzip.compress(gzip.compress(sound())), "wrong_file_kind"),
    ("I14", zipped(), "wrong_file_kind"),
    ("I14", b"\x28\xb5\x2f\xfd" + bytes(50), "wrong_file_kind"),
    ("I15", b"PAR1" + bytes(50) + b"PAR1", "wrong_file_kind"),
    ("I15", pickle.dumps(_Trap()), "wrong_file_kind"),
    ("I15", gzip.compress(pickle.dumps(_Trap())), "wrong_file_kind"),
    ("I15", npy(), "wrong_file_kind"),
    ("I15", npz(), "wrong_file_kind"),
    ("I15", b"sample_id,x,y\ns0,1,2\n", "not_json"),
    ("I17", with_way([[150.0, 0.0], *WAY[1:]]), "step_too_long"),
    ("I29", answers_of(*(f"ECHO-{i}" for i in range(2500))), "unknown_sample"),
]


@pytest.mark.row(
    "I01", "I02", "I03", "I04", "I05", "I06", "I07", "I09", "I10", "I14", "I15", "I17", "I29"
)
@pytest.mark.parametrize(
    ("data", "code"),
    [
        pytest.param(data, code, id=f"{row}-{n}-{code}")
        for n, (row, data, code) in enumerate(CONTENT)
    ],
)
def test_a_hostile_file_is_rejected_with_its_code(site: Site, data: bytes, code: str) -> None:
    shown = site.score(data)
    assert shown["status"] == "rejected"
    assert shown["failure"] is None
    assert code in [group["code"] for group in shown["report"]["faults"]]
    assert shown["sheet"] is None


@pytest.mark.row("I15")
def test_the_pickle_that_is_uploaded_would_be_noticed_by_whoever_loads_it() -> None:
    with pytest.raises(PickleLoadedError):
        pickle.loads(pickle.dumps(_Trap()))


@pytest.mark.row("I29")
def test_the_answer_to_a_file_of_invalid_samples_is_small(site: Site) -> None:
    shown = site.score(answers_of(*(f"ECHO-{i}" for i in range(2500))))
    unknown = [each for each in shown["report"]["faults"] if each["code"] == "unknown_sample"]
    assert [each["count"] for each in unknown] == [2500]
    assert len(json.dumps(shown)) < 16_000


@pytest.mark.row("I08")
def test_i08_a_missing_source_is_scored_and_its_coverage_shown(site: Site) -> None:
    shown = site.score(sound(source=None), method="No source")
    assert shown["status"] == "scored"
    assert shown["sheet"]["coverage"]["source"] == 0.5


@pytest.mark.row("I17")
@pytest.mark.parametrize(
    ("way", "flag"),
    [
        pytest.param([[0.0, 0.0]] * 6, "edited_stationary", id="I17-all-zeros"),
        pytest.param([[30.0, 0.0], [0.5, 0.0]] * 3, "impossible", id="I17-reverse-time"),
        pytest.param([[9.0, 0.0]] * 6, "first_step", id="I17-all-equal"),
    ],
)
def test_i17_what_no_car_does_is_flagged_and_shown_on_the_board(
    site: Site, way: list[list[float]], flag: str
) -> None:
    answers = [{"sample_id": f"s{i}", "source": WAY, "edited": way} for i in range(2)]
    data = json.dumps({**document(), "predictions": answers}).encode()
    shown = site.score(data, method=f"Odd {flag}")
    plausibility = shown["sheet"]["plausibility"]
    assert plausibility["shares"][flag] == 1.0
    codes = [found["code"] for found in plausibility["flags"]]
    assert codes
    site.publish()
    board = site.client.get("/api/v1/leaderboard?phase=dev").json()
    (entry,) = [row for row in board["entries"] if row["submission_id"] == shown["id"]]
    assert [found["code"] for found in entry["flags"]] == codes
    assert set(codes) & set(packaged_protocol("1.1").ranking.unranked_flags), "1.1 gives it a rank"
    page = site.client.get("/?phase=dev").text
    assert all(found["label"] in page for found in plausibility["flags"])


@pytest.mark.row("I11", "I28")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param("turned\u202eround", id="I11-right-to-left"),
        pytest.param("zero\u200bwidth", id="I11-zero-width"),
        pytest.param("x" * 10_000, id="I11-10-kB"),
        pytest.param("a\r\nSet-Cookie: x=1", id="I28-header-injection"),
    ],
)
def test_a_name_that_cannot_be_shown_is_refused_and_not_repeated(site: Site, name: str) -> None:
    before = site.n_submissions
    response = site.post(sound(), method=name)
    assert response.status_code == 400
    assert name not in response.text
    assert "set-cookie" not in response.headers
    assert site.n_submissions == before


NAMES = {
    "html": "<script>alert(1)</script>",
    "attribute": "\" onmouseover='x' y=\"",
    "formula": "=cmd|'/C calc'!A1",
    "plus": "+1+1",
    "at": "@SUM(1)",
    "minus": "-2+3",
    "latex": r"\input{/etc/passwd} & % $ #",
    "template": "{{ 7*7 }}{% raw %}",
    "emoji": "Planner \U0001f697",
    "homoglyph": "Рlanner",
}


@pytest.fixture(scope="module")
def named(site: Site) -> Site:
    """A board with every hostile name."""
    for number, name in enumerate(NAMES.values()):
        way = [[1.0 * step, 0.1 * number] for step in range(1, 7)]
        assert site.score(with_way(way), method=name)["status"] == "scored"
    site.publish()
    return site


@pytest.mark.row("I12", "I11")
@pytest.mark.parametrize("path", ["/?phase=dev", "/feed.atom?phase=dev"])
def test_i12_names_are_inert_on_the_page_and_in_the_feed(named: Site, path: str) -> None:
    response = named.client.get(path)
    assert response.status_code == 200
    assert "<script>alert" not in response.text
    if path.startswith("/?"):
        assert "\" onmouseover='x'" not in response.text
        assert "&lt;script&gt;alert(1)" in response.text
        assert "{{ 7*7 }}" in response.text
    else:  # a quote may stand in the text of XML, where it opens no attribute
        written = Xml.fromstring(response.text).iter()
        assert {name for element in written for name in element.attrib} == {"href", "rel"}
    assert "default-src" in response.headers["content-security-policy"]


@pytest.mark.row("I12")
@pytest.mark.parametrize(
    "path", ["/api/v1/leaderboard.csv?phase=dev", "/export/board.csv?phase=dev"]
)
def test_i12_names_are_no_formulas_in_a_spreadsheet(named: Site, path: str) -> None:
    import csv

    rows = list(csv.reader(io.StringIO(named.client.get(path).text)))
    cells = [cell for row in rows for cell in row]
    for name in ("formula", "plus", "at", "minus"):
        assert NAMES[name] not in cells
        assert f"'{NAMES[name]}" in cells


@pytest.mark.row("I12")
def test_i12_names_are_no_commands_in_latex(named: Site) -> None:
    text = named.client.get("/export/board.tex?phase=dev").text
    assert r"\input{" not in text
    assert r"\textbackslash{}input" in text
    assert r"\& \% \$ \#" in text


@pytest.mark.row("I12")
def test_i12_names_are_themselves_in_json(named: Site) -> None:
    response = named.client.get("/api/v1/leaderboard?phase=dev")
    assert set(NAMES.values()) <= {row["method"] for row in response.json()["entries"]}
    assert response.headers["content-type"] == "application/json"
    assert response.headers["x-content-type-options"] == "nosniff"


@pytest.mark.row("I12")
@pytest.mark.parametrize(
    "link", ["javascript:alert(1)", "data:text/html,x", "http://10.0.0.1/", "file:///etc/passwd"]
)
def test_i12_a_link_that_is_not_https_is_refused(site: Site, link: str) -> None:
    data = sound() + b" " * len(link)  # bytes of its own: the same again are the first submission
    assert site.post(data, code_url=link).status_code == 400


@pytest.mark.row("I14")
@pytest.mark.parametrize("encoding", ["gzip", "deflate", "zstd", "br"])
def test_i14_an_encoded_body_is_refused(site: Site, encoding: str) -> None:
    response = site.client.post(
        "/api/v1/submissions",
        headers={"Authorization": f"Bearer {site.token}", "Content-Encoding": encoding},
        files={"file": ("p.json", b"{}")},
    )
    assert response.status_code == 415


@pytest.mark.row("I28")
@pytest.mark.parametrize(
    "name", ["../../../etc/passwd", "/etc/passwd", "a\\..\\b", "x" * 4000, "%2e%2e%2fx", "nul\x00"]
)
def test_i28_the_name_of_a_file_is_never_used(site: Site, name: str) -> None:
    response = site.client.post(
        "/api/v1/submissions",
        headers={"Authorization": f"Bearer {site.token}"},
        data={"phase": "dev", "method": "Path"},
        files={"file": (name, b"{}")},
    )
    assert response.status_code in (200, 202, 400)
    assert "passwd" not in response.text
    store = Path(site.context.settings.file_store_url.removeprefix("file://"))
    names = [path.name for path in store.rglob("*") if path.is_file()]
    assert names
    assert all("passwd" not in known and len(known) <= 80 for known in names)


def test_the_marker_of_contents_names_the_rows_of_its_table() -> None:
    (marked,) = [
        mark.args
        for mark in test_a_hostile_file_is_rejected_with_its_code.pytestmark  # type: ignore[attr-defined]
        if mark.name == "row"
    ]
    assert set(marked) == {row for row, _, _ in CONTENT}
