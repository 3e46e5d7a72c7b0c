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
from tests.support.databases import POSTGRES_ALONE, wait_until_it_waits
from tests.support.records import count_audit_lines

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
    confirm_contact,
    list_contacts,
    remove_contact,
    set_wishes,
    unsubscribe_contact,
)
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.notifications.tables import Channel
from exceptiondrive_records.operations.site import set_site_links, site_links
from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.participation.forgetting import forget_person, forget_team
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.phases.terms import accept_terms, terms_version
from exceptiondrive_records.rescoring.freeze import hold_running_deadlines, tell_teams
from exceptiondrive_records.splits.confirmations import withdraw_confirmation
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.splits.tables import ConfirmationRow
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.teams import teams
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team, refuse_team, register_team
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_schemas.split import SplitRef

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


def plant_confirmation(session: Session, protocol_digest: str) -> str:
    split = find_split(session, "sample")
    said = Confirmation(
        split=SplitRef(name=split.name, revision=split.revision),
        protocol=protocol_digest,
        public_key="A" * 43 + "=",
        signature="A" * 86 + "==",
    )
    row = ConfirmationRow(
        id=said.id,
        split_name=split.name,
        split_revision=split.revision,
        protocol_digest=protocol_digest,
        confirmation=said,
        confirmed_at=database_now(session),
    )
    session.add(row)
    return row.id


@pytest.mark.parametrize(
    "line",
    [
        "token revoked",
        "confirmation withdrawn",
        "invitation withdrawn",
        "contact confirmed",
        "contact unsubscribed",
        "contact removed",
        "terms accepted",
        "site links changed",
    ],
)
def test_what_is_clicked_twice_at_once_is_done_and_logged_once(world: World, line: str) -> None:
    team_id, token_id = world.team_id, member(world).token_id
    with world.database.write() as session:
        contact = add_contact(session, team_id, Channel.EMAIL, "eve@example.org", actor="test")
        contact_id, key = contact.id, str(contact.secret)
        _, invitation = invite(session, team_id, "Ada", actor="test")
        invitation_id = invitation.id
        confirmation_id = plant_confirmation(session, world.protocol_digest)
        phase = session.get_one(Phase, "dev")
        phase.page = phase.page.model_copy(update={"terms": "Be fair."})
        phase.policy = phase.policy.model_copy(update={"terms_required": True})
        version = str(terms_version(phase))
    actions: dict[str, Action] = {
        "token revoked": lambda session: tokens.revoke_token(session, token_id, actor="test"),
        "confirmation withdrawn": lambda session: withdraw_confirmation(
            session, confirmation_id, "left", "test"
        ),
        "invitation withdrawn": lambda session: withdraw_invitation(
            session, team_id, invitation_id, actor="test"
        ),
        "contact confirmed": lambda session: confirm_contact(session, contact_id, key),
        "contact unsubscribed": lambda session: unsubscribe_contact(session, contact_id, key),
        "contact removed": lambda session: remove_contact(
            session, team_id, contact_id, actor="test"
        ),
        "terms accepted": lambda session: accept_terms(
            session, team_id, session.get_one(Phase, "dev"), version, actor="test"
        ),
        "site links changed": lambda session: set_site_links(
            session, SiteLinks(contact="us@example.org"), actor="test"
        ),
    }
    refused = refusal(world.database, actions[line], actions[line])
    assert refused is None or isinstance(refused, RecordsError)
    with world.database.read() as session:
        assert count_audit_lines(session, line) == 1


def test_two_organizers_set_two_links_of_the_site_at_once(world: World) -> None:
    with world.database.write() as session:
        set_site_links(session, SiteLinks(contact="us@example.org"), actor="test")
    links = {"paper_url": "https://example.org/paper", "code_url": "https://example.org/code"}
    one, other = (SiteLinks.model_validate({name: link}) for name, link in links.items())
    refused = refusal(
        world.database,
        lambda session: set_site_links(session, one, actor="test"),
        lambda session: set_site_links(session, other, actor="test"),
    )
    assert refused is None
    with world.database.read() as session:
        assert links.items() <= site_links(session).model_dump().items()


