"""A hidden phase as an attacker finds it: every public door answers as for a phase that is not there."""

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import select
from tests.phases.browsing import visitor
from tests.support.made_pictures import png

from exceptiondrive_records.splits.splits import find_split, publish_split
from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_server.routes import ROUTES
from exceptiondrive_worker.splits.admin import current_split
from exceptiondrive_worker.splits.pictures import publish_pictures
from exceptiondrive_worker.splits.store import SplitStore

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.phases.life import Life

SECRETS = ("veiled-phase", "Veiled title", "Veiled words", "veiled-split")
FOR_WHO_OWNS = (
    *("/organize", "/api/v1/organizer", "/my", "/submissions", "/api/v1/submissions"),
    "/metrics",
)
"""Addresses that answer to organizers, to the team alone that sent a submission, or inside alone."""
QUERIES = (
    "phase={phase}",
    "phase={phase}&board=1",
    "phase={phase}&protocol=1.0",
    "phase={phase}&as_of=2126-01-01",
    "phase={phase}&a={key}&b={key}",
    "like={phase}",
)


def public_paths() -> Iterator[str]:
    for included in ROUTES.routes:
        for route in included.effective_route_contexts():  # type: ignore[attr-defined]
            if "GET" in route.methods and not route.path.startswith(FOR_WHO_OWNS):
                yield route.path


def addresses(names: dict[str, str]) -> Iterator[str]:
    """Every public address, with every query, about the things named."""
    values = {
        "phase": names["phase"],
        "phase_id": names["phase"],
        "name": names["split"],
        "submission_id": names["key"],
        "key": names["key"],
        "run_id": names["run"],
        "number": "1",
        "place": "1",
        "version": "1.0",
        "form": "csv",
        "file": "planner.json",
        "digest": names["digest"],
    }
    for template in public_paths():
        path = re.sub(r"{(\w+)[^}]*}", lambda found: values.get(found[1], "planning"), template)
        yield path
        for query in QUERIES:
            yield f"{path}?{query.format(**names)}"


def heard(client: Any, address: str, names: dict[str, str]) -> tuple[int, str]:
    """What is answered, without the names that the question held itself."""
    answer = client.get(address, headers={"Accept": "text/html, application/json"})
    text = re.sub(r"[0-9a-f]{32}", "REQUEST", answer.text)
    for name in names.values():
        text = text.replace(name, "NAME")
    return answer.status_code, text


@pytest.fixture
def veiled(life: "Life", make_split: "Callable[..., Any]") -> dict[str, str]:
    """A phase with a split of its own, a scored entry, boards and an applied update; then hidden."""
    samples = {"v1": ("SE1", 10.0, None), "v2": ("LB1", 12.0, None)}
    life.add_split(make_split(samples, "veiled-split"))
    life.make_phase(split="plain")
    words = {"title": "Veiled title", "description": "Veiled words"}
    life.make_phase("veiled-phase", split="veiled-split", **words)
    speeds = {"v1": 1.0, "v2": 2.0}
    key = life.submit("alpha", speeds, "Planner", "veiled-split", "veiled-phase")
    life.work()
    assert life.json(f"/api/v1/entries/{key}")["phase"] == "veiled-phase"
    digest = show_a_picture(life)
    assert life.get(f"/splits/veiled-split/pictures/{digest}.jpg").status_code == 200
    life.change({"visibility": "hidden"}, "veiled-phase")
    return {"phase": "veiled-phase", "split": "veiled-split", "key": key, "run": "nosuchrun"} | {
        "digest": digest
    }


def show_a_picture(life: "Life") -> str:
    """Make the split public, with a picture of one sample; return the digest of what is served."""
    files, splits = life.context.files, SplitStore(life.worker.splits_dir)
    with life.database.write() as session:  # without its file, which holds marked coordinates
        revision = find_split(session, "veiled-split").revision
        publish_split(session, "veiled-split", revision, "sha256:" + "5" * 64, "test")
    folder = life.worker.splits_dir / "veiled-split" / "pictures"
    folder.mkdir()
    (folder / "v1.edited.png").write_bytes(png(64, 40))
    publish_pictures(life.database, files, *current_split(splits, "veiled-split"), "CC0")
    with life.database.read() as session:
        row = session.scalars(select(SamplePictureRow)).one()
    return row.file_digest.removeprefix("sha256:")


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_no_public_address_tells_a_hidden_phase_from_none(
    life: "Life", veiled: dict[str, str]
) -> None:
    absent = {"phase": "absent-phase", "split": "absent-split", "key": "0" * 16, "run": "nosuchrun"}
    absent["digest"] = "0" * 64
    asked = dict(zip(addresses(veiled), addresses(absent), strict=True))
    assert len(asked) > 200
    for client in (life.client, visitor(life, "beta")):
        for hidden, none in asked.items():
            found, expected = heard(client, hidden, veiled), heard(client, none, absent)
            assert found == expected, hidden
            assert not [word for word in SECRETS if word in found[1]], hidden


def test_a_hidden_phase_takes_no_files_and_says_so_as_if_it_were_not_there(
    life: "Life", veiled: dict[str, str]
) -> None:
    refused = life.upload("beta", {"v1": 3.0, "v2": 3.0}, "P", "veiled-split", "veiled-phase")
    absent = life.upload("beta", {"v1": 3.0, "v2": 3.0}, "P", "veiled-split", "absent-phase")
    assert refused.status_code == absent.status_code == 404
    assert refused.json()["detail"].replace("veiled", "absent") == absent.json()["detail"]


def test_organizers_see_a_hidden_phase_and_its_team_keeps_its_submission(
    life: "Life", veiled: dict[str, str]
) -> None:
    assert "veiled-phase" in {one["id"] for one in life.json("/api/v1/phases", "organizer")}
    assert life.json("/api/v1/phases/veiled-phase", "organizer")["visibility"] == "hidden"
    organizer = visitor(life, "organizer")
    for address in ("/phases/veiled-phase", "/?phase=veiled-phase", "/organize/phases"):
        answer = organizer.get(address)
        assert answer.status_code == 200
        assert "Veiled title" in answer.text, address
    assert "Hidden: organizers alone see it" in organizer.get("/phases/veiled-phase").text
    told = organizer.get("/organize/phases/veiled-phase").text
    assert re.findall(r'class="badge st [^>]*>(\w+)<', told) == ["hidden"], "it has not closed"
    own = visitor(life, "alpha")
    assert own.get("/my").status_code == 200
    assert own.get(f"/submissions/{veiled['key']}").status_code == 200


def test_shown_again_it_is_what_it_was(life: "Life", veiled: dict[str, str]) -> None:
    life.change({"visibility": "shown"}, "veiled-phase")
    assert life.json(f"/api/v1/entries/{veiled['key']}")["phase"] == "veiled-phase"
    assert "Veiled title" in life.get("/?phase=veiled-phase").text


def test_an_archived_phase_is_read_and_takes_nothing(life: "Life") -> None:
    life.make_phase(split="plain")
    life.make_phase("old", split="plain", title="Old one")
    life.change({"visibility": "archived"}, "old")
    assert life.json("/api/v1/phases/old")["is_open"] is False
    assert life.upload("alpha", 1.0, "P", "plain", "old").status_code == 403
    page = life.get("/").text
    assert page.index("More: 1 past") < page.index("Old one")
    assert "archived" in page
    assert life.get("/phases/old").status_code == 200
