"""The feed says what changed as a board took the place of another."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING
from xml.etree import ElementTree as Xml

import pytest
from tests.phases.life import SAMPLES
from tests.records.statements import of_board_texts, statements
from tests.server.pages.reading import read

from exceptiondrive_records.boards import boards
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life


def test_an_update_says_what_it_changed_and_keeps_its_reason(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    toml = packaged_protocol_toml("1.1")
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    life.apply(life.start_run(protocol="1.1"))
    first, *others = life.get("/feed.atom?phase=test").text.split("<entry>")[1:]
    assert "fewest scenes for an interval 2 -&gt; 5" in first
    assert "fewest scenes" not in "".join(others)
    sentences = first.split("<summary>")[1].split("</summary>")[0]
    assert "interval 2 -&gt; 5. " in sentences, "each change ends before the next one begins"
    assert ".." not in sentences
    assert "as announced" not in "".join([first, *others]), "reasons stay with the organizers"


def test_a_board_that_is_shown_again_is_told_again(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    with life.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    run = life.start_run(protocol="1.1")
    life.apply(run)

    def entries() -> list[tuple[str, ...]]:
        feed = Xml.fromstring(life.get("/feed.atom?phase=test").text)
        return [
            tuple(each.findtext(f"{{*}}{name}", "") for name in ("id", "updated", "title"))
            for each in feed.findall("{*}entry")
            if "Board" in each.findtext("{*}title", "")
        ]

    before = entries()
    life.done(f"/rescoring/{run}/rollback")
    (again, shown_at, title), *others = entries()
    assert others == before
    assert len({again, *(name for name, *_ in before)}) == 3
    assert life.json("/api/v1/boards?phase=test")[0]["shown_from"][:19] == shown_at[:19]
    assert title == "Board 1 of Test: shown again"
    assert entries()[0][0] == again, "its name stays"


def test_a_feed_reads_no_board_twice_however_many_others_were_read(life: "Life") -> None:
    life.make_phase(split="plain")
    for number in range(3):
        life.submit("alpha", 1.0 + number, f"Net {number}", "plain")
        life.work()
    services = life.client.app.state.services  # type: ignore[attr-defined]
    first = life.get("/feed.atom?phase=test").text
    boards._PARSED.make_room(2**40)
    with statements(services.database) as sent:
        assert life.get("/feed.atom?phase=test").text == first
    assert sent
    assert not of_board_texts(sent)


def test_what_was_applied_or_taken_back_behind_a_hidden_phase_is_told_once_it_is_shown(
    life: "Life",
) -> None:
    life.make_phase(split="plain")
    one = life.submit("alpha", dict.fromkeys(SAMPLES, 1.0) | {"a": 9.0}, "Net", "plain")
    life.work()
    toml = packaged_protocol_toml("1.0").replace('version = "1.0"', 'version = "9.0"', 1)
    with life.database.write() as session:
        add_protocol(
            session, toml.replace('headline = "macro_family"', 'headline = "micro"'), "test"
        )
    life.change({"visibility": "hidden"})
    run = life.start_run(protocol="9.0")
    life.apply(run)

    def told() -> list[str]:
        found = life.json("/api/v1/notifications", "alpha")
        assert {entry["submission_id"] for notice in found for entry in notice["entries"]} <= {one}
        return [notice["title"] for notice in found]

    assert told() == []
    life.change({"title": "Trial"})
    assert told() == [], "it is hidden still"
    life.change({"visibility": "shown"})
    assert told() == ["Trial now stands under protocol 9.0"]
    assert "Protocol 9.0." in life.get("/feed.atom?phase=test").text
    for visibility in ("hidden", "shown"):
        life.change({"visibility": visibility})
    assert len(told()) == 1, "once"
    life.change({"visibility": "hidden"})
    life.work()
    life.done(f"/rescoring/{run}/rollback")
    assert len(told()) == 1, "it is hidden"
    for visibility in ("shown", "hidden", "shown"):
        life.change({"visibility": visibility})
        assert told() == [
            "Trial stands again under protocol 1.0",
            "Trial now stands under protocol 9.0",
        ]
    back, there = (notice["entries"][0] for notice in life.json("/api/v1/notifications", "alpha"))
    assert (back["old"], back["new"]) == (there["new"], there["old"])
    life.change({"visibility": "hidden"})
    again = life.start_run(protocol="9.0")
    life.apply(again)
    life.work()
    life.done(f"/rescoring/{again}/rollback")
    life.change({"visibility": "shown"})
    assert len(told()) == 2, "nobody was told of what was taken back"


def test_what_is_told_as_a_phase_is_shown_is_true_by_then(life: "Life") -> None:
    """What was told and then taken back is told, too; of what stands no longer nobody is told numbers."""
    life.make_phase(split="plain")
    steady = life.submit("alpha", dict.fromkeys(SAMPLES, 1.0) | {"a": 9.0}, "Net", "plain")
    out = life.submit("beta", dict.fromkeys(SAMPLES, 2.0) | {"a": 9.0}, "Out", "plain")
    life.work()
    with life.database.write() as session:
        for version, change in (
            ("9.0", ('headline = "macro_family"', 'headline = "micro"')),
            ("9.1", ("d_safe_m = 2.0", "d_safe_m = 4.5")),
        ):
            toml = packaged_protocol_toml("1.0").replace(
                'version = "1.0"', f'version = "{version}"'
            )
            add_protocol(session, toml.replace(*change), "test")

    def told(who: str) -> list[tuple[str, list[str]]]:
        return [
            (notice["title"], [entry["submission_id"] for entry in notice["entries"]])
            for notice in life.json("/api/v1/notifications", who)
            if notice["entries"]
        ]

    first = life.start_run(protocol="9.0")
    life.apply(first)
    applied = "Test now stands under protocol 9.0"
    assert told("alpha") == [(applied, [steady])]
    life.change({"visibility": "hidden"})
    life.work()
    life.done(f"/rescoring/{first}/rollback")
    for version in ("9.0", "9.1"):
        run = life.start_run(protocol=version)
        life.apply(run)
        life.done(f"/rescoring/{run}/close")
    taken_back = life.start_run(protocol="9.0")
    life.apply(taken_back)
    life.work()
    life.done(f"/rescoring/{taken_back}/rollback")
    life.done(f"/submissions/{out}/disqualify", {"reason": "copied", "public_note": ""})
    life.work()
    for visibility in ("shown", "hidden", "shown"):
        life.change({"visibility": visibility})
    assert told("alpha") == [
        ("Test now stands under protocol 9.1", [steady]),
        (applied, [steady]),
        ("Test stands again under protocol 1.0", [steady]),
        (applied, [steady]),
    ]
    assert told("beta") == [(applied, [out])], "it stands no longer"


@pytest.mark.parametrize("note", ["Not by a planner.", ""])
def test_that_the_leader_was_taken_off_is_told_wherever_what_changed_is(
    life: "Life", note: str
) -> None:
    """Why, where there is a note for readers."""
    life.make_phase(split="plain")
    out = life.submit("beta", 1.0, "Cheater", "plain")
    life.work()
    life.done(f"/submissions/{out}/disqualify", {"reason": "copied", "public_note": note})
    life.work()
    assert "1 left (Cheater from rank 1)." in read(life.get("/?phase=test").text).text
    assert "<title>Board 2 of Test: 1 left (Cheater from rank 1)</title>" in (
        life.get("/feed.atom?phase=test").text
    )
    history = read(life.get("/history?phase=test").text)
    newest = history.one("ol", "hist").all("div", "new")[0]
    assert "left the board" in newest.text
    for told in (newest, history.one("ol", "led")):
        assert ("disqualified since" in told.text) is bool(note)
        assert note in told.text


def test_what_left_is_not_counted_where_the_news_name_only_some(
    life: "Life", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(boards, "MAX_NEWS", 2)
    life.make_phase(split="plain")
    gone = [life.submit("alpha", 1.0 + step, f"Net {step}", "plain") for step in (0, 1)]
    life.work()
    for submission in gone:
        life.done(f"/submissions/{submission}/disqualify", {"reason": "copied"})
    life.submit("beta", 0.5, "New", "plain")
    life.work()
    assert "<title>Board 2 of Test: 1 newly ranked (New to rank 1)</title>" in (
        life.get("/feed.atom?phase=test").text
    )


def test_the_history_says_of_the_disqualified_run_alone_that_it_is(life: "Life") -> None:
    """Its team may have led, left and led again with other runs of the same method."""
    life.make_phase(split="plain")
    first = life.submit("beta", 1.0, "M", "plain")
    life.work()
    life.request("POST", f"/api/v1/submissions/{first}/withdraw", "beta")
    life.work()
    out = life.submit("beta", 1.5, "M", "plain")
    life.work()
    note = {"reason": "copied", "public_note": "Not by a planner."}
    life.done(f"/submissions/{out}/disqualify", note)
    life.work()
    history = read(life.get("/history?phase=test").text)
    told = history.one("ol", "hist").all("div", "new") + history.one("ol", "led").all("li")
    says = ["disqualified since" in each.text for each in told]
    assert says == [True, False, False, False, True, False]


def test_a_phase_is_announced_when_it_is_shown_not_when_it_was_made(life: "Life") -> None:
    made = life.make_phase(split="plain", opens_at="2126-01-01T09:30:00Z", visibility="hidden")
    life.move(created_at=datetime(2026, 1, 1, tzinfo=UTC))
    life.change({"title": "Final"})
    life.change({"visibility": "shown"})
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    life.change({"title": made["title"]})
    (entry,) = life.get("/feed.atom?phase=test").text.split("<entry>")[1:]
    assert "Test opens 1 Jan 2126, 09:30 UTC" in entry
    assert f"<updated>{line['at'][:19]}" in entry
