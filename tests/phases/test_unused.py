"""What nothing was made of: drafts of protocols that no reader sees, and what may be deleted."""

from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import send, visitor

from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life

DRAFT = (
    packaged_protocol_toml()
    .replace('version = "1.0"', 'version = "7.7"')
    .replace("bootstrap_draws = 1000", "bootstrap_draws = 900")
)
WHY = {"reason": "a slip of the pen"}


def add(life: "Life", toml: str = DRAFT) -> Any:
    headers = {"Authorization": f"Bearer {life.tokens['organizer']}"}
    headers["Content-Type"] = "application/toml"
    answer = life.client.post("/api/v1/organizer/protocols", content=toml, headers=headers)
    assert answer.status_code == 201, answer.text
    return answer.json()


def last_line(life: "Life") -> tuple[str, str, Any]:
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    return line["action"], line["subject"], line["detail"].get("reason")


def test_a_draft_is_for_organizers_until_a_phase_stands_under_it(life: "Life") -> None:
    life.make_phase(split="plain")
    digest = add(life)["digest"]
    doors = (
        "/protocols/", "/api/v1/protocols/", "/api/v1/tasks?protocol=",
        "/?phase=test&protocol=", "/api/v1/leaderboard?phase=test&protocol=",
    )  # fmt: skip
    for door in doors:
        for name in ("7.7", digest):
            said = life.get(f"{door}{name}", "alpha" if "api" in door else None)
            unknown = life.get(f"{door}9.9")
            assert (said.status_code, unknown.status_code) == (404, 404), door
            assert said.json()["detail"].replace(name, "9.9") == unknown.json()["detail"]
    for door in ("/protocols/1.0", "/sitemap.xml", "/api/v1/protocols", "/submit"):
        assert "7.7" not in life.get(door).text
    assert life.client.get("/protocols", follow_redirects=False).headers["location"] == (
        "/protocols/1.0"
    )
    known = life.json("/api/v1/organizer/protocols", "organizer")
    assert [(one["version"], one["is_draft"]) for one in known] == [("1.0", False), ("7.7", True)]
    assert life.get("/api/v1/organizer/protocols/7.7/toml", "organizer").text == DRAFT
    assert life.get("/api/v1/organizer/protocols", "alpha").status_code == 403
    assert life.get("/api/v1/organizer/protocols/7.7/toml", "alpha").status_code == 403
    organizer = visitor(life, "organizer")
    assert organizer.get("/protocols/7.7").status_code == 200
    assert organizer.get("/organize/protocols/7.7/toml").text == DRAFT
    life.make_phase("second", split="plain", protocol="7.7")
    assert {life.get(f"{door}7.7").status_code for door in doors[:3]} == {200}


def test_what_comes_with_the_software_is_no_draft(life: "Life") -> None:
    life.make_phase(split="plain")
    add(life, packaged_protocol_toml("1.1"))
    assert life.get("/protocols/1.1").status_code == 200
    known = life.json("/api/v1/organizer/protocols", "organizer")
    assert [(one["version"], one["is_draft"]) for one in known] == [("1.0", False), ("1.1", False)]


def test_the_protocol_of_the_front_page_is_the_protocol(life: "Life") -> None:
    life.make_phase(split="plain")
    add(life)
    life.make_phase("second", split="plain", protocol="7.7")
    assert life.client.get("/protocols", follow_redirects=False).headers["location"].endswith("1.0")
    life.done("/phases/second/feature", {"reason": "the season"})
    assert life.client.get("/protocols", follow_redirects=False).headers["location"].endswith("7.7")


def test_a_protocol_of_hidden_phases_alone_is_hidden(life: "Life") -> None:
    life.make_phase(split="plain")
    add(life)
    life.make_phase("second", split="plain", protocol="7.7", visibility="hidden")
    assert life.get("/api/v1/protocols/7.7").status_code == 404


