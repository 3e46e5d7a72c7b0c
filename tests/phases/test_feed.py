"""The feed says what changed as a board took the place of another."""

from typing import TYPE_CHECKING

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
    assert "fewest scenes that an interval takes 2 -&gt; 5" in first
    assert "fewest scenes" not in "".join(others)
    assert "as announced" not in "".join([first, *others]), "reasons stay with the organizers"
