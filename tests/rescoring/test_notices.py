"""What is sent outside: signed webhooks and e-mail, to real servers on this machine."""

import hashlib
import hmac
import json
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import pytest
from aiosmtpd.controller import Controller
from sqlalchemy import delete, select
from structlog.testing import capture_logs
from tests.support.work import let_time_pass

from exceptiondrive_records.boards.boards import entries_on
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.notifications import channels as webhooks
from exceptiondrive_records.notifications.channels import (
    NotDelivered,
    NoticeSettings,
    allowed_address,
    send_webhook,
)
from exceptiondrive_records.notifications.contacts import (
    _require_webhook,
    add_contact,
    confirm_contact,
    remove_contact,
)
from exceptiondrive_records.notifications.outbox import run_outbox, send_next
from exceptiondrive_records.notifications.public_addresses import is_public
from exceptiondrive_records.notifications.tables import Channel, ContactPoint, Delivery
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work import lease
from exceptiondrive_records.work.lease import new_item
from exceptiondrive_records.work.tables import WorkState

Stage = Any
Ready = tuple[Stage, str]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


@dataclass
class Receiver:
    """A web server that keeps what it is sent, and answers as told."""

    answers: list[int] = field(default_factory=list)
    received: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    url: str = ""


@pytest.fixture
def reachable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets this process call webhooks at 127.0.0.1, and in clear."""
    monkeypatch.setattr(
        webhooks,
        "allowed_address",
        lambda url: url.hostname if url.hostname == "127.0.0.1" else allowed_address(url),
    )


@pytest.fixture
def receiver(reachable: None) -> Iterator[Receiver]:
    kept = Receiver()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            kept.received.append((dict(self.headers), body))
            status = kept.answers.pop(0) if kept.answers else 204
            self.send_response(status)
            if status == 302:
                self.send_header("location", kept.url)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    kept.url = f"http://127.0.0.1:{server.server_port}/hook"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    yield kept
    server.shutdown()
    thread.join()
    server.server_close()


class Mailbox:
    """Keeps what an SMTP server is given."""

    def __init__(self) -> None:
        self.messages: list[tuple[list[str], str]] = []
        self.answer_to_quit = "221 bye"

    async def handle_QUIT(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
        return self.answer_to_quit

    async def handle_DATA(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802
        self.messages.append((envelope.rcpt_tos, envelope.content.decode()))
        return "250 taken"


@pytest.fixture
def mailbox() -> Iterator[tuple[Mailbox, int]]:
    kept = Mailbox()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = Controller(kept, hostname="127.0.0.1", port=port)
    server.start()
    yield kept, port
    server.stop()


def settings(**values: Any) -> NoticeSettings:
    return NoticeSettings(**{"public_url": "https://board.example", **values})


def told(ready: Ready, channel: Channel, address: str) -> str:
    """Apply an update that may be applied, after team Alpha gave an address; return the webhook's secret."""
    stage, run_id = ready
    with stage.database.write() as session:
        contact = add_contact(
            session,
            find_team(session, "alpha").id,
            channel,
            "https://hook.example" if channel is Channel.WEBHOOK else address,
            actor="test",
        )
        contact.address = address
        if channel is Channel.EMAIL:
            confirm_contact(session, contact.id, contact.secret or "")
    with stage.owner.write() as session:
        session.execute(delete(Delivery))  # it asked already
    stage.apply(run_id)
    return contact.secret or ""


def delivery(stage: Stage) -> Delivery:
    with stage.database.read() as session:
        found: Delivery = session.scalars(select(Delivery)).one()
    return found


def test_a_webhook_is_signed_over_time_and_body_and_sent_once(
    ready: Ready, receiver: Receiver
) -> None:
    stage, _ = ready
    secret = told(ready, Channel.WEBHOOK, receiver.url)
    assert send_next(stage.database, settings())
    assert not send_next(stage.database, settings())
    ((headers, body),) = receiver.received
    signed = headers["ExceptionDrive-Timestamp"].encode() + b"." + body
    expected = hmac.new(secret.encode(), signed, hashlib.sha256).hexdigest()
    assert headers["ExceptionDrive-Signature"] == f"sha256={expected}"
    document = json.loads(body)
    assert document["kind"] == "protocol_applied"
    assert document["entries"][0]["old"] != document["entries"][0]["new"]
    assert delivery(stage).outcome.value == "sent"


