"""What organizers do with teams: every action in the records, its way back, and two at once."""

import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from datetime import timedelta
from functools import partial
from typing import Any

import pytest
from sqlalchemy import select
from tests.records.world import World
from tests.support.records import add_phase, next_moment

from exceptiondrive_records.accounts.people import (
    Identity,
    accept_invitation,
    find_invitation,
    invite,
    members_of,
    welcome_person,
)
from exceptiondrive_records.accounts.sessions import open_person_session, open_token_session
from exceptiondrive_records.accounts.tables import BrowserSession, Membership, Person, Token
from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token, verify_token
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.standings import entries_for_board
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import (
    Conflict,
    InvalidRecord,
    NotAllowed,
    NotFound,
    PhaseClosed,
    QuotaExceeded,
)
from exceptiondrive_records.news.questions import answer_question, ask_question
from exceptiondrive_records.notifications.contacts import add_contact, list_contacts
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.notifications.tables import Channel, ContactPoint, Delivery
from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.participation.changes import approve_team, change_team, merge_teams
from exceptiondrive_records.participation.disqualification import (
    disqualify_submission,
    disqualify_team,
    find_disqualification,
    reinstate,
)
from exceptiondrive_records.participation.forgetting import forget_team
from exceptiondrive_records.participation.importing import import_teams
from exceptiondrive_records.participation.messages import recipients, send_message, write_about
from exceptiondrive_records.phases.allowances import is_open_to
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.phases.disqualified import disqualification_notes, disqualified_since
from exceptiondrive_records.phases.phases import find_phase, phase_view
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.phases.terms import accept_terms, terms_version
from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.teams import (
    create_team,
    find_team,
    list_teams,
    refuse_team,
)
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.api.submission import SubmissionStatus

WHO = "token:o"
WHY: Any = {"reason": "two accounts of one lab", "actor": WHO}


def names(world: World) -> set[str]:
    """The teams on the next board."""
    with world.database.read() as session:
        return {one.team for one in entries_for_board(session, "dev", world.protocol_digest)}


def told(world: World, team_id: int | None = None) -> list[str]:
    with world.database.read() as session:
        return [one.title for one in list_notifications(session, team_id or world.team_id)]


def last_words(world: World) -> tuple[str, ...]:
    """What the newest notification says beside its reason."""
    with world.database.read() as session:
        return list_notifications(session, world.team_id)[0].what_changed[1:]


def last_action(world: World) -> str:
    with world.database.read() as session:
        line = session.scalars(select(AuditLine).order_by(AuditLine.id.desc()).limit(1)).one()
    return line.action


def another(world: World, slug: str = "beta") -> int:
    with world.database.write() as session:
        return create_team(session, slug, slug.title(), actor=WHO).id


def test_an_entry_is_disqualified_since_it_or_its_team_first_was(world: World) -> None:
    one, other = world.scored("one", "Planner"), world.scored("two", "Other")
    with world.database.write() as session:
        first = disqualify_submission(session, one, **WHY).disqualified_at
    next_moment(world.database)
    with world.database.write() as session:
        second = disqualify_team(session, "alpha", phase_id="dev", **WHY).disqualified_at
        of_both = [find_submission(session, each) for each in (one, other)]
        assert disqualified_since(session, of_both) == {one: first, other: second}
        assert disqualified_since(session, []) == {}
    assert first < second


def test_a_disqualified_entry_leaves_its_place_empty_and_comes_back(world: World) -> None:
    first, second = world.scored("one", "Planner"), world.scored("two", "Planner")
    with world.database.write() as session:
        row = disqualify_submission(session, second, public_note="Not by a planner.", **WHY)
        number = row.id
    assert world.standing() == {}, "what it displaced does not come up"
    with world.database.read() as session:
        assert view(session, find_submission(session, second)).disqualified_at is not None
        notes = disqualification_notes(session, find_phase(session, "dev"))
    assert [(one.team, one.note) for one in notes] == [("Alpha", "Not by a planner.")]
    assert "is disqualified in Development" in told(world)[0]
    assert last_action(world) == "submission disqualified"
    with pytest.raises(NotAllowed, match="These bytes were disqualified"):
        world.submit("two")
    with world.database.write() as session:
        withdraw(session, second, actor="team:1")
    assert list(world.standing()) == [first]
    with pytest.raises(NotAllowed, match="These bytes were disqualified"):
        world.submit("two")
    with world.database.write() as session:
        reinstate(session, number, **WHY)
    assert not world.submit("two").is_duplicate
    with pytest.raises(Conflict, match="It was reinstated"), world.database.write() as session:
        reinstate(session, number, **WHY)


