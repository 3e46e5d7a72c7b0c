"""Send webhooks, signed and over https, never to an address in our own network; and e-mail."""

import asyncio
import hashlib
import hmac
import smtplib
import socket
import ssl
from contextlib import closing, suppress
from email.message import EmailMessage
from email.policy import default
from typing import Annotated, Literal
from urllib.parse import SplitResult, urlsplit

import httpx
import stamina
from pydantic import Field, SecretStr

from exceptiondrive_records.db.settings import RecordsSettings, Seconds, SiteUrl, matching
from exceptiondrive_records.notifications.public_addresses import is_public
from exceptiondrive_schemas.api.notifications import ChangedEntry, NotificationView
from exceptiondrive_schemas.api.rescoring import page_of
from exceptiondrive_schemas.api.standing_words import standing_words
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.printable import one_line

# Settings of external messages; only the reconciler's process reads them.


class NoticeSettings(RecordsSettings):
    """Environment variables with the prefix `EXCEPTIONDRIVE_`."""

    public_url: SiteUrl = "http://127.0.0.1:8000"
    smtp_host: str = ""
    """If empty, no e-mail is sent; inbox and webhooks still work."""
    smtp_port: Annotated[int, Field(ge=1, le=65535)] = 587
    smtp_security: Literal["starttls", "tls", "none"] = "starttls"
    smtp_user: str = ""
    smtp_password: SecretStr = SecretStr("")
    mail_from: Annotated[
        str,
        matching(
            r"[^<>\r\n]*<[^<>@\s]+@[^<>@\s]+>|[^<>@\s]+@[^<>@\s]+",
            "must be an address, or a name and an address as in The board <no-reply@board.example.org>",
        ),
    ] = "ExceptionDrive <no-reply@localhost>"
    deliver_every_s: Seconds = 1.0
    delivery_attempts: Annotated[int, Field(ge=0, le=100)] = 8
    """If 0, no webhook is called and no e-mail sent: waiting messages go on waiting."""
    delivery_backoff_s: Seconds = 30.0
    """Pause before the second attempt; it doubles with each further one."""


SIGNATURE_HEADER = "ExceptionDrive-Signature"
TIMESTAMP_HEADER = "ExceptionDrive-Timestamp"
_ATTEMPTS = 3
_TIMEOUT_S = 5.0
_LONGEST_S = 20.0
"""Limit for all attempts together: a receiver that answers byte by byte would delay all others."""


class NotDelivered(Exception):  # noqa: N818 - says what happened
    """The message was not delivered; the text says why, without quoting a response."""


class _Stumbled(NotDelivered):
    """A retry may help. An error of httpx would put the address, often a secret, into the log."""


def signature(secret: str, timestamp: int, body: bytes) -> str:
    """Return `sha256=` and the hex HMAC-SHA256 of `timestamp`, a full stop, and the body."""
    signed = f"{timestamp}.".encode() + body
    return "sha256=" + hmac.new(secret.encode(), signed, hashlib.sha256).hexdigest()


def allowed_address(url: SplitResult) -> str:
    """Return the address to connect to: over https, resolved once, and public.

    Raises:
        NotDelivered: It is not https, the host is unknown, or one of its addresses is not public.
    """
    if url.scheme != "https":
        raise NotDelivered("the webhook is not an https address")
    host, port = url.hostname or "", url.port or 443
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):  # a name that cannot be encoded is a UnicodeError
        raise NotDelivered("the host of the webhook is unknown") from None
    addresses = [str(item[4][0]).split("%")[0] for item in found]
    if not all(is_public(address) for address in addresses):
        raise NotDelivered("the webhook leads to an address that is not public")
    return addresses[0]


def send_webhook(url: str, secret: str, body: bytes, timestamp: int) -> None:
    """Send a signed message, with a few retries; redirects are not followed.

    The signature covers the Unix time, so that old messages cannot be replayed.

    Raises:
        NotDelivered: No attempt succeeded.
    """
    parts = urlsplit(url)
    address = allowed_address(parts)
    at = f"[{address}]" if ":" in address else address
    pinned = parts._replace(netloc=f"{at}:{parts.port or 443}", path=parts.path or "/").geturl()
    headers = {
        "Host": parts.netloc,
        "Content-Type": "application/json",
        "User-Agent": "exceptiondrive-webhook",
        TIMESTAMP_HEADER: str(timestamp),
        SIGNATURE_HEADER: signature(secret, timestamp, body),
    }
    try:
        asyncio.run(_post_in_time(pinned, parts.hostname or "", headers, body))
    except TimeoutError:
        raise NotDelivered(f"the webhook took longer than {_LONGEST_S:g} s") from None
    except httpx.HTTPError as error:
        raise NotDelivered(f"the webhook did not answer ({type(error).__name__})") from None
    except (httpx.InvalidURL, ValueError):
        raise NotDelivered("the address of the webhook cannot be called") from None


async def _post_in_time(url: str, host: str, headers: dict[str, str], body: bytes) -> None:
    async with (
        asyncio.timeout(_LONGEST_S),
        httpx.AsyncClient(timeout=_TIMEOUT_S, trust_env=False, follow_redirects=False) as client,
    ):
        async for attempt in stamina.retry_context(
            on=(_Stumbled, httpx.TransportError),
            attempts=_ATTEMPTS,
            wait_initial=0.2,
            wait_max=1.0,
            timeout=15.0,
        ):
            with attempt:
                await _post(client, url, host, headers, body)