@pytest.mark.parametrize("status", [429, 500, 503])
def test_a_webhook_that_stumbles_is_tried_again(
    ready: Ready, receiver: Receiver, status: int
) -> None:
    stage, _ = ready
    receiver.answers = [status, 204]
    told(ready, Channel.WEBHOOK, receiver.url)
    send_next(stage.database, settings())
    assert len(receiver.received) == 2
    assert delivery(stage).outcome.value == "sent"


def test_no_log_line_tells_the_address_of_a_webhook(receiver: Receiver) -> None:
    receiver.answers = [503, 503, 500]
    secret_address = f"{receiver.url}/T00/secret"
    with capture_logs() as lines, pytest.raises(NotDelivered, match="answered 500"):
        send_webhook(secret_address, "s", b"{}", 0)
    assert len(receiver.received) == len(lines) + 1 == 3, "each try but the first is in the log"
    assert "secret" not in str(lines)


def test_a_webhook_that_refuses_waits_in_the_outbox_and_is_given_up_in_the_end(
    ready: Ready, receiver: Receiver
) -> None:
    stage, _ = ready
    receiver.answers = [400, 302]
    told(ready, Channel.WEBHOOK, receiver.url)
    patience = settings(delivery_attempts=2, delivery_backoff_s=0.001)
    send_next(stage.database, patience)
    assert delivery(stage).note == "the webhook answered 400"
    while not send_next(stage.database, patience):
        pass
    assert delivery(stage).outcome.value == "given_up"
    assert delivery(stage).note == "the webhook answered 302; it is not followed"
    assert len(receiver.received) == 2


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_where_no_attempt_is_allowed_nothing_is_sent_and_all_of_it_waits(
    ready: Ready, receiver: Receiver
) -> None:
    """As in the drill of a restore: its teams are real."""
    stage, _ = ready
    told(ready, Channel.WEBHOOK, receiver.url)
    run_outbox(stage.database, settings(delivery_attempts=0), threading.Event())
    assert receiver.received == []
    assert delivery(stage).outcome.value == "waiting"
    assert send_next(stage.database, settings())
    assert delivery(stage).outcome.value == "sent"


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_the_statement_that_claims_a_message_is_made_once(ready: Ready, receiver: Receiver) -> None:
    stage, _ = ready
    receiver.answers = [400, 400, 204]
    told(ready, Channel.WEBHOOK, receiver.url)
    made = []
    while delivery(stage).outcome.value != "sent":
        if send_next(stage.database, settings(delivery_backoff_s=0.001)):
            made.append(lease._claim_statement.cache_info().misses)
    assert made == [made[0]] * 3