def test_a_disqualified_team_stands_nowhere_and_submits_nothing(world: World) -> None:
    kept = world.scored("one", "Planner")
    with world.database.write() as session:
        add_phase(session, "other")
    other = replace(world, phase_id="other")
    elsewhere = other.scored("one", "Planner")
    with world.database.write() as session:
        number = disqualify_team(session, "alpha", phase_id="dev", **WHY).id
    assert (world.standing(), list(other.standing())) == ({}, [elsewhere])
    with pytest.raises(NotAllowed, match="Your team is disqualified in this phase"):
        world.submit("another file")
    with pytest.raises(Conflict), world.database.write() as session:
        disqualify_team(session, "alpha", phase_id="dev", **WHY)
    with world.database.read() as session:
        assert disqualification_notes(session, find_phase(session, "dev")) == ()
    with world.database.write() as session:
        reinstate(session, number, **WHY)
    assert list(world.standing()) == [kept]
    assert told(world)[0] == "Your team Alpha is reinstated in Development"
    with world.database.write() as session:
        disqualify_team(session, "alpha", **WHY)
    assert told(world)[0] == "Your team Alpha is disqualified in all phases"
    assert world.standing() == other.standing() == {}


def test_who_is_reinstated_stands_again_unless_another_disqualification_lasts(world: World) -> None:
    one, two = world.scored("one", "Planner"), world.scored("two", "Other")
    with world.database.write() as session:
        entry = disqualify_submission(session, one, **WHY).id
        disqualify_submission(session, two, **WHY)
        here = disqualify_team(session, "alpha", phase_id="dev", **WHY).id
        everywhere = disqualify_team(session, "alpha", **WHY).id
        reinstate(session, entry, **WHY)
    assert last_words(world) == (
        "What was scored stands on the next board, unless another disqualification lasts.",
    )
    assert world.standing() == {}
    with world.database.write() as session:
        reinstate(session, everywhere, **WHY)
        reinstate(session, here, **WHY)
    assert list(world.standing()) == [one]


def test_notes_of_an_anonymous_phase_join_with_no_other_by_phase_or_time(world: World) -> None:
    world.scored("one", "Planner")
    with world.database.write() as session:
        disqualify_team(session, "alpha", public_note="Everywhere.", **WHY)
        disqualify_team(session, "alpha", phase_id="dev", public_note="Here.", **WHY)
    with world.database.write() as session:
        phase = find_phase(session, "dev")
        open_notes = disqualification_notes(session, phase)
        phase.pseudonym_salt = "0" * 32
        phase.policy = phase.policy.model_copy(update={"anonymous": True})
        session.flush()
        masked = disqualification_notes(session, phase)
    assert [one.note for one in open_notes] == ["Here.", "Everywhere."]
    assert [one.note for one in masked] == ["Here."]
    assert masked[0].team != "Alpha"
    assert all(f"{one.disqualified_at:%H%M%S%f}" == "0" * 12 for one in (*open_notes, *masked))


def test_of_two_organizers_at_once_one_disqualifies(world: World) -> None:
    def attempt(_: int) -> bool:
        try:
            with world.database.write() as session:
                disqualify_team(session, "alpha", **WHY)
        except Conflict:
            return False
        return True

    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(attempt, range(2))) == [False, True]


def test_a_later_deadline_holds_for_one_team_and_for_what_came_before_it(world: World) -> None:
    world.scored("one", "Planner")
    world.close()
    beta = another(world)
    with pytest.raises(PhaseClosed):
        world.submit("of nobody")
    with world.database.write() as session:
        until = database_now(session) + timedelta(hours=1)
        set_allowance(session, "alpha", "dev", closes_at=until, **WHY)
    with world.database.read() as session:
        said = list_notifications(session, world.team_id)[0].what_changed
    assert said[1:] == (f"Your deadline is {until:%Y-%m-%d %H:%M} UTC.",)
    later = world.scored("late", "Planner")
    assert list(world.standing()) == [later], "it is no late entry: it displaces the run before it"
    with world.database.read() as session:
        phase = find_phase(session, "dev")
        assert quota_of(session, world.team_id, phase).closes_at is not None
        mine = phase_view(session, phase, max_upload_bytes=1, team_id=world.team_id)
        assert (mine.is_open, phase_view(session, phase, max_upload_bytes=1).is_open) == (
            True,
            False,
        )
        assert not view(session, find_submission(session, later)).is_late
    with pytest.raises(PhaseClosed):
        world.submit("of others", team_id=beta)
    with world.database.read() as session:
        phase = session.get_one(Phase, "dev")
        assert phase.closes_at is not None
        came = find_submission(session, later).received_at
        earlier = phase.closes_at - timedelta(days=1)
    for until_then in (None, came):
        with pytest.raises(Conflict, match="become late"), world.database.write() as session:
            set_allowance(session, "alpha", "dev", closes_at=until_then, **WHY)
    with world.database.write() as session:
        closes_at = came + timedelta(seconds=1)
        set_allowance(session, "alpha", "dev", closes_at=closes_at, **WHY)
    assert list(world.standing()) == [later], "what came in time stays in time"
    with (
        pytest.raises(InvalidRecord, match="must be later than"),
        world.database.write() as session,
    ):
        set_allowance(session, "alpha", "dev", closes_at=earlier, **WHY)