@pytest.mark.parametrize("by", ["page", "api"])
def test_an_unused_protocol_is_deleted_and_its_version_is_free(life: "Life", by: str) -> None:
    life.make_phase(split="plain")
    add(life)
    if by == "page":
        organizer, page = visitor(life, "organizer"), "/organize/protocols/7.7/delete"
        assert "/organize/protocols/7.7/delete" in organizer.get("/organize/protocols").text
        assert send(organizer, page, WHY, page=page).headers["location"].endswith("deleted")
    else:
        assert life.done("/protocols/7.7/delete", WHY)["version"] == "7.7"
    assert last_line(life) == ("protocol deleted", "7.7", WHY["reason"])
    assert [one["version"] for one in life.json("/api/v1/organizer/protocols", "organizer")] == [
        "1.0"
    ]
    add(life, DRAFT.replace("bootstrap_draws = 900", "bootstrap_draws = 800"))


def test_a_protocol_in_use_stays(life: "Life") -> None:
    assert "comes with this software" in life.refused("/protocols/1.0/delete", WHY, 409)
    life.make_phase(split="plain")
    assert "phase test" in life.refused("/protocols/1.0/delete", WHY, 409)
    add(life)
    drafted = life.done("/rescoring", {"phase": "test", "protocol": "7.7", "reason": "why"})
    assert drafted["id"] in life.refused("/protocols/7.7/delete", WHY, 409)
    assert life.request(
        "POST", "/api/v1/organizer/protocols/7.7/delete", "alpha", json=WHY
    ).status_code == 403  # fmt: skip
    life.refused("/protocols/9.9/delete", WHY, 404)
    organizer = visitor(life, "organizer")
    life.done(f"/rescoring/{drafted['id']}/cancel", WHY)
    assert "even a cancelled one" in life.refused("/protocols/7.7/delete", WHY, 409)
    add(life, DRAFT.replace('"7.7"', '"7.8"'))
    life.make_phase("gone", split="plain", protocol="7.8")
    life.work()
    life.done("/phases/gone/delete", WHY)
    assert "an opening of split plain" in life.refused("/protocols/7.8/delete", WHY, 409)
    protocols = organizer.get("/organize/protocols").text
    for version in ("7.7", "7.8"):
        address = f"/organize/protocols/{version}/delete"
        assert address not in protocols, "what is refused is not offered"
    assert 'href="/organize/protocols/new?start=1.0"' in protocols, "not from a draft"
    starts = organizer.get("/organize/protocols/new").text
    assert starts.index("?start=1.0") < starts.index("?start=7.7")


@pytest.mark.parametrize("by", ["page", "api"])
def test_an_unused_phase_is_deleted_with_its_boards(life: "Life", by: str) -> None:
    life.make_phase(split="plain")
    life.make_phase("typo", split="plain")
    life.work()
    assert life.json("/api/v1/boards/typo/1")["board"] == 1
    if by == "page":
        organizer, page = visitor(life, "organizer"), "/organize/phases/typo/delete"
        assert page in organizer.get("/organize/phases/typo").text
        done = send(organizer, page, WHY, page=page)
        assert done.headers["location"] == "/organize/phases?done=phase_deleted"
    else:
        assert life.done("/phases/typo/delete", WHY)["id"] == "typo"
    assert last_line(life) == ("phase deleted", "typo", WHY["reason"])
    assert [one["id"] for one in life.json("/api/v1/phases", "organizer")] == ["test"]
    assert life.get("/api/v1/boards/typo/1").status_code == 404
    assert life.get("/?phase=typo").status_code == 404
    life.make_phase("typo", split="plain")
    life.work()
    assert life.json("/api/v1/boards/typo/1")["board"] == 1


def test_a_phase_that_was_used_stays(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 5.0, "Planner", "plain")
    assert "Archive or hide it" in life.refused("/phases/test/delete", WHY, 409)
    assert life.get("/?phase=test").status_code == 200
    organizer, page = visitor(life, "organizer"), "/organize/phases/test/delete"
    assert "or hide it: <code>visibility</code>." in send(organizer, page, WHY, page=page).text
    assert life.request(
        "POST", "/api/v1/organizer/phases/test/delete", "alpha", json=WHY
    ).status_code == 403  # fmt: skip
