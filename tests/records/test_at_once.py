"""What two do at one moment: limits hold all the same, and what was gone meanwhile is told in words."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from threading import Thread
from typing import Any

import pytest
from sqlalchemy import event, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session
from tests.records.world import World
from tests.support.databases import wait_until_it_waits

from exceptiondrive_records.accounts import sessions, tokens
from exceptiondrive_records.accounts.attempts import count_attempt, give_attempt_back
from exceptiondrive_records.accounts.people import (
    Identity,
    accept_invitation,
    add_member,
    invite,
    welcome_person,
    withdraw_invitation,
)
from exceptiondrive_records.accounts.sessions import (
    find_session,
    open_person_session,
    open_token_session,
)
from exceptiondrive_records.accounts.tables import SignInAttempts, Token
from exceptiondrive_records.accounts.tokens import (
    Principal,
    issue_team_token,
    note_use,
    verify_token,
)
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database, is_conflict
from exceptiondrive_records.db.errors import Conflict, NotFound, RecordsError
from exceptiondrive_records.entries import selection
from exceptiondrive_records.entries.selection import choose
from exceptiondrive_records.news.questions import ask_question
from exceptiondrive_records.notifications import contacts
from exceptiondrive_records.notifications.contacts import (
    add_contact,
    list_contacts,
    remove_contact,
    set_wishes,
    unsubscribe_contact,
)
from exceptiondrive_records.notifications.tables import Channel
from exceptiondrive_records.participation.forgetting import forget_person
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.teams import teams
from exceptiondrive_records.teams.teams import create_team, refuse_team, register_team

Action = Callable[[Session], Any]


def refusal(database: Database, first: Action, second: Action) -> Exception | None:
    """Do `second` while `first` has done all but its end; return why that was refused."""
    errors: list[Exception] = []

    def do_second() -> None:
        try:
            with database.write() as session:
                second(session)
        except (RecordsError, SQLAlchemyError) as error:
            errors.append(error)

    other = Thread(target=do_second)
    with database.write() as session:
        first(session)
        session.flush()
        other.start()
        wait_until_it_waits(database, lambda: not other.is_alive())
    other.join()
    return errors[0] if errors else None


@contextmanager
def interrupted(database: Database, words: str, action: Action) -> Iterator[None]:
    """Let another do an action just before the first statement with these words is sent."""

    def do() -> None:
        with database.write() as session:
            action(session)

    other = Thread(target=do)

    def before(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if words in statement and other.ident is None:
            other.start()
            wait_until_it_waits(database, lambda: not other.is_alive())

    event.listen(database.engine, "before_cursor_execute", before)
    try:
        yield
    finally:
        event.remove(database.engine, "before_cursor_execute", before)
    other.join()


def principal_of(database: Database, text: str) -> Principal:
    with database.read() as session:
        found = verify_token(session, text)
    assert found is not None
    return found


def member(world: World) -> Principal:
    with world.database.write() as session:
        text, _ = tokens.issue_token(
            session, world.team_id, "laptop", tokens.TEAM_SCOPES, actor="test"
        )
    return principal_of(world.database, text)


def test_no_more_tokens_live_than_may(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    who = member(world)
    monkeypatch.setattr(tokens, "MAX_LIVE_TOKENS", 2)

    def issue(session: Session) -> None:
        issue_team_token(session, who, "x", tokens.PARTICIPANT_SCOPES)

    refused = refusal(world.database, issue, issue)
    assert isinstance(refused, Conflict)
    assert "2 live tokens" in str(refused)


def test_no_more_sign_in_than_may(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    who = member(world)
    monkeypatch.setattr(sessions, "MAX_SIGN_INS_A_DAY", 1)

    def sign_in(session: Session) -> None:
        open_token_session(session, who)

    refused = refusal(world.database, sign_in, sign_in)
    assert isinstance(refused, Conflict)
    assert "in 24 hours" in str(refused)


def test_no_more_subscriptions_change_than_may(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contacts, "MAX_CHANGED_A_DAY", 1)
    with world.database.write() as session:
        one, other = (add(session, world.team_id, f"a{n}@example.org") for n in range(2))

    def change(contact_id: str) -> Action:
        return lambda session: set_wishes(session, world.team_id, contact_id, [], actor="test")

    refused = refusal(world.database, change(one), change(other))
    assert isinstance(refused, Conflict)
    assert "in 24 hours" in str(refused)


def test_no_more_choices_are_made_than_may(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (world.scored(name, "Planner") for name in "ab")
    monkeypatch.setattr(selection, "MAX_CHOICES_A_DAY", 1)
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        phase.policy = phase.policy.model_copy(update={"run_choice": "team"})
    refused = refusal(
        world.database,
        lambda session: choose(session, one, actor="test"),
        lambda session: choose(session, other, actor="test"),
    )
    assert isinstance(refused, Conflict)
    assert "in 24 hours" in str(refused)


@pytest.mark.parametrize("limit", ["MAX_PENDING", "MAX_PENDING_OF_NETWORK"])
def test_no_more_teams_wait_for_approval_than_may(
    world: World, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(teams, limit, 1)

    def register(slug: str) -> Action:
        return lambda session: register_team(session, slug, slug, "note", address="203.0.113.1")

    refused = refusal(world.database, register("one"), register("two"))
    assert isinstance(refused, Conflict)
    assert "wait for approval" in str(refused)


def add(session: Session, team_id: int, address: str = "eve@example.org") -> str:
    return add_contact(session, team_id, Channel.EMAIL, address, actor="test").id


def another(world: World, slug: str) -> int:
    with world.database.write() as session:
        return create_team(session, slug, slug.title(), actor="test").id


def test_one_mailbox_is_asked_by_two_teams_no_more_often_than_may(world: World) -> None:
    beta, gamma = another(world, "beta"), another(world, "gamma")
    with world.database.write() as session:
        for _ in range(contacts.MAX_ASKED_A_DAY - 1):
            asked = add(session, world.team_id)
            remove_contact(session, world.team_id, asked, actor="test")
    refused = refusal(
        world.database,
        lambda session: add(session, beta, "Eve+1@example.org"),
        lambda session: add(session, gamma, "eve+2@example.org"),
    )
    assert isinstance(refused, Conflict)
    assert "asked 3 times in 24 hours" in str(refused)


@pytest.mark.parametrize("first", ["no", "question"])
def test_a_no_ends_a_question_of_the_same_moment(world: World, first: str) -> None:
    beta = another(world, "beta")
    with world.database.write() as session:
        contact_id = add(session, world.team_id)
        (contact,) = list_contacts(session, world.team_id)
        key = str(contact.secret)
    actions: dict[str, Action] = {
        "no": lambda session: unsubscribe_contact(session, contact_id, key),
        "question": lambda session: add(session, beta),
    }
    refused = refusal(world.database, actions.pop(first), *actions.values())
    with world.database.read() as session:
        assert list_contacts(session, beta) == []
    if first == "no":
        assert "asked for no more mail" in str(refused)
    else:
        assert refused is None


@pytest.mark.parametrize(
    "action",
    [
        "token",
        "sign in",
        "contact",
        "wishes",
        "question",
        "invite",
        "withdraw invitation",
        "join",
    ],
)
def test_who_acts_for_a_team_that_is_refused_at_this_moment_is_told_so(
    world: World, action: str
) -> None:
    with world.database.write() as session:
        text, _, team = register_team(session, "gamma", "Gamma", "We are new.")
        team_id = team.id
        ada, eve = (
            welcome_person(session, Identity("https://id.test", name)).id for name in ("a", "e")
        )
        add_member(session, team, ada, actor="test")
        link, invitation = invite(session, team_id, "Ada", actor="test")
        invitation_id = invitation.id
    who = principal_of(world.database, text)
    actions: dict[str, Action] = {
        "token": lambda session: issue_team_token(session, who, "x", tokens.PARTICIPANT_SCOPES),
        "sign in": lambda session: open_token_session(session, who),
        "contact": lambda session: add(session, team_id),
        "wishes": lambda session: set_wishes(session, team_id, "none", [], actor="test"),
        "question": lambda session: ask_question(session, team_id, "dev", "Why?", actor="test"),
        "invite": lambda session: invite(session, team_id, "Ada", actor="test"),
        "withdraw invitation": lambda session: withdraw_invitation(
            session, team_id, invitation_id, actor="test"
        ),
        "join": lambda session: accept_invitation(session, link, eve, actor="test"),
    }
    refused = refusal(
        world.database,
        lambda session: refuse_team(session, "gamma", reason="Unknown to us.", actor="test"),
        actions[action],
    )
    assert refused is not None
    assert isinstance(refused, RecordsError) or is_conflict(refused)
    if action not in ("withdraw invitation", "join"):
        assert "refused meanwhile: nobody acts for it any more" in str(refused)


def test_the_use_of_a_token_that_ends_at_this_moment_is_noted_nowhere(world: World) -> None:
    with world.database.write() as session:
        text, token, _ = register_team(session, "gamma", "Gamma", "We are new.")
        token_id = token.id
    who = principal_of(world.database, text)
    with interrupted(
        world.database,
        "UPDATE tokens",
        lambda session: refuse_team(session, "gamma", reason="Unknown to us.", actor="test"),
    ):
        note_use(world.database, who)
    with world.database.read() as session:
        assert session.get(Token, token_id) is None


def test_a_session_of_a_team_that_is_refused_at_this_moment_is_none(world: World) -> None:
    with world.database.write() as session:
        text, _, _ = register_team(session, "gamma", "Gamma", "We are new.")
    who = principal_of(world.database, text)
    with world.database.write() as session:
        secret = open_token_session(session, who)
    with (
        interrupted(
            world.database,
            "FROM tokens",
            lambda session: refuse_team(session, "gamma", reason="Unknown to us.", actor="test"),
        ),
        world.database.read() as session,
    ):
        find_session(session, secret)
    with world.database.read() as session:
        assert find_session(session, secret) is None


def test_an_attempt_counts_though_old_ones_are_swept_at_this_moment(world: World) -> None:
    with world.database.write() as session:
        count_attempt(session, {"a key": 5})
        long_ago = database_now(session) - timedelta(hours=1)
        session.execute(update(SignInAttempts).values(since=long_ago))
    with (
        interrupted(
            world.database,
            "FROM sign_in_attempts",
            lambda session: give_attempt_back(session, {"another": 5}),
        ),
        world.database.write() as session,
    ):
        count_attempt(session, {"a key": 5})
    with world.database.read() as session:
        assert session.scalars(select(SignInAttempts.n)).all() == [1]


def test_who_signs_in_while_they_are_forgotten_is_somebody_new(world: World) -> None:
    ada = Identity("https://id.test", "ada", "Ada")
    with world.database.write() as session:
        old = welcome_person(session, ada).id

    def forget(session: Session) -> None:
        forget_person(session, old, reason="They asked us to.", actor="test")

    new: list[str] = []

    def sign_in(session: Session) -> None:
        person = welcome_person(session, ada)
        open_person_session(session, person)
        new.append(person.id)

    assert refusal(world.database, forget, sign_in) is None
    assert old not in new
    with (
        interrupted(
            world.database,
            "FROM people",
            lambda session: forget_person(
                session, new[0], reason="They asked us to.", actor="test"
            ),
        ),
        world.database.write() as session,
    ):
        assert welcome_person(session, ada).id == new[0], "whose forgetting waits for the end"
    with world.database.write() as session, pytest.raises(NotFound):
        forget_person(session, new[0], reason="Once more.", actor="test")