@pytest.mark.parametrize("is_asked", [False, True])
def test_a_file_with_faults_keeps_no_later_deadline_from_being_taken_back(
    world: World, *, is_asked: bool
) -> None:
    world.close()
    with world.database.write() as session:
        until = database_now(session) + timedelta(hours=1)
        set_allowance(session, "alpha", "dev", closes_at=until, **WHY)
    sent = world.submit("wrong").submission.id
    with world.database.write() as session:
        rejected = find_submission(session, sent)
        rejected.status = SubmissionStatus.REJECTED
        rejected.confirm_until = until if is_asked else None
    refused = pytest.raises(Conflict, match="become late") if is_asked else nullcontext()
    with refused, world.database.write() as session:
        set_allowance(session, "alpha", "dev", closes_at=None, **WHY)
    with world.database.read() as session:
        said = list_notifications(session, world.team_id)[0].what_changed
    assert ("Your deadline is as for all teams again." in said) != is_asked


def test_nothing_tells_a_team_of_a_hidden_phase_to_which_it_sent_nothing(world: World) -> None:
    with world.database.write() as session:
        beta = create_team(session, "beta", "Beta Labs", actor=WHO).id
    world.scored("a", "Planner")
    with world.database.write() as session:
        find_phase(session, "dev").visibility = "hidden"
    actions: tuple[Any, ...] = (
        partial(set_allowance, phase_id="dev", quota_total=9, **WHY),
        partial(disqualify_team, phase_id="dev", **WHY),
    )
    for action in actions:
        with pytest.raises(Conflict, match="show it first"), world.database.write() as session:
            action(session, "beta")
        with world.database.write() as session:
            action(session, "alpha")
    assert told(world, beta) == []
    assert len(told(world)) == 2, "who submitted before it was hidden knows of it"
    with world.database.write() as session:
        disqualify_team(session, "beta", **WHY)
    assert told(world, beta) == ["Your team Beta Labs is disqualified in all phases"]


@pytest.mark.parametrize(
    ("visibility", "opens_in_h", "own_closes_in_h", "is_open"),
    [
        ("shown", -2, 1, True),
        ("shown", -2, 0, False),
        ("shown", 1, 2, False),
        ("hidden", -2, 1, False),
        ("archived", -2, 1, False),
    ],
)
def test_a_later_deadline_opens_no_phase_that_has_not_begun_or_is_not_shown(
    world: World, visibility: Any, opens_in_h: int, own_closes_in_h: int, is_open: bool
) -> None:
    with world.database.write() as session:
        phase, now = find_phase(session, "dev"), database_now(session)
        phase.visibility = visibility
        phase.opens_at = now + timedelta(hours=opens_in_h)
        phase.closes_at = max(now, phase.opens_at) - timedelta(hours=1)
        own = now + timedelta(hours=own_closes_in_h)
        assert is_open_to(session, phase, own, now) is is_open


def test_another_limit_leaves_the_deadline_of_a_team_and_its_entry_alone(world: World) -> None:
    world.close()
    with world.database.write() as session:
        until = database_now(session) + timedelta(hours=1)
        set_allowance(session, "alpha", "dev", closes_at=until, **WHY)
    mine = world.scored("late", "Planner")
    with world.database.write() as session:
        set_allowance(session, "alpha", "dev", quota_per_day=12, **WHY)
    assert list(world.standing()) == [mine]
    with world.database.write() as session:
        set_allowance(session, "alpha", "dev", quota_per_day=None, **WHY)
    assert list(world.standing()) == [mine]
    with world.database.read() as session:
        ended, more = list_notifications(session, world.team_id)[:2]
    own, days = f"Your deadline is {until:%Y-%m-%d %H:%M} UTC.", "Your submissions a day are"
    assert more.what_changed[1:] == (own, f"{days} 12.")
    assert ended.what_changed[1:] == (own, f"{days} as for all teams again.")


def test_a_deadline_that_is_moved_by_seconds_holds_for_what_came_before_it(world: World) -> None:
    submission_id = world.scored("one", "Planner")
    world.close()
    with world.database.write() as session:
        minute = (database_now(session) + timedelta(hours=1)).replace(second=0, microsecond=0)
    for seconds in (10, 50, 50):
        until = minute + timedelta(seconds=seconds)
        with world.database.write() as session:
            set_allowance(session, "alpha", "dev", closes_at=until, **WHY)
        with world.database.read() as session:
            assert find_submission(session, submission_id).granted_until == until
    assert last_action(world) == "allowance changed"
    assert len(told(world)) == 2, "what is granted already is told once"


