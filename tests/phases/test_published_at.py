"""A board is published when readers first see it, wherever a date is told."""

from datetime import datetime
from typing import TYPE_CHECKING

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life


def test_a_draft_board_is_published_when_it_is_applied_and_its_bytes_stay(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 5.0, "Planner", "plain")
    life.work()
    first = life.get("/api/v1/boards/test/1").content
    with life.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    run = life.start_run(protocol="1.1")
    built = life.now()
    assert life.get("/api/v1/boards/test/2").status_code == 404
    life.apply(run)
    shown = life.json("/api/v1/boards/test/2")["published_at"]
    assert datetime.fromisoformat(shown) > built
    assert life.board()["published_at"] == shown
    flips = life.json("/api/v1/boards?phase=test")
    assert shown in str(flips)
    assert shown[:19] in life.get("/api/v1/leaderboard.csv?phase=test").text
    assert f"<updated>{shown[:19]}" in life.get("/feed.atom?phase=test").text
    bytes_of_it = life.get("/api/v1/boards/test/2").content
    life.done(f"/rescoring/{run}/rollback")
    life.work()
    assert life.get("/api/v1/leaderboard?phase=test").content == first
    assert life.get("/api/v1/boards/test/2").content == bytes_of_it
    assert life.get("/api/v1/boards/test/1").content == first
