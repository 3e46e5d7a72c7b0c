"""What a team is told between protocol updates, where, and only after a yes; and how that ends."""

import re
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from email import message_from_bytes
from email.utils import parsedate_to_datetime
from itertools import product
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import event, select
from structlog.testing import capture_logs
from tests.records.statements import statements
from tests.support.databases import POSTGRES_ALONE
from tests.support.records import count_audit_lines, next_moment

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import InvalidRecord, NotAllowed
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.notifications import contacts, events
from exceptiondrive_records.notifications.channels import NoticeSettings, message_of
from exceptiondrive_records.notifications.contacts import add_contact, contact_link
from exceptiondrive_records.notifications.events import tell_teams
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.notifications.tables import (
    Channel,
    ContactPoint,
    Delivery,
    Notification,
)
from exceptiondrive_records.operations.reconciler import run_reconciler
from exceptiondrive_records.operations.unlogged import unlogged_submissions
from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.participation.disqualification import disqualify_team, reinstate
from exceptiondrive_records.participation.importing import import_teams
from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.teams.teams import find_team, register_team
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_records.work.lease import claim, try_later
from exceptiondrive_schemas.api.notifications import NotificationView
from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import packaged_protocol

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Browse = Callable[..., "TeamBrowser"]
Problem = Callable[[Any, int, str], dict[str, Any]]
ALL = ["updates", "scored", "failed", "overtaken", "phase_ends"]


def add(api: "Api", *wishes: str, who: str = "alpha") -> dict[str, Any]:
    wanted = {"channel": "email", "address": f"{who}@example.org", "wishes": wishes or ALL}
    answer = api.post("/contacts", who, json=wanted)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/api/v1/contacts/{found['id']}"
    return found


def link(api: "Api", contact_id: str, what: Any) -> str:
    with api.database.read() as session:
        return contact_link(session.get_one(ContactPoint, contact_id), what)


def mails(api: "Api") -> list[tuple[str, NotificationView]]:
    """What waits to be sent, by address."""
    query = (
        select(ContactPoint.address, Notification.body)
        .join(Delivery, Delivery.contact_id == ContactPoint.id)
        .join(Notification, Notification.id == Delivery.notification_id)
        .order_by(Notification.created_at, Notification.id)
    )
    with api.database.read() as session:
        return [
            (address, NotificationView.model_validate_json(body))
            for address, body in session.execute(query)
        ]


def kinds(api: "Api") -> list[str]:
    return [notice.kind for _, notice in mails(api)]


def confirmed(api: "Api", browse: Browse, *wishes: str, who: str = "alpha") -> str:
    contact_id = str(add(api, *wishes, who=who)["id"])
    assert browse(api).client.post(link(api, contact_id, "confirm")).status_code == 200
    return contact_id


def test_an_address_is_asked_once_and_told_nothing_before_its_yes(
    api: "Api", browse: Browse
) -> None:
    contact = add(api)
    assert (contact["is_confirmed"], contact["secret"]) == (False, None)
    ((address, question),) = mails(api)
    assert (address, question.kind) == ("alpha@example.org", "confirm_address")
    assert question.comparison == link(api, contact["id"], "confirm")
    assert api.get("/notifications", "alpha").json() == [], "the question is no notice"
    api.score(api.submit("a").json()["id"])
    assert tell_teams(api.database) == 0
    stranger = browse(api)
    page = stranger.get(question.comparison)
    assert page.status_code == 200
    assert api.get("/contacts", "alpha").json()[0]["is_confirmed"] is False, "looking is no yes"
    assert stranger.client.post(question.comparison).status_code == 200
    assert api.get("/contacts", "alpha").json()[0]["is_confirmed"] is True
    again = stranger.get(question.comparison).text
    assert "is told of what the team wished" in again
    assert "May we write" not in again


def test_a_wrong_key_opens_nothing(api: "Api", browse: Browse) -> None:
    contact = add(api)
    for what, key in product(("confirm", "unsubscribe"), ("edw_wrong", "%C3%A9")):
        wrong = f"/contacts/{contact['id']}/{what}?key={key}"
        assert browse(api).get(wrong).status_code == 404
        assert browse(api).client.post(wrong).status_code == 404
    assert api.get("/contacts", "alpha").json()[0]["is_confirmed"] is False