def test_a_team_has_its_own_quota(world: World) -> None:
    with world.database.write() as session:
        set_allowance(session, "alpha", "dev", quota_total=1, **WHY)
    world.submit("one")
    with pytest.raises(QuotaExceeded):
        world.submit("two")
    with world.database.write() as session:
        set_allowance(session, "alpha", "dev", quota_total=None, **WHY)
    world.submit("two")
    assert told(world) == ["What your team may submit to Development is changed"] * 2
    with world.database.read() as session:
        back, granted = list_notifications(session, world.team_id)
    because = f"Reason: {WHY['reason']}"
    assert granted.what_changed == (because, "Your submissions in all are 1.")
    assert back.what_changed == (because, "Your submissions in all are as for all teams again.")


def test_a_team_is_renamed_and_no_two_look_alike(world: World) -> None:
    another(world)
    world.scored("one", "Planner")
    with world.database.write() as session:
        change_team(session, "alpha", name="Gamma", affiliation="Somewhere", **WHY)
    assert names(world) == {"Gamma"}
    with pytest.raises(Conflict), world.database.write() as session:
        change_team(session, "alpha", name="BETA", **WHY)
    with world.database.read() as session:
        team = find_team(session, "alpha")
        assert (team.name, team.affiliation) == ("Gamma", "Somewhere")
    with world.database.write() as session:
        change_team(session, "alpha", name="GAMMA", **WHY)
    assert last_action(world) == "team changed"


def test_a_new_name_asks_for_no_board_of_an_archived_phase_and_a_disqualification_does(
    world: World,
) -> None:
    def asked() -> dict[str, int]:
        with world.database.read() as session:
            return {row.phase_id: row.asked for row in session.scalars(select(BoardRequest))}

    with world.database.write() as session:
        add_phase(session, "old")
    for place in (world, replace(world, phase_id="old")):
        place.scored("one", "Planner")
    with world.database.write() as session:
        session.get_one(Phase, "old").visibility = "archived"
    before = asked()
    with world.database.write() as session:
        change_team(session, "alpha", name="Gamma", **WHY)
    assert asked() == {"dev": before["dev"] + 1, "old": before["old"]}
    with world.database.write() as session:
        everywhere = disqualify_team(session, "alpha", **WHY).id
    assert asked() == {"dev": before["dev"] + 2, "old": before["old"] + 1}
    with world.database.write() as session:
        reinstate(session, everywhere, **WHY)
    assert asked() == {"dev": before["dev"] + 3, "old": before["old"] + 2}


def test_two_teams_become_one_with_entries_people_and_addresses(world: World) -> None:
    beta = another(world)
    mine, theirs = world.scored("one", "Planner"), world.submit("two", "Theirs", beta)
    world.score(theirs.job_id)
    with world.database.write() as session:
        add_contact(session, beta, Channel.WEBHOOK, "https://example.com/x", actor=WHO)
        issue_token(session, beta, "t", TEAM_SCOPES, actor=WHO)
    with world.database.write() as session:
        _, n_moved = merge_teams(session, "beta", "alpha", **WHY)
    assert n_moved == 1
    assert names(world) == {"Alpha"}
    assert set(world.standing()) == {mine, theirs.submission.id}
    with world.database.read() as session:
        assert [one.address for one in list_contacts(session, world.team_id)] == [
            "https://example.com/x"
        ]
        moved, counts = list_notifications(session, world.team_id)[0].what_changed
        assert moved.startswith("Its 1 submission, people and addresses are")
        assert counts.startswith("Only one run of a method counts")
        tokens = session.scalars(select(Token).where(Token.team_id == beta))
        assert all(token.revoked_at is not None for token in tokens)
        assert find_team(session, "beta").name == "Beta"


def test_a_merged_team_without_submissions_is_said_to_have_had_none(world: World) -> None:
    another(world)
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    with world.database.read() as session:
        (notice,) = list_notifications(session, world.team_id)
    assert notice.what_changed == (
        "It had no submissions; its people and addresses are your team's from now on.",
    )


def test_an_address_that_is_sent_twice_at_once_is_added_once(world: World) -> None:
    def attempt(_: int) -> bool:
        try:
            with world.database.write() as session:
                add_contact(session, world.team_id, Channel.EMAIL, "a@example.org", actor=WHO)
        except Conflict:
            return False
        return True

    with ThreadPoolExecutor(4) as pool:
        assert sorted(pool.map(attempt, range(4))) == [False, False, False, True]