def test_a_message_whose_sender_dies_each_time_is_given_up(
    ready: Ready,
    receiver: Receiver,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stage, _ = ready
    told(ready, Channel.WEBHOOK, receiver.url)
    patience = settings(delivery_attempts=2)

    def die(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("exceptiondrive_records.notifications.outbox._send", die)
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                send_next(stage.database, patience)
            with stage.owner.write() as session:
                let_time_pass(session, timedelta(hours=1))
    assert send_next(stage.database, patience)
    assert delivery(stage).outcome.value == "given_up"
    assert receiver.received == []


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_nothing_goes_to_an_address_that_was_removed(ready: Ready, receiver: Receiver) -> None:
    stage, _ = ready
    told(ready, Channel.WEBHOOK, receiver.url)
    with stage.database.write() as session:
        team_id = find_team(session, "alpha").id
        removed = delivery(stage).contact_id
        remove_contact(session, team_id, removed, actor="test")
    with stage.database.read() as session:
        kept = session.get_one(ContactPoint, removed)
        assert (kept.address, kept.secret) == ("", None), "both are gone with it"
    assert not send_next(stage.database, settings())
    assert receiver.received == []


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_an_address_that_cannot_be_called_keeps_no_other_message_waiting(
    ready: Ready, receiver: Receiver
) -> None:
    stage, _ = ready
    told(ready, Channel.WEBHOOK, receiver.url)
    with stage.database.write() as session:  # as an earlier release would have kept it
        held = session.scalars(select(Delivery)).one()
        team_id = find_team(session, "alpha").id
        bad = ContactPoint(
            id="bad", team_id=team_id, channel=Channel.WEBHOOK, address="https://a..b/",
            secret="s", created_at=held.available_at,
        )  # fmt: skip
        session.add(bad)
        session.flush()
        bad_one = new_item(
            Delivery, "bad", held.available_at - timedelta(seconds=1),
            notification_id=held.notification_id, contact_id="bad",
        )  # fmt: skip
        session.add(bad_one)
    assert send_next(stage.database, settings())
    assert send_next(stage.database, settings())
    assert len(receiver.received) == 1
    with stage.database.read() as session:
        assert session.get_one(Delivery, bad_one.id).note == "the host of the webhook is unknown"


def test_a_team_whose_webhook_is_slow_keeps_no_other_team_waiting(
    ready: Ready, receiver: Receiver
) -> None:
    stage, _ = ready
    told(ready, Channel.WEBHOOK, receiver.url)
    with stage.database.write() as session:
        first = session.scalars(select(Delivery)).one()
        beta = find_team(session, "beta").id
        contact = add_contact(
            session,
            beta,
            Channel.WEBHOOK,
            "https://hook.example/beta",
            actor="test",
        )
        contact.address = f"{receiver.url}/beta"
        for key, contact_id, wait_s in (("again", first.contact_id, 1), ("beta", contact.id, 2)):
            later = first.available_at + timedelta(seconds=wait_s)
            session.add(
                new_item(
                    Delivery,
                    key,
                    later,
                    notification_id=first.notification_id,
                    contact_id=contact_id,
                )
            )
    with stage.owner.write() as session:
        let_time_pass(session, timedelta(seconds=30))
    assert send_next(stage.database, settings())
    with stage.owner.write() as session:  # as if alpha's receiver had been slow
        session.get_one(Delivery, first.id).took_s = 19.0
    assert send_next(stage.database, settings())
    with stage.database.read() as session:
        states = {each.key: each.outcome for each in session.scalars(select(Delivery))}
    assert states == {first.key: "sent", "beta": "sent", "again": "waiting"}
    assert send_next(stage.database, settings())
    assert len(receiver.received) == 3


@pytest.mark.usefixtures("reachable")
def test_a_receiver_that_answers_letter_by_letter_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhooks, "_LONGEST_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        stop = threading.Event()

        def dawdle() -> None:
            client, _ = listening.accept()
            with client, suppress(OSError):
                while not stop.wait(0.05):
                    client.sendall(b"H")

        thread = threading.Thread(target=dawdle)
        thread.start()
        url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        with pytest.raises(NotDelivered, match=r"longer than 0\.5 s"):
            send_webhook(url, "s", b"{}", 0)
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    "host",
    [
        *("127.0.0.1", "10.0.0.1", "169.254.169.254", "localhost"),
        *("::1", "::ffff:10.0.0.1", "::10.0.0.1", "::ffff:0:10.0.0.1", "2002:a00:1::"),
        *("64:ff9b::10.0.0.1", "64:ff9b:1::8.8.8.8", "fec0::1"),
        *("192.88.99.1", "192.0.0.8", "::ffff:192.88.99.1", "3fff::1", "5f00::1", "4000::1"),
    ],
)
def test_no_webhook_reaches_our_own_network(host: str) -> None:
    with pytest.raises(NotDelivered, match="not public"):
        allowed_address(urlsplit(f"https://{f'[{host}]' if ':' in host else host}/hook"))


@pytest.mark.parametrize("address", ["8.8.8.8", "2606:4700::1", "64:ff9b::8.8.8.8"])
def test_public_addresses_are_public(address: str) -> None:
    assert is_public(address)


def test_no_webhook_goes_out_in_clear() -> None:
    with pytest.raises(NotDelivered, match="https"):
        send_webhook("http://example.org/", "s", b"{}", 0)


@pytest.mark.parametrize(
    ("channel", "address"),
    [
        (Channel.WEBHOOK, "http://example.org/hook"),
        (Channel.WEBHOOK, "http://127.0.0.1/hook"),
        (Channel.WEBHOOK, "https://user:word@example.org/"),
        (Channel.WEBHOOK, "https:///nowhere"),
        (Channel.EMAIL, "nobody"),
        (Channel.EMAIL, "a@b.org\nBcc: c@d.org"),
    ],
)
def test_addresses_that_could_do_harm_are_refused(
    stage: Stage, channel: Channel, address: str
) -> None:
    with stage.database.write() as session:
        team_id = find_team(session, "alpha").id
        with pytest.raises(InvalidRecord):
            add_contact(session, team_id, channel, address, actor="test")


@pytest.mark.parametrize(
    "address",
    [
        "https://a..example.org/hook",
        f"https://{'a' * 64}.example.org/hook",
        "https://ex\u00e4mple.org/hook",
        "https://example.org/\x7fhook",
        "https://127.0.0.1/hook",
        "https://[::ffff:10.0.0.1]/hook",
        "https://localhost/hook",
    ],
)
def test_an_address_that_no_resolver_or_caller_takes_is_refused(address: str) -> None:
    with pytest.raises(InvalidRecord):
        _require_webhook(address)


def test_an_e_mail_says_what_the_board_shows_before_and_after(
    even_stage: Stage, make_protocol: Callable[..., str], mailbox: tuple[Mailbox, int]
) -> None:
    kept, port = mailbox
    run_id = even_stage.ready(make_protocol("1.1", *D_SAFE))
    told((even_stage, run_id), Channel.EMAIL, "alpha@example.org")
    smtp = settings(smtp_host="127.0.0.1", smtp_port=port, smtp_security="none")
    assert send_next(even_stage.database, smtp)
    ((to, text),) = kept.messages
    assert to == ["alpha@example.org"]
    assert "required clearance of task SE1" in text
    with even_stage.database.read() as session:
        phase = session.get_one(Phase, "dev")
        told_changes = find_protocol(session, phase.protocol_digest).changes
        shown = entries_on(session, phase.current_board_id)
    assert told_changes in text.replace("\r\n", "\n")
    for submission_id in even_stage.submitted[:2]:
        entry = shown[submission_id]
        hcc, interval = entry.metrics["hcc"], entry.intervals["hcc"]
        assert hcc is not None
        assert interval is not None
        low, high = interval
        ends = r"\({:.2f} to {:.2f}\)|\({:.0f} to {:.0f}\)".format(*[100 * low, 100 * high] * 2)
        assert re.search(f"HCC {100 * hcc:.2f} % ({ends})", text)
        assert f"now:    rank {entry.rank}" in text
        assert f"https://board.example/submissions/{submission_id}" in text
    assert text.count("before: rank") == 2
    assert "https://board.example/?phase=dev" in text
    assert "https://board.example/history?phase=dev" in text
    assert "before and after: https://board.example/rescoring/" in text
    assert "List-Unsubscribe: <https://board.example/contacts/" in text.replace("\r\n ", " ")
    assert "List-Unsubscribe-Post: List-Unsubscribe=One-Click" in text
    assert "\r\nDate: " in text


def test_a_mail_that_was_taken_is_not_sent_again_whatever_is_answered_to_quit(
    ready: Ready, mailbox: tuple[Mailbox, int]
) -> None:
    stage, _ = ready
    kept, port = mailbox
    kept.answer_to_quit = "421 too many connections"
    told(ready, Channel.EMAIL, "alpha@example.org")
    smtp = settings(smtp_host="127.0.0.1", smtp_port=port, smtp_security="none")
    assert send_next(stage.database, smtp)
    assert (delivery(stage).state, len(kept.messages)) == (WorkState.DONE, 1)


@pytest.mark.parametrize("host", [{}, {"smtp_host": ""}])
def test_without_a_mail_server_the_message_waits(ready: Ready, host: dict[str, str]) -> None:
    stage, _ = ready
    told(ready, Channel.EMAIL, "alpha@example.org")
    send_next(stage.database, settings(**host))
    assert "no SMTP server" in (delivery(stage).note or "")


def test_operators_are_told_that_mail_may_not_go_out_until_one_does(
    ready: Ready, mailbox: tuple[Mailbox, int]
) -> None:
    stage, _ = ready
    _, port = mailbox
    told(ready, Channel.EMAIL, "alpha@example.org")

    def try_with(smtp: NoticeSettings) -> list[str]:
        with stage.owner.write() as session:
            let_time_pass(session, timedelta(hours=2))
        assert send_next(stage.database, smtp)
        with stage.database.read() as session:
            return [one.what for one in troubles(session) if one.code == "mail_not_sent"]

    away = settings(smtp_host="127.0.0.1", smtp_port=1, smtp_security="none")
    assert try_with(away) == [], "one failure is none yet"
    (what,) = try_with(away)
    assert what.startswith("Mail may not be going out: 1 message to 1 address failed")
    assert try_with(settings(smtp_host="127.0.0.1", smtp_port=port, smtp_security="none")) == []