async def _post(
    client: httpx.AsyncClient, url: str, host: str, headers: dict[str, str], body: bytes
) -> None:
    """POST once; only the status of the response is read."""
    async with client.stream(
        "POST", url, content=body, headers=headers, extensions={"sni_hostname": host}
    ) as answer:
        if answer.is_redirect:
            raise NotDelivered(f"the webhook answered {answer.status_code}; it is not followed")
        if not answer.is_success:
            may_help = answer.status_code >= 500 or answer.status_code == 429
            refusal = _Stumbled if may_help else NotDelivered
            raise refusal(f"the webhook answered {answer.status_code}")


# E-mail over the SMTP server of the settings.


_MAIL_TIMEOUT_S = 10.0
"""Limit for each reply of the server; one message takes up to a dozen replies."""
_LONG_LINES = default.clone(max_line_length=900)
"""Below the 998 of RFC 5322; shorter lines would fold an address in a header into encoded words."""


def send_email(
    settings: NoticeSettings, to: str, notice: NotificationView, unsubscribe: str
) -> None:
    """Send a notification as plain text.

    `unsubscribe` is the path on the server that ends all mail to `to` with one click.

    Raises:
        NotDelivered: No server is set, or it did not accept the message.
    """
    if not settings.smtp_host:
        raise NotDelivered("no SMTP server is set (EXCEPTIONDRIVE_SMTP_HOST)")
    message = message_of(settings, to, notice, unsubscribe)
    try:
        with closing(_server(settings)) as server:
            if settings.smtp_user:
                server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            server.send_message(message)
            with suppress(OSError):  # it was accepted: a failed QUIT must not cause a retry
                server.quit()
    except (OSError, smtplib.SMTPException) as error:
        raise NotDelivered(f"the mail server did not take it ({type(error).__name__})") from None


def message_of(
    settings: NoticeSettings, to: str, notice: NotificationView, unsubscribe: str
) -> EmailMessage:
    """Return the mail; names of teams and phases cannot inject headers or lines.

    Its headers let mail programs offer to unsubscribe (RFC 2369, with one click RFC 8058).
    """
    leave = f"{settings.public_url.rstrip('/')}{unsubscribe}"
    message = EmailMessage(policy=_LONG_LINES)
    message["Subject"] = one_line(notice.title)
    message["From"] = settings.mail_from
    message["To"] = to
    message["Date"] = notice.created_at  # required by RFC 5322; the same at every attempt
    message["Message-ID"] = f"<{notice.id}@{settings.mail_from.rsplit('@', 1)[-1].rstrip('>')}>"
    message["List-Unsubscribe"] = f"<{leave}>"
    message["List-Unsubscribe-Post"] = "List-Unsubscribe=One-Click"
    message.set_content(
        f"{text_of(notice, settings.public_url)}\n"
        f"No more mail about this team, nor a question of any team: {leave}\n"
    )
    return message


def text_of(notice: NotificationView, site_url: str) -> str:
    """Return the text of the message."""
    if notice.from_protocol is None or notice.to_protocol is None:
        return _plain_text(notice, site_url)
    changes = [f"- {one_line(sentence)}" for sentence in notice.what_changed]
    is_new = notice.from_protocol != notice.to_protocol
    before = f" (before: {notice.from_protocol.version})" if is_new else ""
    site = site_url.rstrip("/")
    challenge = None if notice.challenge is None else CHALLENGES[notice.challenge]
    entries = [line for entry in notice.entries for line in _entry_lines(entry, challenge, site)]
    lines = [
        f"To team {one_line(notice.team)}:",
        "",
        f"{one_line(notice.title)}{before}. What changed:",
        *changes,
        "",
        "Your published numbers:",
        *entries,
        "",
        f"The board: {site}/?phase={notice.phase}",
        f"Every board there was: {site}/history?phase={notice.phase}",
        f"Every entry before and after: {site}{page_of(notice.comparison)}",
    ]
    return "\n".join(lines) + "\n"


def _plain_text(notice: NotificationView, site_url: str) -> str:
    told = [one_line(sentence) for sentence in notice.what_changed]
    address = f"{site_url.rstrip('/')}{notice.comparison}"
    paragraphs = [f"To team {one_line(notice.team)}:", one_line(notice.title), *told, address]
    return "\n\n".join(paragraphs) + "\n"


def _entry_lines(entry: ChangedEntry, challenge: Challenge | None, site: str) -> list[str]:
    return [
        one_line(entry.method),
        f"  before: {standing_words(challenge, entry.old)}",
        f"  now:    {standing_words(challenge, entry.new, before=entry.old)}",
        f"  {site}/submissions/{entry.submission_id}",
    ]


def _server(settings: NoticeSettings) -> smtplib.SMTP:
    where = (settings.smtp_host, settings.smtp_port)
    context = ssl.create_default_context()
    if settings.smtp_security == "tls":
        return smtplib.SMTP_SSL(*where, timeout=_MAIL_TIMEOUT_S, context=context)
    server = smtplib.SMTP(*where, timeout=_MAIL_TIMEOUT_S)
    if settings.smtp_security == "starttls":
        server.starttls(context=context)
    return server