def test_two_teams_that_become_one_are_told_once_at_an_address_that_both_had(
    world: World,
) -> None:
    beta = another(world)
    both, unconfirmed = "https://example.com/x", "a@example.org"
    with world.database.write() as session:
        for team_id in (world.team_id, beta):
            add_contact(session, team_id, Channel.WEBHOOK, both, actor=WHO)
            add_contact(session, team_id, Channel.EMAIL, unconfirmed, actor=WHO)
        (theirs,) = (one for one in list_contacts(session, beta) if one.address == unconfirmed)
        theirs.confirmed_at = database_now(session)
        confirmed_id = theirs.id
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    with world.database.read() as session:
        kept = list_contacts(session, world.team_id)
        assert sorted(one.address for one in kept) == [unconfirmed, both]
        assert confirmed_id in {one.id for one in kept}, "the one that said yes stays"
        (reached,) = recipients(session)
        assert (reached.n_emails, reached.n_webhooks) == (1, 1)


def test_an_allowance_of_a_merged_team_holds_for_what_it_sent_and_is_not_the_other_ones(
    world: World,
) -> None:
    beta = another(world)
    with world.database.write() as session:
        closes_at = database_now(session) + timedelta(hours=1)
        update_phase(session, "dev", PhaseChange(closes_at=closes_at), actor=WHO)
    later = closes_at + timedelta(days=1)
    with world.database.write() as session:
        set_allowance(session, "beta", "dev", closes_at=later, quota_total=9, **WHY)
    theirs = world.submit("two", "Theirs", beta).submission.id
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    with world.database.read() as session:
        assert find_submission(session, theirs).granted_until == later
        quota = quota_of(session, world.team_id, find_phase(session, "dev"))
    assert (quota.closes_at, quota.total, quota.used_total) == (None, None, 1)


def test_what_a_team_asked_is_answered_to_the_team_that_it_became_part_of(world: World) -> None:
    beta = another(world)
    with world.database.write() as session:
        asked = ask_question(session, beta, "dev", "May we use maps?", actor=WHO).id
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    with world.database.write() as session:
        answer_question(session, asked, "Yes.", plain="Yes.", to_all=False, actor=WHO)
    assert told(world)[0] == "Development: A question, answered"


def with_all_that_a_team_has(world: World, slug: str) -> int:
    """Make a team with a row of everything that forgetting or merging takes or moves."""
    team_id = another(world, slug)
    entry = world.submit(slug, team_id=team_id).submission.id
    with world.database.write() as session:
        find_submission(session, entry).description = f"By {slug}"
        identity = Identity("https://login.example.org", slug, name=slug)
        person = welcome_person(session, identity)
        link, _ = invite(session, team_id, slug, actor=f"person:{person.id}")
        accept_invitation(session, link, person.id, actor=WHO)
        open_person_session(session, person)
        invite(session, team_id, slug, actor=f"person:{person.id}")
        text, _ = issue_token(session, team_id, slug, actor=WHO)
        principal = verify_token(session, text)
        assert principal is not None
        open_token_session(session, principal)
        hook = f"https://example.com/{slug}"
        add_contact(session, team_id, Channel.WEBHOOK, hook, actor=WHO, wishes=())
        ask_question(session, team_id, "dev", f"May {slug}?", actor=WHO)
        send_message(session, "Hello", slug, actor=WHO, teams=[slug])
    return team_id


def rows_about(world: World, team_id: int) -> dict[str, Any]:
    """All rows that name a team, and those of its people, sessions and messages on their way."""
    tables = [table for table in Base.metadata.sorted_tables if "team_id" in table.columns]
    with world.database.read() as session:
        tokens = select(Token.id).where(Token.team_id == team_id)
        people = select(Membership.person_id).where(Membership.team_id == team_id)
        contacts = select(ContactPoint.id).where(ContactPoint.team_id == team_id)
        by_token, by_person = (
            BrowserSession.token_id.in_(tokens),
            BrowserSession.person_id.in_(people),
        )
        queries = {table.name: select(table).where(table.c.team_id == team_id) for table in tables}
        queries |= {
            "people": select(Person.__table__).where(Person.id.in_(people)),
            "sessions": select(BrowserSession.__table__).where(by_token | by_person),
            "deliveries": select(Delivery.id, Delivery.state).where(
                Delivery.contact_id.in_(contacts)
            ),
        }
        found = {name: sorted(map(repr, session.execute(query))) for name, query in queries.items()}
    return {name: rows for name, rows in found.items() if rows}


@pytest.mark.parametrize(
    "action", [partial(forget_team, slug="beta"), partial(merge_teams, slug="beta", into="alpha")]
)
def test_what_is_forgotten_or_merged_takes_nothing_of_another_team(
    world: World, action: Any
) -> None:
    with_all_that_a_team_has(world, "beta")
    gamma = with_all_that_a_team_has(world, "gamma")
    before = rows_about(world, gamma)
    assert before.keys() >= {
        "contact_points", "deliveries", "invitations", "memberships", "notifications", "people",
        "questions", "sessions", "submissions", "tokens",
    }  # fmt: skip
    with world.database.write() as session:
        action(session, **WHY)
    assert rows_about(world, gamma) == before