def test_one_click_ends_all_mail(api_on_both: "Api", browse: Browse) -> None:
    contact_id = confirmed(api_on_both, browse)
    leave = link(api_on_both, contact_id, "unsubscribe")
    notice = mails(api_on_both)[0][1]
    settings = NoticeSettings(public_url="https://board.example")
    message = message_from_bytes(message_of(settings, "a@b.example", notice, leave).as_bytes())
    address = str(message["List-Unsubscribe"]).replace("\n", "").replace(" ", "")
    assert address == f"<https://board.example{leave}>"
    assert message["List-Unsubscribe-Post"] == "List-Unsubscribe=One-Click"
    assert parsedate_to_datetime(message["Date"]) == notice.created_at.replace(microsecond=0)
    body = {"List-Unsubscribe": "One-Click"}
    answer = browse(api_on_both).client.post(leave, data=body)  # no cookie, no form token
    assert answer.status_code == 200
    assert api_on_both.get("/contacts", "alpha").json() == []
    api_on_both.score(api_on_both.submit("a").json()["id"])
    assert tell_teams(api_on_both.database) == 0


def ask(api: "Api", address: str, who: str = "alpha") -> Any:
    return api.post("/contacts", who, json={"channel": "email", "address": address})


def addresses(api: "Api") -> dict[str, str]:
    with api.database.read() as session:
        return {one.id: one.address for one in session.scalars(select(ContactPoint))}


def test_an_address_that_said_no_is_asked_by_no_team_again(
    api_on_both: "Api", browse: Browse, as_problem: Problem
) -> None:
    api = api_on_both
    first = ask(api, "Eve@example.org").json()["id"]
    waits = ask(api, "eve@example.org", "beta").json()["id"]
    leave = link(api, first, "unsubscribe")
    removed = api.post(f"/contacts/{first}/remove", "alpha")
    assert (removed.status_code, removed.json()["address"]) == (200, "Eve@example.org")
    assert addresses(api) == {first: "", waits: "eve@example.org"}, "a removed one is not kept"
    assert "No more mail?" in browse(api).get(leave).text, "a team that removed it bars nobody's no"
    said = browse(api).client.post(leave)
    assert (said.status_code, "goes to the address of this link, and no" in said.text) == (
        200,
        True,
    )
    assert set(addresses(api).values()) == {""}
    assert api.get("/contacts", "beta").json() == [], "what another team asked is withdrawn"
    with api.database.read() as session:
        kept = session.get_one(ContactPoint, first)
        assert "eve" not in repr({**kept.__dict__, "_sa_instance_state": None}).lower()
    forgotten = {"reason": "They asked us to."}
    assert api.post("/organizer/teams/alpha/forget", "organizer", json=forgotten).status_code == 200
    for address in ("eve@example.org", "EVE@Example.org", "eve+1@example.org"):
        told = as_problem(ask(api, address, "beta"), 409, "conflict")
        assert "asked for no more mail" in told["detail"]
    assert browse(api).client.post(link(api, waits, "confirm")).status_code == 404
    assert ask(api, "adam@example.org", "beta").status_code == 201


def test_a_no_is_said_whole_before_the_click_and_taken_back_by_its_link(
    api_on_both: "Api", browse: Browse, as_problem: Problem
) -> None:
    """Another team may have asked; so may have a program that opens links for a person."""
    api = api_on_both
    asked = ask(api, "prof@gmail.com", "beta").json()["id"]
    leave = link(api, asked, "unsubscribe")
    body = message_of(NoticeSettings(), "a@b.example", mails(api)[0][1], leave).get_content()
    assert "No more mail about this team, nor a question of any team: " in body
    reader = browse(api)
    assert "no team can ask it again, until that is taken back" in reader.get(leave).text
    for _ in range(2):
        said = reader.client.post(leave)
        assert (said.status_code, "Let teams ask again" in said.text) == (200, True)
    as_problem(ask(api, "p.rof+1@gmail.com"), 409, "conflict")
    table = "id,name,email\ngamma,Gamma,\ndelta,Delta,prof@gmail.com\n"
    with pytest.raises(InvalidRecord) as refused, api.database.write() as session:
        import_teams(session, table, actor="test")
    assert "Line 3: Whoever reads at this address asked for no more mail" in str(refused.value)
    forgotten = {"reason": "They asked us to."}
    assert api.post("/organizer/teams/beta/forget", "organizer", json=forgotten).status_code == 200
    allow = re.findall(r'action="(/contacts/\S+)"', reader.get(leave).text)[0]
    assert reader.client.post(f"{allow}x").status_code == 404, "a wrong key"
    assert "can ask the address of this link again" in reader.client.post(allow).text
    for closed in (leave, allow):
        ended = reader.client.post(closed)
        assert (ended.status_code, "mail to it has ended" in ended.text) == (404, True)
    with api.database.read() as session:
        kept = session.get_one(ContactPoint, asked)
        assert (kept.address, kept.secret, kept.mailbox_digest) == ("", None, None)
        lines = ("contact unsubscribed", "contact allowed")
        assert [count_audit_lines(session, line) for line in lines] == [1, 1]
    assert ask(api, "p.rof+1@gmail.com").status_code == 201
    assert mails(api)[-1][1].kind == "confirm_address", "and it waits for a yes"


