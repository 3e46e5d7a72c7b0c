"""Webhooks: signed, over https, and never to an address inside our own network."""

import asyncio
import hashlib
import hmac
import socket
from urllib.parse import urlsplit, urlunsplit

import httpx
import stamina

from exceptiondrive_records.notices.public_address import is_public

SIGNATURE_HEADER = "ExceptionDrive-Signature"
TIMESTAMP_HEADER = "ExceptionDrive-Timestamp"
_ATTEMPTS = 3
_TIMEOUT_S = 5.0
_LONGEST_S = 20.0
"""For all attempts together: a receiver that answers letter by letter holds up all others."""


class NotDelivered(Exception):  # noqa: N818 - says what happened
    """The message did not reach its address; the text says why, without quoting an answer."""


def signature(secret: str, timestamp: int, body: bytes) -> str:
    """Return `sha256=` and the hex HMAC-SHA256 of `timestamp`, a full stop, and the body."""
    signed = f"{timestamp}.".encode() + body
    return "sha256=" + hmac.new(secret.encode(), signed, hashlib.sha256).hexdigest()


def allowed_address(host: str, port: int, *, may_be_private: bool) -> str:
    """Return the address to connect to: resolved once, and public.

    Raises:
        NotDelivered: The host is unknown, or one of its addresses is not public.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):  # a name that no resolver takes is a UnicodeError
        raise NotDelivered("the host of the webhook is unknown") from None
    addresses = [str(item[4][0]).split("%")[0] for item in found]
    if not may_be_private and not all(is_public(address) for address in addresses):
        raise NotDelivered("the webhook leads to an address that is not public")
    return addresses[0]


def send_webhook(
    url: str, secret: str, body: bytes, timestamp: int, *, may_be_private: bool
) -> None:
    """Send a signed message, a few times if need be; redirects are not followed.

    Args:
        url: https address; http too where it may be private.
        secret: Of the address.
        body: JSON document.
        timestamp: Unix time, in the signature: old messages cannot be played again.
        may_be_private: Whether an address of our own network is let through: tests only.

    Raises:
        NotDelivered: It did not get there.
    """
    parts = urlsplit(url)
    host = parts.hostname or ""
    if parts.scheme != "https" and not may_be_private:
        raise NotDelivered("the webhook is not an https address")
    port = parts.port or (443 if parts.scheme == "https" else 80)
    address = allowed_address(host, port, may_be_private=may_be_private)
    at = f"[{address}]" if ":" in address else address
    pinned = urlunsplit((parts.scheme, f"{at}:{port}", parts.path or "/", parts.query, ""))
    headers = {
        "Host": parts.netloc,
        "Content-Type": "application/json",
        "User-Agent": "exceptiondrive-webhook",
        TIMESTAMP_HEADER: str(timestamp),
        SIGNATURE_HEADER: signature(secret, timestamp, body),
    }
    try:
        asyncio.run(_post_in_time(pinned, host, headers, body))
    except httpx.HTTPStatusError as error:
        raise NotDelivered(f"the webhook answered {error.response.status_code}") from None
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
            on=_may_help, attempts=_ATTEMPTS, wait_initial=0.2, wait_max=1.0, timeout=15.0
        ):
            with attempt:
                await _post(client, url, host, headers, body)


async def _post(
    client: httpx.AsyncClient, url: str, host: str, headers: dict[str, str], body: bytes
) -> None:
    """POST once; of the answer nothing but its status is read."""
    async with client.stream(
        "POST", url, content=body, headers=headers, extensions={"sni_hostname": host}
    ) as answer:
        if answer.is_redirect:
            raise NotDelivered(f"the webhook answered {answer.status_code}; it is not followed")
        answer.raise_for_status()


def _may_help(error: Exception) -> bool:
    if isinstance(error, httpx.HTTPStatusError):
        return error.response.status_code >= 500 or error.response.status_code == 429
    return isinstance(error, httpx.TransportError)