def test_an_upload_in_the_air_makes_no_entry_of_a_team_that_is_none_any_more(
    world: World,
) -> None:
    """It was asked for a token before; what it says would stand under the alias for good."""
    beta, gamma = another(world), another(world, "gamma")
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
        forget_team(session, "gamma", **WHY)
    for team_id in (beta, gamma):
        with pytest.raises(NotAllowed, match="meanwhile"):
            world.submit("held", team_id=team_id)


def test_nobody_is_let_in_to_a_team_that_is_none_any_more(world: World) -> None:
    """A token would be shown that may not submit, and a link that joins nothing."""
    beta, gamma = another(world), another(world, "gamma")
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
        forget_team(session, "gamma", **WHY)
    for team_id in (beta, gamma):
        with pytest.raises(Conflict, match="nobody acts"), world.database.write() as session:
            issue_token(session, team_id, "laptop", actor=WHO)
        with pytest.raises(Conflict, match="nobody acts"), world.database.write() as session:
            invite(session, team_id, "an organizer", actor=WHO)


def test_no_action_of_a_season_is_done_to_a_team_that_is_none_any_more(world: World) -> None:
    """It would be told as done, and change no board."""
    another(world)
    with world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    for action, words in (
        (partial(change_team, name="Gone"), "nobody acts"),
        (partial(set_allowance, phase_id="dev", quota_total=1), "nobody acts"),
        (disqualify_team, "merged into the team alpha, with all that it sent"),
    ):
        with pytest.raises(Conflict, match=words), world.database.write() as session:
            action(session, "beta", **WHY)


def test_teams_with_the_same_bytes_disqualified_or_forgotten_are_not_merged(world: World) -> None:
    beta = another(world)
    first = world.submit("one").submission.id
    with world.database.write() as session:
        withdraw(session, first, actor="test")
    world.submit("one")
    theirs = world.submit("one", team_id=beta).submission.id
    once = f"same bytes: {theirs}\\. "
    with pytest.raises(Conflict, match=once), world.database.write() as session:
        merge_teams(session, "beta", "alpha", **WHY)
    with world.database.write() as session:
        withdraw(session, theirs, actor="test")
        merge_teams(session, "beta", "alpha", **WHY)
    another(world, "gamma")
    with world.database.write() as session:
        disqualify_team(session, "gamma", **WHY)
    with pytest.raises(Conflict, match="disqualified"), world.database.write() as session:
        merge_teams(session, "gamma", "alpha", **WHY)
    another(world, "delta")
    with world.database.write() as session:
        alias = forget_team(session, "delta", **WHY).slug
    with pytest.raises(Conflict, match="was forgotten"), world.database.write() as session:
        merge_teams(session, alias, "alpha", **WHY)


@pytest.mark.parametrize(
    ("method", "policy", "happened", "ended"),
    [
        ("Planner", {}, "scored", "closed"),
        ("Planner", {}, "waits", "closed"),
        ("Planner", {}, "withdrawn since", "closed"),
        ("Planner", {}, "scored", "was archived"),
        ("Other", {"entries_shown": "chosen"}, "scored", "closed"),
        ("Other", {}, "scored", ""),
        ("Planner", {"entries_private": True}, "scored", "closed"),
        ("Other", {"entries_private": True}, "scored", ""),
    ],
)
def test_no_merge_takes_an_entry_off_where_entries_are_final(
    world: World, method: str, policy: dict[str, Any], happened: str, ended: str
) -> None:
    """A closed phase whose entries take no place of each other hinders none."""
    beta = another(world)
    mine, theirs = world.scored("one", "Planner"), world.submit("two", method, beta)
    if happened != "waits":
        world.score(theirs.job_id)
    if ended != "was archived":
        world.close()
    with world.database.write() as session:
        phase = find_phase(session, "dev")
        phase.policy = phase.policy.model_copy(update=policy)
        phase.visibility = "archived" if ended == "was archived" else "shown"
        if happened == "withdrawn since":
            withdraw(session, theirs.submission.id, actor="test")
    before = world.standing()
    if ended:
        words = f"one place, and entries there have been final since it {ended}"
        with pytest.raises(Conflict, match=words), world.database.write() as session:
            merge_teams(session, "beta", "alpha", **WHY)
    else:
        with world.database.write() as session:
            merge_teams(session, "beta", "alpha", **WHY)
    assert world.standing() == before
    assert (mine in before) is (not policy.get("entries_private"))


