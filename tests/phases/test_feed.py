"""The feed says why a board took the place of another."""

from typing import TYPE_CHECKING

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life


def test_an_update_says_what_it_changed_and_the_reason(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    life.apply(life.start_run(protocol="1.1"))
    first, *others = life.get("/feed.atom?phase=test").text.split("<entry>")[1:]
    assert "Reason: as announced" in first
    assert "Reason:" not in "".join(others)