def test_no_team_takes_the_last_question_of_a_mailbox_from_the_others(
    api: "Api", as_problem: Problem
) -> None:
    for number in range(2):
        asked = ask(api, f"alice+{number}@example.org", "beta").json()["id"]
        assert api.post(f"/contacts/{asked}/remove", "beta").status_code == 200
    refused = as_problem(ask(api, "alice+2@example.org", "beta"), 409, "conflict")
    assert "asked 2 times in 24 hours by the team" in refused["detail"]
    assert ask(api, "alice@example.org").status_code == 201


def test_a_team_adds_so_many_addresses_a_day_and_goes_on_the_next(
    api: "Api", as_problem: Problem
) -> None:
    for number in range(20):
        asked = ask(api, f"a{number}@example.org")
        assert api.post(f"/contacts/{asked.json()['id']}/remove", "alpha").status_code == 200
    refused = as_problem(ask(api, "one@example.org"), 409, "conflict")
    assert "may add 20 addresses in 24 hours" in refused["detail"]
    with api.database.write() as session:
        for contact in session.scalars(select(ContactPoint)):
            contact.created_at -= timedelta(days=1)
    assert ask(api, "one@example.org").status_code == 201


def test_one_mailbox_is_asked_so_often_a_day_by_all_teams_together(
    api: "Api", as_problem: Problem
) -> None:
    for who, address in product(("alpha", "beta"), ("eve@example.org", "EVE+x@example.org")):
        asked = ask(api, address, who)
        if (who, address) == ("beta", "EVE+x@example.org"):
            assert "asked 3 times in 24 hours" in as_problem(asked, 409, "conflict")["detail"]
        else:
            assert api.post(f"/contacts/{asked.json()['id']}/remove", who).status_code == 200
    assert len(mails(api)) == 3
    assert ask(api, "adam@example.org").status_code == 201


@pytest.mark.parametrize(
    "address", ["johndoe@gmail.com", "J.ohn.Doe+x@googlemail.com", "john.doe@gmail.com"]
)
def test_all_that_google_reads_into_one_mailbox_is_one(
    api: "Api", browse: Browse, as_problem: Problem, address: str
) -> None:
    asked = ask(api, "john.doe@gmail.com").json()["id"]
    browse(api).client.post(link(api, asked, "unsubscribe"))
    told = as_problem(ask(api, address, "beta"), 409, "conflict")
    assert "asked for no more mail" in told["detail"]
    assert ask(api, "johndoe@example.org").status_code == 201
    assert ask(api, "john.doe@example.org").status_code == 201, "a dot of others may be another one"