def test_a_message_reaches_inbox_and_addresses_once(world: World) -> None:
    beta = another(world)
    with world.database.write() as session:
        hook = "https://example.com/x"
        add_contact(session, beta, Channel.WEBHOOK, hook, actor=WHO, wishes=())
        add_contact(session, beta, Channel.EMAIL, "a@example.com", actor=WHO)
    with world.database.read() as session:
        found = recipients(session)
    assert [(one.team, one.n_emails, one.n_webhooks) for one in found] == [
        ("alpha", 0, 0),
        ("beta", 0, 1),
    ]
    with world.database.write() as session:
        send_message(session, "Hello", "First.\n\nSecond.", actor=WHO)
    assert told(world) == told(world, beta) == ["Hello"]
    with world.database.read() as session:
        deliveries = session.scalars(select(Delivery)).all()
        assert len(deliveries) == 2, "the question to the e-mail address, and the message"
        assert list_notifications(session, beta)[0].what_changed == ("First.", "Second.")
    with pytest.raises(Conflict, match="already"), world.database.write() as session:
        send_message(session, "Hello", "First.\n\nSecond.", actor=WHO, teams=["beta"])
    with world.database.write() as session:
        assert len(send_message(session, "Hello", "Other.", actor=WHO, teams=["beta"])) == 1
    assert last_action(world) == "message sent"


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
@pytest.mark.parametrize(
    ("meanwhile", "action"),
    [
        (partial(merge_teams, slug="beta", into="alpha", **WHY), partial(merge_teams, into="beta")),
        (partial(merge_teams, slug="beta", into="alpha", **WHY), forget_team),
        (partial(approve_team, slug="gamma", actor=WHO), refuse_team),
    ],
    ids=["merge", "forget", "refuse"],
)
def test_an_action_is_judged_by_what_another_did_to_the_team_meanwhile(
    world: World, meanwhile: Any, action: Any
) -> None:
    """Whoever waits for the lock of a team has looked at it before; SQLite takes one writer at a time."""
    with world.database.write() as session:
        create_team(session, "beta", "Beta", actor=WHO)
        create_team(session, "gamma", "Gamma", actor=WHO).pending_since = database_now(session)
    slug = {forget_team: "beta", refuse_team: "gamma"}.get(action, "alpha")
    with world.database.write() as session:
        looked_at = list_teams(session)
        with world.database.write() as other:
            meanwhile(other)
        with pytest.raises(Conflict, match=r"is approved|merged into"):
            action(session, slug=slug, **WHY)
        assert len(looked_at) == 3


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
def test_an_entry_that_is_of_another_team_by_now_is_neither_disqualified_nor_reinstated_for_the_old_one(
    world: World,
) -> None:
    """It would be said to be done: the line would name a team that the entry is not of."""
    another(world), another(world, "gamma")
    entry = world.scored("one", "Planner")
    with world.database.write() as session:
        looked_at = find_submission(session, entry)
        with world.database.write() as other:
            merge_teams(other, "alpha", "beta", **WHY)
        with pytest.raises(Conflict, match="merged into another one meanwhile"):
            disqualify_submission(session, entry, **WHY)
        assert looked_at.id == entry
    with world.database.write() as session:
        number = disqualify_submission(session, entry, **WHY).id
    assert world.standing() == {}
    with world.database.write() as session:
        row = find_disqualification(session, number)
        with world.database.write() as other:
            merge_teams(other, "beta", "gamma", **WHY)
        with pytest.raises(Conflict, match="merged into another one meanwhile"):
            reinstate(session, number, **WHY)
        assert row.reinstated_at is None
    with world.database.write() as session:
        reinstate(session, number, **WHY)
    assert list(world.standing()) == [entry]


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
@pytest.mark.parametrize(
    "action", [partial(merge_teams, slug="alpha", into="beta"), partial(forget_team, slug="alpha")]
)
def test_nobody_is_let_in_for_a_team_that_has_gone_meanwhile(world: World, action: Any) -> None:
    another(world)
    with world.database.write() as session:
        person = welcome_person(session, Identity("https://login.example.org", "1")).id
        link, _ = invite(session, world.team_id, WHO, actor=WHO)
    with world.database.write() as session:
        looked_at, (_, team) = list_teams(session), find_invitation(session, link, person)
        with world.database.write() as other:
            action(other, **WHY)
        for letting_in in (
            partial(issue_token, session, world.team_id, "laptop", actor=WHO),
            partial(invite, session, world.team_id, WHO, actor=WHO),
            partial(ask_question, session, world.team_id, "dev", "May we?", actor=WHO),
        ):
            with pytest.raises(Conflict, match="nobody acts for it any more"):
                letting_in()
        with pytest.raises(NotFound):
            accept_invitation(session, link, person, actor=WHO)
        assert team in looked_at
        assert members_of(session, world.team_id) == []


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
def test_what_is_written_to_a_team_that_has_gone_meanwhile_is_not_sent(world: World) -> None:
    another(world)
    entry = world.scored("one", "Planner")
    with world.database.write() as session:
        looked_at = find_submission(session, entry), list_teams(session)
        with world.database.write() as other:
            merge_teams(other, "alpha", "beta", **WHY)
        with pytest.raises(Conflict, match="alpha is part of beta: write to that one"):
            write_about(session, entry, words="We look into it.", actor=WHO)
        assert looked_at
    assert told(world) == []
    with world.database.write() as session:
        write_about(session, entry, words="We look into it.", actor=WHO)
    another(world, "gamma")
    with world.database.write() as session:
        found = list_teams(session)
        with world.database.write() as other:
            merge_teams(other, "gamma", "beta", **WHY)
        with pytest.raises(Conflict, match="gamma is part of beta: write to that one"):
            send_message(session, "Hello", "All.", teams=["gamma"], actor=WHO)
        assert found


