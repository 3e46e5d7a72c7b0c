"""A split that asks for a second organizer: no score and no board until two keys have signed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, select
from tests.support.worker import build_board_of
from tests.worker.test_split_floors import code_of, held, open_phase, write_floors

from exceptiondrive.confirmations import confirm, make_key
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.splits.confirmations import (
    add_confirmation,
    list_confirmations,
    withdraw_confirmation,
)
from exceptiondrive_records.splits.tables import ConfirmationRow
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.split import Split, SplitRef
from exceptiondrive_worker.failures import FailureCode
from exceptiondrive_worker.splits.admin import SplitsRefusedError

World = Any
PROTOCOL = packaged_protocol("1.1")


@pytest.fixture
def keys(tmp_path: Path) -> dict[str, Path]:
    """Private keys: of three organizers, and of somebody whom the floors do not name."""
    return {name: tmp_path / f"{name}.pem" for name in ("anna", "ben", "cy", "mallory")}


@pytest.fixture
def asking(world: World, tiny: Split, keys: dict[str, Path]) -> World:
    """A withheld split with a phase, whose floors ask for a second organizer."""
    public = {name: make_key(path) for name, path in keys.items()}
    named = "\n".join(f'{name} = "{public[name]}"' for name in ("anna", "ben", "cy"))
    write_floors(world, f"second_organizer = true\n[organizers]\n{named}\n", tiny.name)
    open_phase(world, packaged_protocol_toml("1.1"), tiny)
    return world


def of(split: Split) -> SplitRef:
    return SplitRef(name=split.name, revision=split.revision)


def kept(world: World, given: Confirmation) -> None:
    with world.database.write() as session:
        add_confirmation(session, given, "test")


def score(world: World, data: bytes) -> str | None:
    return code_of(world, world.score(data, phase_id="made"))


def test_nothing_is_scored_until_two_organizers_have_signed(
    asking: World, tiny: Split, keys: dict[str, Path], planning_file: Callable[..., bytes]
) -> None:
    files = [planning_file(tiny, edited_mps=1.0 + number / 10) for number in range(5)]
    said = []
    for who in ("nobody", "anna", "mallory"):
        if who in keys:
            kept(asking, confirm(of(tiny), PROTOCOL.digest, keys[who]))
        assert score(asking, files.pop()) == FailureCode.SPLIT_FLOOR
        said.append(held(asking)[-1][1]["asked"])
    assert said == [
        ["it is confirmed by nobody, and 2 of 3 organizers must"],
        ["it is confirmed by anna alone, and 2 of 3 organizers must"],
        ["it is confirmed by anna alone, and 2 of 3 organizers must"],
    ]
    kept(asking, confirm(of(tiny), PROTOCOL.digest, keys["cy"]))
    assert score(asking, files.pop()) is None
    with asking.database.write() as session:
        withdraw_confirmation(session, list_confirmations(session)[-1].id, "left", "test")
    assert score(asking, files.pop()) == FailureCode.SPLIT_FLOOR


def test_a_withdrawn_signature_is_not_kept_again(
    asking: World, tiny: Split, keys: dict[str, Path], planning_file: Callable[..., bytes]
) -> None:
    given = {who: confirm(of(tiny), PROTOCOL.digest, keys[who]) for who in ("anna", "ben", "cy")}
    kept(asking, given["anna"])
    kept(asking, given["ben"])
    with asking.database.write() as session:
        withdraw_confirmation(session, given["ben"].id, "left", "test")
    with pytest.raises(Conflict, match="withdrawn"):
        kept(asking, given["ben"])
    assert score(asking, planning_file(tiny)) == FailureCode.SPLIT_FLOOR
    assert "by anna alone" in held(asking)[-1][1]["asked"][0]
    kept(asking, given["cy"])
    assert score(asking, planning_file(tiny, edited_mps=1.5)) is None


def test_a_signature_counts_for_its_protocol_and_revision_alone(
    asking: World, tiny: Split, keys: dict[str, Path], planning_file: Callable[..., bytes]
) -> None:
    other = packaged_protocol("1.0")
    for who in ("anna", "ben"):
        with asking.database.write() as session:
            for digest, revision in (
                (other.digest, tiny.revision),
                (PROTOCOL.digest, "sha256:another"),
            ):
                ref = SplitRef(name=tiny.name, revision=revision)
                _plant(session, confirm(ref, digest, keys[who]), tiny)
    assert score(asking, planning_file(tiny)) == FailureCode.SPLIT_FLOOR


def test_rows_that_a_taken_over_server_writes_confirm_nothing(
    asking: World, tiny: Split, keys: dict[str, Path], planning_file: Callable[..., bytes]
) -> None:
    """One key twice, a key of nobody, another's key over an own signature, one altered."""
    anna, mallory = (confirm(of(tiny), PROTOCOL.digest, keys[who]) for who in ("anna", "mallory"))
    claimed = mallory.model_copy(update={"public_key": make_key(keys["ben"])})
    altered = anna.model_copy(update={"signature": "A" * 86 + "=="})
    with asking.database.write() as session:
        for given in (anna, anna, mallory, claimed, altered):
            _plant(session, given, tiny)
    assert score(asking, planning_file(tiny)) == FailureCode.SPLIT_FLOOR
    assert "by anna alone" in held(asking)[-1][1]["asked"][0]


def _plant(session: Any, given: Confirmation, split: Split) -> None:
    """Write a row as whoever holds the database role of the server can: no check is made."""
    session.add(
        ConfirmationRow(
            id=f"planted-{len(list_confirmations(session))}",
            split_name=split.name,
            split_revision=split.revision,
            protocol_digest=PROTOCOL.digest,
            confirmation=given,
            confirmed_at=database_now(session),
        )
    )
    session.flush()


def test_no_board_is_built_of_what_is_no_longer_confirmed(
    asking: World, tiny: Split, keys: dict[str, Path], planning_file: Callable[..., bytes]
) -> None:
    for who in ("anna", "ben"):
        kept(asking, confirm(of(tiny), PROTOCOL.digest, keys[who]))
    assert score(asking, planning_file(tiny)) is None
    with asking.database.write() as session:
        for row in list_confirmations(session):
            withdraw_confirmation(session, row.id, "a mistake", "test")
    build_board_of(asking.context, "made", asking.protocol_digest("made"))
    with asking.database.read() as session:
        assert session.scalar(select(func.count()).select_from(BoardRow)) == 0


def test_a_split_that_asks_for_no_second_organizer_is_scored_without(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    open_phase(world, packaged_protocol_toml("1.1"), tiny)
    assert score(world, planning_file(tiny)) is None


@pytest.mark.parametrize("names", [(), ("anna",), ("anna", "anna2")])
def test_floors_that_ask_for_two_name_two_keys(
    world: World, tiny: Split, keys: dict[str, Path], names: tuple[str, ...]
) -> None:
    key = make_key(keys["anna"])
    lines = "\n".join(f'{name} = "{key}"' for name in names)
    write_floors(world, f"second_organizer = true\n[organizers]\n{lines}\n", tiny.name)
    with pytest.raises(SplitsRefusedError, match="organizers"):
        world.add_split(tiny)