def test_what_addresses_are_told_of_changes_only_so_often_a_day(
    api_on_both: "Api", as_problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each leaves an audit line for ever."""
    api = api_on_both
    monkeypatch.setattr(contacts, "MAX_CHANGED_A_DAY", 3)
    one, other = (ask(api, f"{name}@example.org").json()["id"] for name in ("one", "other"))

    def change(contact_id: str, *wishes: str) -> Any:
        return api.request("PATCH", f"/contacts/{contact_id}", "alpha", json={"wishes": wishes})

    for contact_id, wishes in ((one, ()), (other, ()), (one, ["scored"])):
        assert change(contact_id, *wishes).status_code == 200
    refused = as_problem(change(other, "scored"), 409, "conflict")
    assert "3 times in 24 hours" in refused["detail"]
    assert change(one, "scored").status_code == 200, "what it is told of already changes nothing"
    with api.database.read() as session:
        assert count_audit_lines(session, "contact changed") == 3


def test_a_score_is_told_once_with_what_the_page_says(
    api: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    confirmed(api, browse, "scored")
    one = api.submit("a").json()["id"]
    other = api.submit("b", "beta").json()["id"]
    api.score(one)
    api.score(other)
    assert tell_teams(api.database) == 0, "its board is being built"
    api.publish(make_entry("Planner", submission_id=one, rank=3))
    assert tell_teams(api.database) == 1
    assert tell_teams(api.database) == 0, "nothing is told twice"
    _, notice = mails(api)[-1]
    assert (notice.kind, notice.title) == ("scored", "Planner was scored in dev")
    assert notice.what_changed == (
        "HCC 50.00 % (40 to 60).",
        "UR 25.00 %.",
        "Rank 3.",
    )
    assert notice.comparison == f"/submissions/{one}"
    assert [each["kind"] for each in api.get("/notifications", "alpha").json()] == ["scored"]


def test_a_team_that_another_became_part_of_is_not_told_again_how_its_submissions_came_out(
    api_on_both: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    confirmed(api, browse, *ALL)
    one = api.submit("a").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one, rank=3))
    assert tell_teams(api.database) == 1
    merged = {"into": "beta", "reason": "one group"}
    assert api.post("/organizer/teams/alpha/merge", "organizer", json=merged).status_code == 200
    api.publish(make_entry("Planner", submission_id=one, rank=3))
    assert tell_teams(api.database) == 0
    inbox = api.get("/notifications", "beta").json()
    assert sorted(each["kind"] for each in inbox) == ["scored", "team_changed"]


@POSTGRES_ALONE
def test_a_reconciler_goes_on_where_another_told_the_same_at_this_moment(
    api_on_both: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    confirmed(api, browse, "scored")
    one = api.submit("a").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one, rank=3))
    told: list[int] = []

    class OneLook(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            self.set()
            return True

    def tell_before(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("INSERT INTO notifications") and not told:
            told.append(0)
            told[0] = tell_teams(api.database)

    event.listen(api.database.engine, "before_cursor_execute", tell_before)
    with capture_logs() as lines:
        run_reconciler(api.database, Dispatcher("memory://"), RecordsSettings(), OneLook())
    assert told == [1]
    assert kinds(api)[1:] == ["scored"]
    assert {"event": "a pass was broken off", "error": "IntegrityError"}.items() <= lines[
        -1
    ].items()


def test_what_was_told_is_not_read_again(
    api: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    api.phase("many", quota_per_day=100)
    confirmed(api, browse, *ALL)
    asked = []
    for numbers in (range(2), range(2, 12)):
        scored = [
            api.submit(f"{n}", phase="many", method=f"Method {n}").json()["id"] for n in numbers
        ]
        for name in scored:
            api.score(name)
        api.publish(
            *(make_entry(name, submission_id=name, rank=None) for name in scored), phase="many"
        )
        assert tell_teams(api.database) == len(scored)
        with statements(api.database) as sent:
            assert tell_teams(api.database) == 0
        asked.append(len(sent))
    assert asked[0] == asked[1]


def test_who_was_passed_is_looked_for_only_where_a_board_changed(
    api: "Api", browse: Browse, make_entry: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    confirmed(api, browse, "overtaken")
    api.publish(make_entry("Planner", submission_id=api.submit("a").json()["id"], rank=1))
    read_boards = []
    for within in (timedelta(hours=1), timedelta(0)):
        monkeypatch.setattr(events, "_PASSED_WITHIN", within)
        with statements(api.database) as sent:
            assert tell_teams(api.database) == 0
        read_boards.append(any("board_entries" in statement for statement in sent))
    assert read_boards == [True, False]


FROZEN_AT = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)


@pytest.mark.parametrize(
    ("closes_in_hours", "policy", "words"),
    [
        (
            -1,
            {"late_entries": "own_view"},
            "It came after the deadline, so it holds no rank and moves none.",
        ),
        (3, {"entries_private": True}, "It is private, and ranks nowhere until"),
        (
            3,
            {"frozen_scores": "hidden", "freezes_at": FROZEN_AT},
            "The board is frozen since 2026-01-02 03:04 UTC: score and rank are kept back",
        ),
    ],
)
def test_a_score_without_a_rank_is_told_with_its_reason(
    api: "Api", browse: Browse, closes_in_hours: int, policy: dict[str, Any], words: str
) -> None:
    confirmed(api, browse, "scored")
    closes_in(api, timedelta(hours=closes_in_hours), policy=PhasePolicy(**policy))
    api.score(api.submit("a").json()["id"])
    api.publish()
    assert tell_teams(api.database) == 1
    assert mails(api)[-1][1].what_changed[-1].startswith(words)


def test_a_private_score_that_no_team_can_publish_any_more_is_told_so(
    api: "Api", browse: Browse
) -> None:
    confirmed(api, browse, "scored")
    api.score(api.submit("a").json()["id"])
    api.publish()
    with api.database.write() as session:
        phase, now = session.get_one(Phase, "dev"), database_now(session)
        phase.policy = PhasePolicy(entries_private=True, frozen_scores="hidden")
        phase.closes_at = phase.unfrozen_at = now
    assert tell_teams(api.database) == 1
    last = mails(api)[-1][1].what_changed[-1]
    assert last == "Not ranked: it was private when hidden scores were revealed, and stays so."


def test_what_failed_or_was_refused_is_told_once_to_whoever_subscribes_to_it(
    api: "Api", browse: Browse
) -> None:
    confirmed(api, browse, "failed")
    confirmed(api, browse, "scored", who="beta")
    failed, wrong = api.submit("a").json()["id"], api.submit("b").json()["id"]
    other = api.submit("c", "beta").json()["id"]
    report = check(b"[]", protocol=packaged_protocol()).report
    for one in (failed, wrong, other):
        if one == wrong:
            api.reject(one, report)
        else:
            api.fail(one, "We could not score it.")
    assert tell_teams(api.database) == 2, "beta wishes to hear of scores alone"
    assert tell_teams(api.database) == 0, "nothing is told twice"
    told = {notice.title: notice.what_changed for who, notice in mails(api) if notice.title}
    assert told["Planner could not be scored in dev"] == (
        "We could not score it.",
        "It cost no quota; while the phase takes files, the same one may be sent again.",
    )
    again = api.submit("a")
    assert (again.status_code, again.json()["id"] != failed) == (202, True)
    assert again.headers["RateLimit-Remaining"] == "4", "it alone costs quota"
    assert told["Planner was rejected in dev"] == ("1 fault in the file.",)
    assert {who for who, notice in mails(api) if notice.kind == "failed"} == {"alpha@example.org"}


def asked_about(api: "Api") -> str:
    """Submit what its team is asked about; return its id."""
    asked: str = api.submit("a", asks_first="true").json()["id"]
    report = check(b"[]", protocol=packaged_protocol()).report
    report = report.model_copy(update={"faults": (), "to_confirm": ("It replaces another.",)})
    api.reject(asked, report)
    return asked


def test_what_waits_for_a_word_says_a_deadline_that_comes_first(api: "Api", browse: Browse) -> None:
    confirmed(api, browse, "failed")
    asked = asked_about(api)
    (plain,) = api.get(f"/submissions/{asked}", "alpha").json()["report"]["to_confirm"]
    closes_in(api, timedelta(hours=3))
    assert tell_teams(api.database) == 1
    _, notice = mails(api)[-1]
    assert notice.title == "Planner waits for your word in dev"
    with api.database.read() as session:
        ends = session.get_one(Phase, "dev").closes_at
    assert notice.what_changed[0].startswith(
        f"Nothing is counted yet. {plain} It is in time where it is confirmed before the deadline, "
        f"{ends:%Y-%m-%d %H:%M} UTC. Confirm it until 20"
    )


def test_a_team_is_told_what_an_organizer_does_with_its_submission(
    api: "Api", browse: Browse
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    here = f"/submissions/{one}"
    confirmed(api, browse, "updates")
    off = (
        "The next boards leave it out; earlier ones keep what they showed, and a frozen board goes "
        "on showing it until it is revealed."
    )

    def do(what: str, who: str = "organizer") -> None:
        next_moment(api.database)
        if what == "edit":
            change = {"method": f"of {who}", "facts": {"sensors": ["lidar"]}}
            answer = api.request("PATCH", here, who, json=change)
        else:
            answer = api.post(f"{here}/{what}", who)
        assert answer.status_code == 200, answer.text

    def told() -> list[tuple[str, tuple[str, ...], str, str]]:
        return [
            (notice.title, notice.what_changed, notice.comparison, notice.phase)
            for _, notice in mails(api)[1:]
        ]

    policy = PhasePolicy(entries_private=True, run_choice="team")
    closes_in(api, timedelta(hours=1), policy=policy)
    for what in ("edit", "publish", "unpublish", "publish", "choose?rule=best"):
        do(what, "alpha")
    assert told() == [], "what a team does itself it knows"
    for who, has_buttons in (("alpha", True), ("organizer", False)):
        page = browse(api, who=who).get(here).text
        assert (f"{here}/unpublish" in page, f"{here}/withdraw" in page) == (has_buttons, True)
    for what in ("choose", "publish", "unpublish"):
        refused = api.post(f"{here}/{what}", "organizer")
        assert (refused.status_code, "belongs to no team" in refused.text) == (403, True), what
    for what in ("edit", "edit", "withdraw", "withdraw"):
        do(what)
    again = api.post(f"/organizer{here}/restore", "organizer", json={"reason": "a slip"})
    assert again.status_code == 200, again.text
    expected = [
        (
            "An organizer edited of alpha",
            "It is called of organizer now. Changed: method. Its page says what stood there before.",
        ),
        ("An organizer withdrew of organizer", f"{off} The quota it took stays used."),
        (
            "An organizer restored of organizer",
            "It is withdrawn no longer, and has its old place in time.",
        ),
    ]
    assert told() == [(title, (words,), here, "dev") for title, words in expected]
    assert len(api.get("/notifications", "alpha").json()) == len(expected)


def test_a_team_alone_confirms_and_is_told_that_an_organizer_tried_again(api: "Api") -> None:
    asked = asked_about(api)
    assert api.post(f"/submissions/{asked}/confirm", "organizer").status_code == 403
    counted = [api.post(f"/submissions/{asked}/confirm", "alpha").json()["id"] for _ in "12"]
    (line,) = api.get("/organizer/audit?action=submission confirmed", "organizer").json()
    assert line["actor"].startswith("token:")
    assert [line["subject"]] * 2 == counted
    assert line["detail"] == {"asked": asked}
    with api.database.read() as session:
        assert list(unlogged_submissions(session)) == []
    api.fail(counted[0])
    body = {"reason": "it is back"}
    path = f"/organizer/submissions/{counted[0]}/retry"
    assert api.post(path, "organizer", json=body).status_code == 200
    (notice,) = api.get("/notifications", "alpha").json()
    assert notice["title"] == "An organizer queued Planner again"
    assert notice["comparison"] == f"/submissions/{counted[0]}"


def test_a_message_that_is_being_sent_has_not_failed_yet(api: "Api") -> None:
    """Whoever adds an address is told from this that its mail could not be sent."""
    add(api)
    with api.database.write() as session:
        assert claim(session, Delivery, select(Delivery.id), 60) is not None
    last = api.get("/contacts", "alpha").json()[0]["last_message"]
    assert last == {"state": "waiting", "attempts": 0, "sent_at": None}
    with api.database.write() as session:
        try_later(session, session.scalars(select(Delivery)).one(), 60, note="no server")
    assert api.get("/contacts", "alpha").json()[0]["last_message"]["attempts"] == 1


def test_a_lost_rank_is_told_once_an_hour(
    api_on_both: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    confirmed(api, browse, "overtaken")
    one, other = api.submit("a").json()["id"], api.submit("b", "beta").json()["id"]
    api.publish(make_entry("Planner", submission_id=one, rank=1))
    assert tell_teams(api.database) == 0
    passed = make_entry("Method AY3", submission_id=one, rank=2)  # as anonymous phases call it
    api.publish(make_entry("Other", submission_id=other, rank=1), passed)
    assert tell_teams(api.database) == 1
    assert tell_teams(api.database) == 0
    _, notice = mails(api)[-1]
    assert (notice.kind, notice.what_changed) == (
        "overtaken",
        ("Planner: rank 1 before, 2 now.",),
    )
    with api.database.write() as session:
        told = session.scalars(select(Notification).where(Notification.kind == "overtaken")).one()
        told.subject = "dev/2026-01-01T00"
    assert tell_teams(api.database) == 0, "a new hour has begun, and nothing else happened"
    again = make_entry("Planner", submission_id=one, rank=3)
    api.publish(make_entry("Other", submission_id=other, rank=1), again)
    assert tell_teams(api.database) == 1
    assert mails(api)[-1][1].what_changed == ("Planner: rank 2 before, 3 now.",)


def test_what_an_entry_of_its_own_passed_is_no_news_to_a_team(
    api_on_both: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    confirmed(api, browse, "overtaken")
    one, newer = api.submit("a").json()["id"], api.submit("c", method="Newer").json()["id"]
    other, more = (api.submit(name, "beta").json()["id"] for name in ("b", "d"))
    api.publish(make_entry("Planner", submission_id=one, rank=1))
    first = make_entry("Newer", submission_id=newer, rank=1)
    api.publish(first, make_entry("Planner", submission_id=one, rank=2))
    assert tell_teams(api.database) == 0
    passed = make_entry("Planner", submission_id=one, rank=3)
    api.publish(first, make_entry("Other", submission_id=other, rank=2), passed)
    assert tell_teams(api.database) == 1
    assert mails(api)[-1][1].what_changed == ("Planner: rank 1 before, 3 now.",)
    with api.database.write() as session:
        told = session.scalars(select(Notification).where(Notification.kind == "overtaken")).one()
        told.subject = "dev/2026-01-01T00"
    passed = make_entry("Planner", submission_id=one, rank=4)
    others = [make_entry("Other", submission_id=key, rank=n) for key, n in ((other, 2), (more, 3))]
    api.publish(first, *others, passed)
    assert tell_teams(api.database) == 1, "its own entry was ahead before, too"
    assert mails(api)[-1][1].what_changed == ("Planner: rank 3 before, 4 now.",)


def test_only_what_is_subscribed_to_is_told(api: "Api", browse: Browse) -> None:
    contact_id = confirmed(api, browse, "phase_ends")
    api.score(api.submit("a").json()["id"])
    assert tell_teams(api.database) == 0
    closes_in(api, timedelta(hours=3))
    changed = api.request("PATCH", f"/contacts/{contact_id}", "alpha", json={"wishes": []})
    assert changed.json()["wishes"] == []
    assert tell_teams(api.database) == 0
    api.request("PATCH", f"/contacts/{contact_id}", "alpha", json={"wishes": ["phase_ends"]})
    assert tell_teams(api.database) == 1
    assert kinds(api)[-1] == "phase_ends"


def closes_in(api: "Api", time: timedelta, phase_id: str = "dev", **more: Any) -> None:
    with api.database.write() as session:
        phase = session.get_one(Phase, phase_id)
        phase.closes_at = (database_now(session) + time).replace(second=1)
        for name, value in more.items():
            setattr(phase, name, value)


def test_the_end_of_a_phase_is_told_to_who_takes_part_once_and_again_when_it_is_moved(
    api: "Api", browse: Browse
) -> None:
    """Who was told a deadline that is none any more must not rely on it."""
    confirmed(api, browse, "phase_ends")
    confirmed(api, browse, "phase_ends", who="beta")
    api.score(api.submit("a").json()["id"])
    closes_in(api, timedelta(hours=3), title="First words")
    assert tell_teams(api.database) == 1
    assert mails(api)[-1][0] == "alpha@example.org"
    with api.database.write() as session:
        phase = session.get_one(Phase, "dev")
        assert phase.closes_at is not None
        phase.closes_at, phase.title = phase.closes_at.replace(second=2), "Other words"
    assert tell_teams(api.database) == 0
    for minutes in (-90, 90):
        next_moment(api.database)
        with api.database.write() as session:
            phase = session.get_one(Phase, "dev")
            assert phase.closes_at is not None
            phase.closes_at = moved = phase.closes_at + timedelta(minutes=minutes, seconds=60)
        assert (tell_teams(api.database), tell_teams(api.database)) == (1, 0)
        assert told_deadlines(api) == {"alpha": f"Its deadline is {moved:%Y-%m-%d %H:%M} UTC"}


def test_a_team_with_a_deadline_of_its_own_is_told_that_one_unless_it_has_ended(
    api: "Api", browse: Browse
) -> None:
    for who in ("alpha", "beta"):
        confirmed(api, browse, "phase_ends", who=who)
        api.submit("a", who)
    closes_in(api, timedelta(hours=3))
    with api.database.write() as session:
        phase = session.get_one(Phase, "dev")
        assert phase.closes_at is not None
        shared, own = phase.closes_at, phase.closes_at + timedelta(hours=30)
        set_allowance(session, "alpha", "dev", closes_at=own, reason="ill", actor="test")
    assert tell_teams(api.database) == 1
    assert told_deadlines(api) == {"beta": f"Its deadline is {shared:%Y-%m-%d %H:%M} UTC"}
    closes_in(api, -timedelta(hours=10))
    assert tell_teams(api.database) == 0, "alpha has more than a day"
    with api.database.write() as session:
        granted = session.get_one(Allowance, (api.team_ids["alpha"], "dev"))
        granted.closes_at = own = own - timedelta(hours=20)
    hidden: Any = {"policy": PhasePolicy(frozen_scores="hidden"), "unfrozen_at": shared}
    closes_in(api, -timedelta(hours=10), **hidden)
    assert tell_teams(api.database) == 0, "what was kept back is revealed"
    closes_in(api, -timedelta(hours=10), unfrozen_at=None)
    assert tell_teams(api.database) == 1
    words = f"Your team's own deadline is {own:%Y-%m-%d %H:%M} UTC"
    assert told_deadlines(api)["alpha"] == words


@pytest.mark.parametrize("phase", [None, "dev"])
def test_the_end_of_a_phase_is_not_told_to_a_team_that_is_disqualified_there(
    api: "Api", browse: Browse, phase: str | None
) -> None:
    confirmed(api, browse, "phase_ends")
    api.score(api.submit("a").json()["id"])
    closes_in(api, timedelta(hours=3))
    why: dict[str, Any] = {"reason": "copied", "actor": "test"}
    with api.database.write() as session:
        row = disqualify_team(session, "alpha", phase_id=phase, **why).id
    assert tell_teams(api.database) == 0
    with api.database.write() as session:
        reinstate(session, row, **why)
    assert tell_teams(api.database) == 1


def told_deadlines(api: "Api") -> dict[str, str]:
    """By team, the last one that it was told."""
    told = [(address, notice) for address, notice in mails(api) if notice.kind == "phase_ends"]
    return {who.split("@")[0]: notice.what_changed[0].split(";")[0] for who, notice in told}


@pytest.mark.parametrize("visibility", ["hidden", "archived"])
def test_nobody_is_told_of_a_phase_that_is_not_shown(
    api: "Api", browse: Browse, make_entry: Callable[..., Any], visibility: str
) -> None:
    confirmed(api, browse, "phase_ends", "overtaken")
    one, other = api.submit("a").json()["id"], api.submit("b", "beta").json()["id"]
    api.publish(make_entry("Planner", submission_id=one, rank=1))
    passed = make_entry("Planner", submission_id=one, rank=2)
    api.publish(make_entry("Other", submission_id=other, rank=1), passed)
    closes_in(api, timedelta(hours=3), visibility=visibility)
    assert tell_teams(api.database) == 0
    closes_in(api, timedelta(hours=3), visibility="shown")
    assert tell_teams(api.database) == 2


def test_subscriptions_that_stay_as_they_are_leave_no_audit_line(api: "Api") -> None:
    """Else a team fills the log, which nobody shortens, with a loop."""
    path = f"/contacts/{add(api, 'scored')['id']}"
    lines = [api.last_line().id]
    for wishes in (["scored"], ["scored", "scored"], ["updates"], ["updates"]):
        assert api.request("PATCH", path, "alpha", json={"wishes": wishes}).status_code == 200
        lines.append(api.last_line().id)
    assert [line - lines[0] for line in lines] == [0, 0, 0, 1, 1]


def test_who_is_not_approved_lets_the_site_write_to_nobody(api: "Api") -> None:
    """A stranger would choose the address, and in the team's name the words."""
    with api.database.write() as session:
        _, _, team = register_team(session, "gamma", "Log in at evil.example", "We are new.")
        with pytest.raises(NotAllowed, match="not approved yet"):
            add_contact(session, team.id, Channel.EMAIL, "you@example.org", actor="test")
    assert mails(api) == []


def test_another_teams_address_is_not_found(api: "Api", as_problem: Problem) -> None:
    contact = add(api)
    change = {"wishes": ["scored"]}
    as_problem(
        api.request("PATCH", f"/contacts/{contact['id']}", "beta", json=change), 404, "not_found"
    )
    wrong = api.request("PATCH", f"/contacts/{contact['id']}", "alpha", json={"wishes": ["all"]})
    as_problem(wrong, 400, "bad_request")


def test_all_messages_are_marked_as_read_however_many_there_are(api: "Api", browse: Browse) -> None:
    with api.database.write() as session:
        for slug, count in (("alpha", 120), ("beta", 1)):
            for number in range(count):
                tell_team(session, find_team(session, slug), "message", f"Note {number}", ())
    browser = browse(api, who="alpha")
    assert browser.post("/my/notices/read", {}, page="/my/notices").status_code == 303
    assert api.get("/notifications?unread=true", "alpha").json() == []
    assert "Mark all as read" not in browser.get("/my/notices").text
    assert len(api.get("/notifications?unread=true", "beta").json()) == 1


def test_every_message_is_found_however_many_there_are(
    api: "Api", browse: Browse, as_problem: Problem
) -> None:
    with api.database.write() as session:
        alpha, beta = (find_team(session, slug) for slug in ("alpha", "beta"))
        for number in range(120):  # all of one moment
            tell_team(session, alpha, "message", f"Note {number}.", ())
        other = tell_team(session, beta, "message", "Not theirs.", ())
    browser = browse(api)
    browser.sign_in("alpha")
    assert "Notices (120 new)" in browser.get("/my").text
    found, sizes, page = set[str](), list[int](), "/my/notices"
    while page:
        text = browser.get(page).text
        sizes.append(len(titles := re.findall(r"<h3>(Note \d+\.)</h3>", text)))
        found.update(titles)
        older = re.search(r'href="(/my/notices\?after=\w+)">Older notices', text)
        page = older[1] if older else ""
    assert (sizes, len(found)) == ([50, 50, 20], 120)
    first = api.get("/notifications?limit=100", "alpha").json()
    rest = api.get(f"/notifications?limit=100&after={first[-1]['id']}", "alpha").json()
    assert {one["title"] for one in (*first, *rest)} == found
    as_problem(api.get(f"/notifications?after={other.id}", "alpha"), 400, "bad_request")


def test_the_page_shows_inbox_and_addresses(api: "Api", browse: Browse) -> None:
    browser = browse(api, who="alpha")
    page = "/my/notices"
    assert "Nothing yet" in browser.get(page).text
    sent = browser.post(
        f"{page}/add", {"address": "a@example.org", "wishes": ["scored", "failed"]}, page=page
    )
    assert sent.status_code == 303
    text = browser.get(page).text
    assert "waits for a yes" in text
    assert "<small>newest message waiting</small>" in text
    (contact,) = api.get("/contacts", "alpha").json()
    assert contact["wishes"] == ["scored", "failed"]
    saved = browser.post(f"{page}/{contact['id']}/wishes", {"wishes": "overtaken"}, page=page)
    assert saved.status_code == 303
    assert api.get("/contacts", "alpha").json()[0]["wishes"] == ["overtaken"]
    refused = browser.post(f"{page}/add", {"address": "nobody"}, page=page)
    assert refused.status_code == 400
    assert "is not an e-mail address" in refused.text
    hook = browser.post(f"{page}/add", {"address": "https://hooks.example.org/x"}, page=page)
    assert re.search(r"edw_[A-Za-z0-9_-]{43}", hook.text), "its secret is shown this once"
    assert "edw_" not in browser.get(page).text
    browser.post(f"{page}/{contact['id']}/remove", {}, page=page)
    assert len(api.get("/contacts", "alpha").json()) == 1