def test_many_teams_are_made_or_none(world: World) -> None:
    table = "id;name;affiliation;email\nbeta;Beta;Lab B;b@example.com\ngamma;Gamma;;\n"
    with world.database.write() as session:
        made = import_teams(session, table, actor=WHO)
    assert [(one.slug, one.name) for one in made] == [("beta", "Beta"), ("gamma", "Gamma")]
    with world.database.read() as session:
        beta = find_team(session, "beta")
        assert (beta.affiliation, len(list_contacts(session, beta.id))) == ("Lab B", 1)
    wrong = "id,name\ndelta,Delta\nBAD,Bad\nbeta,Beta\n"
    with pytest.raises(InvalidRecord) as refused, world.database.write() as session:
        import_teams(session, wrong, actor=WHO)
    assert "Line 3" in str(refused.value)
    assert "Line 4" in str(refused.value)
    with world.database.read() as session:
        assert [team.slug for team in list_teams(session)] == ["alpha", "beta", "gamma"]
    twice = "id,name\ndelta,Delta\nDelta2,Other\nzeta,Zeta\ndelta,Third\nepsilon,DELTA\n"
    with pytest.raises(InvalidRecord) as refused, world.database.write() as session:
        import_teams(session, twice, actor=WHO)
    assert "Line 5, Line 6: It has the id or the name of line 2." in str(refused.value)
    long = f"id,name\ndelta,Delta\nepsilon,Delta{chr(0x301) * 90_000}\n"
    with pytest.raises(InvalidRecord) as refused, world.database.write() as session:
        import_teams(session, long, actor=WHO)
    assert "Line 3: The team name is longer" in str(refused.value), "it is not compared with others"
    cells = 'id,name,affiliation\ndelta,Delta,"Lab\nD"\n\nBAD,Bad,\n'
    with pytest.raises(InvalidRecord) as refused, world.database.write() as session:
        import_teams(session, cells, actor=WHO)
    assert re.findall(r"Line (\d+):", str(refused.value)) == ["2", "5"], "where each row begins"
    for table in (
        "",
        "name\nx\n",
        "id,name,x\na,b,c\n",
        "id,name\n",
        "id,name\na\n",
        'id,name\n"a',
    ):
        with pytest.raises(InvalidRecord), world.database.write() as session:
            import_teams(session, table, actor=WHO)


def test_no_phase_asks_for_terms_that_it_has_not(world: World) -> None:
    """Every team would submit unasked, and the organizer believe that all agreed."""
    asked: Any = {"policy": {"terms_required": True}}
    for change in (asked, asked | {"page": {"terms": " \n"}}):
        with pytest.raises(InvalidRecord, match="needs terms"), world.database.write() as session:
            update_phase(session, "dev", PhaseChange.model_validate(change), actor=WHO)
    with world.database.write() as session:
        kept = PhaseChange.model_validate(asked | {"page": {"terms": "Be fair."}})
        update_phase(session, "dev", kept, actor=WHO)
    emptied = PhaseChange.model_validate({"page": {"terms": ""}})
    with pytest.raises(InvalidRecord, match="needs terms"), world.database.write() as session:
        update_phase(session, "dev", emptied, actor=WHO)


def test_terms_are_accepted_by_version_before_a_file_is_taken(world: World) -> None:
    change = {"page": {"terms": "Be *fair*."}, "policy": {"terms_required": True}}
    with world.database.write() as session:
        update_phase(session, "dev", PhaseChange.model_validate(change), actor=WHO)
    with pytest.raises(NotAllowed, match="Accept the terms"):
        world.submit("one")
    with world.database.write() as session:
        phase = find_phase(session, "dev")
        version = terms_version(phase)
        assert version is not None
        accept_terms(session, world.team_id, phase, version, actor="team:1")
    world.submit("one")
    change = {"page": {"terms": "Be *fairer*."}}
    with world.database.write() as session:
        update_phase(session, "dev", PhaseChange.model_validate(change), actor=WHO)
    with pytest.raises(NotAllowed, match="Accept the terms"):
        world.submit("two")
    for other in (version, "never-there"):
        with (
            pytest.raises(Conflict, match="The terms stand in version"),
            world.database.write() as session,
        ):
            accept_terms(session, world.team_id, find_phase(session, "dev"), other, actor="team:1")
