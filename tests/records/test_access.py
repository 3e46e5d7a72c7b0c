"""Signed-in browsers, attempts to sign in, and a team's own tokens."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import select, update

from exceptiondrive_records.accounts import sessions
from exceptiondrive_records.accounts.attempts import (
    PER_TOKEN_ID,
    count_attempt,
    give_attempt_back,
    keys_of,
)
from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_records.accounts.sessions import (
    end_session,
    find_session,
    open_person_session,
    open_token_session,
)
from exceptiondrive_records.accounts.tables import BrowserSession, SignInAttempts, Token
from exceptiondrive_records.accounts.tokens import (
    ORGANIZER_SCOPES,
    TEAM_SCOPES,
    Principal,
    Scope,
    issue_team_token,
    issue_token,
    revoke_team_token,
    revoke_token,
    rotate_team_token,
    team_tokens,
    verify_token,
)
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotAllowed, TooManyAttempts
from exceptiondrive_records.db.errors import NotFound as NotFoundRecord
from exceptiondrive_records.teams.teams import create_team

World = Any


def principal(world: World, team_id: int | None = None, **more: Any) -> Principal:
    with world.database.write() as session:
        text, _ = issue_token(
            session, team_id or world.team_id, "t", **{"scopes": TEAM_SCOPES, **more}, actor="test"
        )
    with world.database.read() as session:
        found = verify_token(session, text)
    assert found is not None
    return found


def sign_in(world: World, who: Principal) -> str:
    with world.database.write() as session:
        return open_token_session(session, who)


def signed_in(world: World, secret: str) -> Principal | None:
    with world.database.read() as session:
        return find_session(session, secret)


def test_a_session_has_the_rights_of_its_token(world: World) -> None:
    who = principal(world)
    found = signed_in(world, sign_in(world, who))
    assert found is not None
    assert (found.token_id, found.team_id, found.scopes) == (who.token_id, who.team_id, who.scopes)


def test_only_the_digest_of_a_session_is_kept(world: World) -> None:
    secret = sign_in(world, principal(world))
    with world.database.read() as session:
        row = session.scalars(select(BrowserSession)).one()
    assert secret not in repr(vars(row))


@pytest.mark.parametrize("secret", ["", "x", "x" * 5000, "\ud800"])
def test_a_made_up_session_is_none(world: World, secret: str) -> None:
    assert signed_in(world, secret) is None


def test_a_session_ends_with_sign_out_with_its_time_and_with_its_token(world: World) -> None:
    who = principal(world)
    left, late, lost = (sign_in(world, who) for _ in range(3))
    with world.database.write() as session:
        end_session(session, left)
        end_session(session, left)
    assert signed_in(world, left) is None
    assert signed_in(world, lost) is not None
    with world.database.write() as session:
        revoke_token(session, who.token_id, actor="test")
    assert signed_in(world, lost) is None
    other = sign_in(world, principal(world))
    with world.database.write() as session:
        past = datetime.now(UTC) - timedelta(seconds=1)
        session.execute(update(BrowserSession).values(expires_at=past))
    assert signed_in(world, other) is None
    sign_in(world, principal(world))
    with world.database.read() as session:
        assert len(session.scalars(select(BrowserSession)).all()) == 1, late


def attempt(world: World, text: str, address: str = "192.0.2.1") -> bool:
    try:
        with world.database.write() as session:
            count_attempt(session, keys_of(address, text))
    except TooManyAttempts:
        return False
    return True


def token_text(token_id: str = "abcdefgh") -> str:
    return f"edk_s_{token_id}_{'A' * 32}_AAAAAA"


def test_parallel_attempts_are_admitted_exactly_as_often_as_allowed(world: World) -> None:
    with ThreadPoolExecutor(8) as pool:
        admitted = list(pool.map(lambda n: attempt(world, token_text(), f"192.0.2.{n}"), range(20)))
    assert sum(admitted) == PER_TOKEN_ID
    assert attempt(world, token_text("another0"))


def test_attempts_from_one_address_are_limited_whatever_the_token(world: World) -> None:
    admitted = [attempt(world, token_text(f"token{n:03}")) for n in range(40)]
    assert sum(admitted) == 30
    assert attempt(world, token_text(), "192.0.2.9")


def test_a_success_counts_nothing_and_a_new_window_begins_anew(world: World) -> None:
    keys = keys_of("192.0.2.1", token_text())
    for _ in range(PER_TOKEN_ID):
        assert attempt(world, token_text())
    assert not attempt(world, token_text())
    with world.database.write() as session:
        give_attempt_back(session, keys)
    assert attempt(world, token_text())
    assert not attempt(world, token_text())
    with world.database.write() as session:
        long_ago = datetime.now(UTC) - timedelta(hours=1)
        session.execute(update(SignInAttempts).values(since=long_ago))
    assert attempt(world, token_text())


def test_a_person_signs_in_only_so_often_a_day(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "MAX_SIGN_INS_A_DAY", 1)

    def sign_in(subject: str) -> None:
        with world.database.write() as session:
            person = welcome_person(session, Identity("https://id.test", subject))
            open_person_session(session, person)

    sign_in("ada")
    sign_in("eve")
    with pytest.raises(Conflict, match="1 times in 24 hours"):
        sign_in("ada")


def test_a_team_cannot_give_itself_rights(world: World) -> None:
    who = principal(world)
    with world.database.write() as session, pytest.raises(NotAllowed, match="organizer"):
        issue_team_token(session, who, "more", ORGANIZER_SCOPES)
    reader = replace(who, scopes=frozenset({Scope.TOKENS, Scope.READ_OWN}))
    with world.database.write() as session, pytest.raises(NotAllowed, match="submit"):
        issue_team_token(session, reader, "more", (Scope.SUBMIT,))


def test_rotating_cannot_take_over_a_mightier_token(world: World) -> None:
    mighty = principal(world, scopes=ORGANIZER_SCOPES)
    with world.database.write() as session, pytest.raises(NotAllowed):
        rotate_team_token(session, principal(world), mighty.token_id)


def test_a_rotated_token_works_on_for_the_days_given(world: World) -> None:
    who = principal(world)
    with world.database.write() as session:
        text, new = rotate_team_token(session, who, who.token_id, 3)
    with world.database.read() as session:
        old = session.get_one(Token, who.token_id)
        found = verify_token(session, text)
    assert found is not None
    assert (new.name, found.scopes, new.expires_at) == (old.name, who.scopes, None)
    assert old.expires_at is not None
    left = old.expires_at - datetime.now(UTC)
    assert timedelta(days=2, hours=23) < left < timedelta(days=3, minutes=1)


def test_a_rotated_token_lives_as_long_as_the_old_one_did(world: World) -> None:
    soon = datetime.now(UTC) + timedelta(days=2)
    who = principal(world, expires_at=soon)
    with world.database.write() as session:
        _, new = rotate_team_token(session, who, who.token_id, 90)
        old = session.get_one(Token, who.token_id)
        assert old.expires_at == soon
        assert new.expires_at is not None
        assert timedelta(days=1, hours=23) < new.expires_at - new.created_at < timedelta(days=3)


def test_what_has_ended_cannot_be_rotated_and_days_have_limits(world: World) -> None:
    who, spare = principal(world), principal(world)
    with world.database.write() as session:
        revoke_team_token(session, who, spare.token_id)
    with world.database.write() as session, pytest.raises(Conflict):
        rotate_team_token(session, who, spare.token_id)
    for days in (-1, 91):
        with world.database.write() as session, pytest.raises(InvalidRecord):
            rotate_team_token(session, who, who.token_id, days)


def test_another_teams_token_is_not_there(world: World) -> None:
    with world.database.write() as session:
        other = create_team(session, "beta", "Beta", actor="test").id
    who, theirs = principal(world), principal(world, other)
    for change in (rotate_team_token, revoke_team_token):
        with world.database.write() as session, pytest.raises(NotFoundRecord):
            change(session, who, theirs.token_id)
    with world.database.read() as session:
        assert [token.id for token in team_tokens(session, who)] == [who.token_id]


def test_a_principal_without_a_team_has_no_tokens_to_manage(world: World) -> None:
    with world.database.write() as session:
        text, issued = issue_token(session, None, "o", ORGANIZER_SCOPES, actor="test")
        who = verify_token(session, text)
        assert who is not None
        assert team_tokens(session, who) == []
        with pytest.raises(NotFoundRecord):
            revoke_team_token(session, who, issued.id)