def test_who_joins_by_two_clicks_at_once_has_joined(world: World) -> None:
    with world.database.write() as session:
        link, _ = invite(session, world.team_id, "Ada", actor="test")
        eve = welcome_person(session, Identity("https://id.test", "eve")).id

    def join(session: Session) -> None:
        accept_invitation(session, link, eve, actor="test")

    assert refusal(world.database, join, join) is None
    with world.database.read() as session:
        assert count_audit_lines(session, "member joined") == 1


def test_who_joins_by_an_invitation_leaves_none_to_withdraw(world: World) -> None:
    with world.database.write() as session:
        link, invitation = invite(session, world.team_id, "Ada", actor="token:x")
        invitation_id = invitation.id
        eve = welcome_person(session, Identity("https://id.test", "eve")).id
    refused = refusal(
        world.database,
        lambda session: accept_invitation(session, link, eve, actor="test"),
        lambda session: withdraw_invitation(session, world.team_id, invitation_id, actor="test"),
    )
    assert isinstance(refused, NotFound)


@POSTGRES_ALONE
def test_who_revokes_a_token_while_somebody_joins_by_its_invitation_ends_the_token(
    world: World,
) -> None:
    token_id = member(world).token_id
    with world.database.write() as session:
        link, _ = invite(session, world.team_id, "Ada", actor=f"token:{token_id}")
        eve = welcome_person(session, Identity("https://id.test", "eve")).id
    refused = refusal(
        world.database,
        lambda session: accept_invitation(session, link, eve, actor="test"),
        lambda session: tokens.revoke_token(session, token_id, actor="test"),
    )
    assert refused is None
    with world.database.read() as session:
        assert session.get_one(Token, token_id).revoked_at is not None
        assert count_audit_lines(session, "invitation withdrawn") == 0


def test_what_teams_are_promised_holds_for_an_upload_of_this_moment(world: World) -> None:
    """Else one scored on a part of the split that counts no longer would stand on no board."""
    change = PhaseChange.model_validate({"policy": {"anonymous": True}})

    def upload(session: Session) -> None:
        accept(
            session,
            team_id=world.team_id,
            phase_id="dev",
            method="Planner",
            file_digest="sha256:" + "a" * 64,
            size_bytes=1,
        )

    refused = refusal(
        world.database, upload, lambda session: update_phase(session, "dev", change, actor="test")
    )
    assert isinstance(refused, Conflict)
    assert "The phase has submissions" in str(refused)


def test_a_reveal_goes_past_a_team_that_is_refused_at_this_moment(world: World) -> None:
    with world.database.write() as session:
        register_team(session, "gamma", "Gamma", "We are new.")
        phase = session.get_one(Phase, "dev")
        phase.closes_at = database_now(session) + timedelta(hours=1)
        until = phase.closes_at + timedelta(hours=1)
    for slug in ("gamma", "alpha"):
        with world.database.write() as session:
            set_allowance(session, slug, "dev", closes_at=until, reason="ill", actor="test")
    held: list[tuple[Team, Any]] = []

    def hold(session: Session) -> None:
        held.extend(hold_running_deadlines(session, session.get_one(Phase, "dev")))

    refused = refusal(
        world.database,
        lambda session: refuse_team(session, "gamma", reason="Unknown to us.", actor="test"),
        hold,
    )
    assert refused is None
    assert [team.slug for team, _ in held] == ["alpha"]


@POSTGRES_ALONE
@pytest.mark.parametrize("moment", ["FOR KEY SHARE", "FROM contact_points"])
def test_a_team_that_is_forgotten_while_its_phase_changes_is_told_under_no_old_name(
    world: World, moment: str
) -> None:
    world.submit("file")
    with (
        interrupted(
            world.database,
            moment,
            lambda session: forget_team(session, "alpha", reason="They asked us to.", actor="test"),
        ),
        world.database.write() as session,
    ):
        tell_teams(session, session.get_one(Phase, "dev"), "The deadline is changed", "Later.")
    with world.database.read() as session:
        (told,) = list_notifications(session, world.team_id)
    assert told.team.startswith("Former team")
