"""Bearer tokens: shown once, kept as a digest, alike in refusal."""

import json
import string
import zlib
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import inspect, text, update

from exceptiondrive_records.accounts import tokens
from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound

World = Any


def issue(world: World, **changes: Any) -> str:
    values = {"team_id": world.team_id, "name": "laptop", "actor": "test", **changes}
    with world.database.write() as session:
        return tokens.issue_token(session, **values)[0]


def verify(world: World, token: str) -> tokens.Principal | None:
    with world.database.read() as session:
        return tokens.verify_token(session, token)


def test_a_token_speaks_for_its_team(world: World) -> None:
    principal = verify(world, issue(world))
    assert principal is not None
    assert (principal.team_slug, principal.team_name) == ("alpha", "Alpha")
    assert principal.scopes == {Scope.SUBMIT, Scope.READ_OWN}
    assert not principal.is_organizer


def test_an_organizer_token_has_no_team_and_says_so_in_its_letter(world: World) -> None:
    token = issue(world, team_id=None, scopes=tokens.ORGANIZER_SCOPES)
    principal = verify(world, token)
    assert token.startswith("edk_o_")
    assert principal is not None
    assert principal.is_organizer
    assert principal.team_id is None


def test_a_token_has_the_form_that_leak_scanners_know(world: World) -> None:
    token = issue(world)
    body, _, checksum = token.rpartition("_")
    assert [len(part) for part in token.split("_")] == [3, 1, 8, 32, 6]
    digits = string.ascii_letters + string.digits
    number = sum(digits.index(digit) * 62**place for place, digit in enumerate(checksum))
    assert number == zlib.crc32(body.encode())


def altered(token: str) -> list[str]:
    prefix, letter, token_id, secret, checksum = token.split("_")
    return [
        "",
        "edk",
        token[:-1],
        token + "x",
        token + " ",
        f"{prefix}_o_{token_id}_{secret}_{checksum}",
        f"{prefix}_{letter}_{token_id}_{secret[::-1]}_{checksum}",
        f"{prefix}_{letter}_{'0' * 8}_{secret}_{checksum}",
        f"{prefix}_{letter}_{token_id}__{checksum}",
        "edk_s_' OR 1=1 --_x_y",
        "\ud800" * 5,
        "_" * 100_000,
    ]


def test_nothing_but_the_whole_token_is_taken(world: World) -> None:
    token = issue(world)
    for other in altered(token):
        assert verify(world, other) is None
    assert verify(world, token) is not None


def test_expired_and_revoked_tokens_are_refused(world: World) -> None:
    token = issue(world, expires_at=datetime.now(UTC) + timedelta(days=1))
    assert verify(world, token) is not None
    with world.database.write() as session:
        session.execute(update(Token).values(expires_at=datetime(2020, 1, 1, tzinfo=UTC)))
    assert verify(world, token) is None
    fresh = issue(world)
    token_id = fresh.split("_")[2]
    with world.database.write() as session:
        tokens.revoke_token(session, token_id, actor="test")
    assert verify(world, fresh) is None
    with world.database.write() as session, pytest.raises(Conflict):
        tokens.revoke_token(session, token_id, actor="test")
    with world.database.write() as session, pytest.raises(NotFound):
        tokens.revoke_token(session, "00000000", actor="test")


@pytest.mark.parametrize(
    "changes",
    [
        {"scopes": ("submit", "admin")},
        {"scopes": ()},
        {"name": ""},
        {"expires_at": datetime(2020, 1, 1, tzinfo=UTC)},
    ],
)
def test_tokens_that_make_no_sense_are_not_issued(world: World, changes: dict[str, Any]) -> None:
    with pytest.raises(InvalidRecord):
        issue(world, **changes)


def test_two_tokens_of_a_team_live_side_by_side_so_that_they_can_be_rotated(world: World) -> None:
    first, second = issue(world), issue(world)
    assert verify(world, first) is not None
    assert verify(world, second) is not None
    with world.database.read() as session:
        assert len(tokens.list_tokens(session, world.team_id)) == 2


def test_use_is_noted_once_in_a_while(world: World) -> None:
    token = issue(world)
    principal = verify(world, token)
    assert principal is not None
    assert principal.use_is_stale
    tokens.note_use(world.database, principal)
    again = verify(world, token)
    assert again is not None
    assert not again.use_is_stale


def test_no_table_holds_the_secret_of_a_token(world: World) -> None:
    secret = issue(world).split("_")[3]
    with world.database.read() as session:
        for table in inspect(session.get_bind()).get_table_names():
            rows = session.execute(text(f"SELECT * FROM {table}")).all()
            assert secret not in json.dumps([tuple(map(str, row)) for row in rows])
