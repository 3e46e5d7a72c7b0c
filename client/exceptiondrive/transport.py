"""Requests to the server: token, uploads, retries with Retry-After, errors as exceptions.

The one door to the HTTP library: nothing else in the client imports it.
"""

import io
import math
import random
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from email.utils import parsedate_to_datetime
from functools import partial
from typing import Any, NoReturn, TypeVar
from urllib.parse import quote, urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx
from pydantic import TypeAdapter, ValidationError

from exceptiondrive.credentials import find_server, find_token, is_this_machine
from exceptiondrive.errors import (
    ExceptionDriveError,
    InvalidArgumentError,
    NetworkError,
    NotAllowedError,
    NotFoundError,
    NotSignedInError,
    QuotaError,
    ServerError,
)
from exceptiondrive.version import __version__
from exceptiondrive_schemas.api.problems import Problem, ProblemCode
from exceptiondrive_schemas.base import faults_in
from exceptiondrive_schemas.python310 import UTC, Self

Progress = Callable[[int, int], None]
"""Called with bytes sent and bytes in all."""
OnRetry = Callable[[float], None]
_ADVICE = {
    ProblemCode.NOT_SIGNED_IN: "Run: exceptiondrive login (or set EXCEPTIONDRIVE_TOKEN).",
    ProblemCode.NOT_CONFIRMED: "To have it so, say replace=True.",
    ProblemCode.PHASE_CLOSED: "Run: exceptiondrive phases, to see which are open.",
    ProblemCode.UPLOAD_TOO_LARGE: "Compress the file with gzip; both forms are taken.",
}
_LISTED_BY = {
    "disqualification": "organizer teams disqualified",
    "news": "organizer news list",
    "person": "organizer people list",
    "phase": "phases",
    "protocol": "organizer protocols list",
    "question": "organizer questions list",
    "rescoring run": "organizer rescore status",
    "split": "organizer splits list",
    "submission": "submissions",
    "team": "organizer teams list",
}
"""Which command lists them, by what the server calls one that it does not know."""
_PASSING = (ProblemCode.TOO_MANY_REQUESTS, ProblemCode.STORE_UNAVAILABLE)
_KINDS: dict[int, type[ExceptionDriveError]] = {
    401: NotSignedInError,
    403: NotAllowedError,
    404: NotFoundError,
    409: NotAllowedError,
    429: NetworkError,
}
"""By the status of a problem; else it is the request that is wrong, or from 500 on the server."""
_QUOTA_CODES = (ProblemCode.QUOTA_EXCEEDED, ProblemCode.REJECTED_CAP_EXCEEDED)
RETRIED_STATUSES = frozenset({502, 503, 504})
ATTEMPTS = 5
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 5.0
"""Between two attempts, doubled each time, and up to a second more by chance."""
LONGEST_OF_ALL_RETRIES_S = 120.0
TIMEOUT_S = 30.0
LONGEST_RETRY_AFTER_S = 30.0
"""Who asks to come back later than this is told to the user instead."""
MAX_ANSWER_BYTES = 256_000_000
"""Unpacked: more than any document, where a megabyte can unpack to a gigabyte."""
Query = Mapping[str, str | int | None]
Record = dict[str, Any]
"""A JSON object as the API documents it."""
_RECORD, _RECORDS = TypeAdapter(Record), TypeAdapter(list[Record])
Answer = TypeVar("Answer")


def upload_body(
    name: str,
    data: bytes,
    fields: Mapping[str, str | None],
    key: str,
    on_progress: Progress | None = None,
) -> Callable[[], dict[str, Any]]:
    """Return what gives the arguments of an upload's POST, anew for each attempt.

    Args:
        name: File name, for people who read logs.
        data: The bytes.
        fields: Form fields; those that are None or empty are left out.
        key: Says that all attempts are one upload: sent as `Idempotency-Key`.
        on_progress: Told how far the upload is.
    """
    sendable = name.encode("utf-8", "replace").decode()
    given = {field: value for field, value in fields.items() if value}

    def arguments() -> dict[str, Any]:
        stream = _CountingStream(data, on_progress)
        file = (sendable, stream, "application/octet-stream")
        return {"data": given, "files": {"file": file}, "headers": {"idempotency-key": key}}

    return arguments


class _CountingStream(io.BytesIO):
    """Bytes that tell how many of them were read."""

    def __init__(self, data: bytes, on_progress: Progress | None) -> None:
        super().__init__(data)
        self._size = len(data)
        self._on_progress = on_progress

    def read(self, size: int | None = -1, /) -> bytes:
        chunk = super().read(size)
        if self._on_progress is not None:
            self._on_progress(self.tell(), self._size)
        return chunk


def _read_body(
    packed: httpx.Response, on_progress: Progress | None, max_bytes: int
) -> httpx.Response:
    """Return an answer with its body, unpacked, which has an end; tell how much of it has come."""
    size, body = int(packed.headers.get("content-length", 0)), bytearray()
    for part in packed.iter_bytes():
        body += part
        if len(body) > max_bytes:
            raise ServerError(
                "answer_too_large",
                f"The server answered {packed.url.path} with more than {max_bytes:,} bytes.",
                "Check the address of the server, and tell the organizers.",
            )
        if on_progress is not None and packed.is_success:
            on_progress(packed.num_bytes_downloaded, size)
    headers, request = packed.headers, packed.request
    headers.pop("content-encoding", None)
    whole = httpx.Response(
        packed.status_code, headers=headers, content=bytes(body), request=request
    )
    whole.next_request = packed.next_request
    return whole


def _said_at(response: httpx.Response) -> datetime | None:
    """Return when the server answered, by its own clock; that of this machine may be wrong."""
    try:
        return parsedate_to_datetime(response.headers["date"]).replace(tzinfo=UTC)
    except (KeyError, ValueError, OverflowError):
        return None


def error_of(problem: Problem, wait_s: float | None = None) -> ExceptionDriveError:
    """Return the error for a problem document.

    Args:
        problem: What the server said.
        wait_s: Seconds of its Retry-After header.
    """
    if problem.code in _QUOTA_CODES:
        return QuotaError(problem.code.value, problem.detail, problem.resets_at)
    usual = InvalidArgumentError if problem.status < 500 else ServerError
    kind = _KINDS.get(problem.status, usual)
    advice = _advice_on(problem, wait_s)
    if kind is InvalidArgumentError or problem.code is ProblemCode.NOT_CONFIRMED:
        sentence = " ".join([problem.detail, *(f"{k}: {v}" for k, v in problem.fields.items())])
        return InvalidArgumentError(problem.code.value, sentence, advice, problem.fields)
    return kind(problem.code.value, problem.detail, advice)


def _advice_on(problem: Problem, wait_s: float | None) -> str:
    if problem.code not in list(ProblemCode):
        return "The newest client, from the page /client/ of the server, may know what to do."
    if problem.code in _PASSING:
        return _again_in(wait_s)
    is_ours = problem.code is ProblemCode.INTERNAL
    if is_ours and problem.request_id and problem.request_id not in problem.detail:
        return f"Tell the organizers this request id: {problem.request_id}."
    unknown = problem.detail.removeprefix("There is no ").partition(" '")[0]
    if problem.code is ProblemCode.NOT_FOUND and unknown in _LISTED_BY:
        return f"`exceptiondrive {_LISTED_BY[unknown]}` lists what there is."
    return _ADVICE.get(problem.code, "")


def retry_after_s(response: httpx.Response) -> float | None:
    """Return the seconds of a Retry-After header, or None."""
    value = response.headers.get("retry-after", "")
    return min(float(value), 1e9) if value.isascii() and value.isdigit() else None


def _again_in(wait_s: float | None) -> str:
    """Say when to run a command again; what is asked for longer than the client waits, exactly."""
    if wait_s is None or wait_s <= LONGEST_RETRY_AFTER_S:
        return "Wait a little and run the same command again."
    length = f"{wait_s:g} s" if wait_s < 180 else f"{math.ceil(wait_s / 60)} minutes"
    return f"Run the same command again in {length}, as the server asks."


def _unknown_answer(response: httpx.Response) -> ExceptionDriveError:
    """Return the error for an answer in another form, such as that of a proxy on the way."""
    answered = f"{response.url.copy_with(query=None)} answered {response.status_code}"
    again = _again_in(retry_after_s(response))
    if response.next_request is not None:
        leads_to = response.next_request.url.copy_with(query=None)
        return ServerError(
            "unexpected_answer",
            f"{answered}, which leads to {leads_to}; the client follows nowhere with a token.",
            "Check the address of the server, http or https too (--server, EXCEPTIONDRIVE_SERVER), "
            "and that no page of the network asks to sign in first.",
        )
    match response.status_code:
        case 413:
            code = ProblemCode.UPLOAD_TOO_LARGE
            return InvalidArgumentError(
                code.value, f"{answered}: a proxy on the way takes no file so large.", _ADVICE[code]
            )
        case 429:
            code = ProblemCode.TOO_MANY_REQUESTS
            return NetworkError(
                code.value, f"{answered}: a proxy on the way wants fewer requests.", again
            )
        case 502 | 503 | 504:
            return ServerError(
                ProblemCode.STORE_UNAVAILABLE.value,
                f"{answered}: no server behind this address answers right now.",
                f"{again} A file that is sent twice counts once.",
            )
    return ServerError(
        "unexpected_answer",
        f"{answered}, and not in the form of an ExceptionDrive server.",
        "Check the address of the server, that no page of the network asks to sign in first, and "
        "that this client is as new as the server.",
    )


def trusts_nobody() -> ssl.SSLContext:
    """Return what takes no certificate, for who speaks in the clear: to read those of all takes 25 ms."""
    return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


def _through_proxy(server: str) -> str:
    """Name the proxy of the environment that stands between, without its password."""
    parts, proxies = urlsplit(server), getproxies()
    proxy = proxies.get(parts.scheme) or proxies.get("all")
    if not proxy or proxy_bypass(parts.netloc):
        return ""
    return f" through the proxy {proxy.rpartition('@')[2].rpartition('//')[2].rstrip('/')}"


def _require_sendable(attempts: object, timeout_s: object) -> None:
    """Refuse numbers with which no request would ever be sent.

    Raises:
        InvalidArgumentError: They are such, or no numbers.
    """
    if not (isinstance(attempts, int) and attempts >= 1):
        words = f"attempts is a whole number from 1 on, the first counts too, not {attempts!r}."
        raise InvalidArgumentError("wrong_argument", words)
    if not (isinstance(timeout_s, int | float) and timeout_s > 0):
        words = f"timeout_s is a number of seconds above 0, not {timeout_s!r}."
        raise InvalidArgumentError("wrong_argument", words)


class Transport:
    """Sends requests to one server, whose address has no slash at the end.

    Its arguments are those of `Client`; without a token none is sent.
    """

    def __init__(
        self,
        server: str,
        token: str | None,
        *,
        attempts: int = ATTEMPTS,
        timeout_s: float = TIMEOUT_S,
        on_retry: OnRetry | None = None,
    ) -> None:
        _require_sendable(attempts, timeout_s)
        self.server = server
        self._on_retry = on_retry or (lambda _: None)
        self._attempts = attempts
        self.said_at: datetime | None = None
        """When the server answered last, by its own clock."""
        self._gives_up = threading.Event()
        headers = {"user-agent": f"exceptiondrive/{__version__}"}
        if token:
            token = str(token).strip()  # of a file it comes with the end of its line
            if not (token.isascii() and token.isprintable()):
                raise InvalidArgumentError(
                    "wrong_token",
                    "This is no token: it has signs that none has.",
                    "Run: exceptiondrive login (or set EXCEPTIONDRIVE_TOKEN).",
                )
            headers["authorization"] = f"Bearer {token}"
        try:
            self._http = httpx.Client(
                base_url=f"{server}/api/v1",
                headers=headers,
                timeout=httpx.Timeout(timeout_s),
                verify=True if server.startswith("https:") else trusts_nobody(),
            )
        except (ImportError, OSError, ValueError, httpx.InvalidURL) as error:
            raise InvalidArgumentError(
                "wrong_environment",
                f"What the environment says of the network cannot be used: {str(error).rstrip('.')}.",
                "Look at HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, SSL_CERT_FILE and SSL_CERT_DIR.",
            ) from None

    def give_up(self) -> None:
        """Let nobody wait for a further attempt: a request under way has this one, and one more at once."""
        self._gives_up.set()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def get(
        self,
        path: str,
        query: Query | None = None,
        on_progress: Progress | None = None,
        max_bytes: int = MAX_ANSWER_BYTES,
    ) -> httpx.Response:
        """GET; raises the error of a problem, `NetworkError`, or `ServerError` of an endless answer.

        Args:
            path: Below `/api/v1`.
            query: Of the address; what is None is left out.
            on_progress: Called with bytes come and bytes in all, 0 where that is not known.
            max_bytes: Of the answer, unpacked.
        """
        params = {key: value for key, value in (query or {}).items() if value is not None}
        return self._send_once(
            "GET", path, lambda: {"params": params}, True, on_progress, max_bytes
        )

    def post(
        self, path: str, body: Callable[[], dict[str, Any]], is_repeatable: bool = True
    ) -> httpx.Response:
        """POST; `body` makes the arguments of each attempt anew, streams included.

        Args:
            path: Below `/api/v1`.
            body: Gives the keyword arguments of one request.
            is_repeatable: Whether the same request twice is as good as once: the server recognises
                the same upload, and withdrawing twice is one.
        """
        return self._send_once("POST", path, body, is_repeatable)

    def post_once(
        self, path: str, document: Mapping[str, Any], *, with_none: bool = False
    ) -> Record:
        """POST a JSON object without a second attempt: what is made twice would be two.

        Members that are None are left out, unless None says something.
        """
        told = document.items()
        body = {"json": {key: value for key, value in told if with_none or value is not None}}
        return read_answer(_RECORD.validate_json, self.post(path, lambda: dict(body), False))

    def post_toml(self, path: str, toml: str, query: Query | None = None) -> Record:
        """POST a TOML document; the same document twice is one."""
        params = {key: value for key, value in (query or {}).items() if value is not None}
        headers = {"content-type": "application/toml"}
        body = {"content": toml.encode(), "headers": headers, "params": params}
        return read_answer(_RECORD.validate_json, self.post(path, lambda: dict(body)))

    def patch(self, path: str, changes: Mapping[str, Any]) -> Record:
        """PATCH; the same change twice is one."""
        return read_answer(_RECORD.validate_json, self.send_patch(path, changes))

    def send_patch(self, path: str, changes: Mapping[str, Any]) -> httpx.Response:
        """PATCH as `patch` does; return the answer unread."""
        return self._send_once("PATCH", path, lambda: {"json": dict(changes)})

    def record(self, path: str, query: Query | None = None) -> Record:
        """GET one JSON object."""
        return read_answer(_RECORD.validate_json, self.get(path, query))

    def records(self, path: str, query: Query | None = None) -> list[Record]:
        """GET a list of JSON objects."""
        return read_answer(_RECORDS.validate_json, self.get(path, query))

    def _send_once(
        self,
        method: str,
        path: str,
        arguments: Callable[[], dict[str, Any]],
        is_repeatable: bool = True,
        on_progress: Progress | None = None,
        max_bytes: int = MAX_ANSWER_BYTES,
    ) -> httpx.Response:
        def request() -> httpx.Response:
            with self._http.stream(method, path, **arguments()) as packed:
                return _read_body(packed, on_progress, max_bytes)

        if self._http.is_closed:
            raise InvalidArgumentError(
                "client_closed",
                "This client was closed.",
                "Stay within its `with`, or make another.",
            )
        try:
            response = self._with_retries(request, self._attempts if is_repeatable else 1)
        except httpx.RequestError as error:
            through = _through_proxy(self.server)
            proxy = "the proxy (HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, NO_PROXY), " if through else ""
            raise NetworkError(
                "unreachable",
                f"{self.server} cannot be reached{through}: "
                f"{(str(error) or type(error).__name__).rstrip('.')}.",
                f"Check {proxy}the address (--server) and the network, then run the command again.",
            ) from None
        except (TypeError, ValueError, httpx.InvalidURL) as error:
            advice = (
                "Signs beyond ASCII are read where Python takes text as UTF-8: set PYTHONUTF8=1."
                if isinstance(error, UnicodeError)
                else ""
            )
            raise InvalidArgumentError(
                "wrong_argument", f"An argument cannot be sent: {error}.", advice
            ) from error
        self.said_at = _said_at(response)
        if not response.is_success:
            raise self._refusal(response)
        if response.headers.get("content-type", "").startswith("text/html"):
            raise _unknown_answer(response)
        return response

    def _refusal(self, response: httpx.Response) -> ExceptionDriveError:
        """Return the error of an answer; where nothing is found, name an address that has a path."""
        try:
            error = error_of(Problem.read(response.content), retry_after_s(response))
        except ValidationError:
            error = _unknown_answer(response)
        path = urlsplit(self.server).path
        if path and isinstance(error, NotFoundError):
            advice = (
                f"Asked was {response.request.url}: if {path} is too much in the address of the "
                "server, leave it out (--server, EXCEPTIONDRIVE_SERVER, `exceptiondrive config`)."
            )
            return NotFoundError(error.code, error.sentence, advice)
        return error

    def _with_retries(self, request: Callable[[], httpx.Response], attempts: int) -> httpx.Response:
        """Send again after a fault of the network, and where the server asks to come back soon."""
        ends_at = time.monotonic() + LONGEST_OF_ALL_RETRIES_S
        for attempt in range(1, attempts + 1):
            is_late = time.monotonic() > ends_at or self._gives_up.is_set()
            is_last = attempt == attempts or is_late
            pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2 ** (attempt - 1)) + random.random()
            try:
                response = request()
                if is_last or not _is_not_now(response):
                    return response
                asked_s = retry_after_s(response)
                if asked_s is not None:
                    if asked_s > LONGEST_RETRY_AFTER_S:
                        return response
                    pause_s = asked_s
            except (httpx.UnsupportedProtocol, httpx.LocalProtocolError):
                raise
            except httpx.RequestError:  # on the way, or in an answer that was damaged there
                if is_last:
                    raise
            self._on_retry(pause_s)
            self._gives_up.wait(pause_s)
        raise AssertionError("the last attempt returns or raises")


def _is_not_now(response: httpx.Response) -> bool:
    """Whether the server wants to be asked again later; a spent quota is another 429."""
    if response.status_code != 429:
        return response.status_code in RETRIED_STATUSES
    try:
        return Problem.read(response.content).code not in _QUOTA_CODES
    except ValidationError:
        return True


def read_answer(read: Callable[[bytes], Answer], response: httpx.Response) -> Answer:
    """Return what an answer says.

    Raises:
        ServerError: It is not in a form that this client knows.
    """
    try:
        return read(response.content)
    except ValidationError as error:
        raise ServerError(
            "unexpected_answer",
            f"The server answered {response.url.path} in a form that this client does not know "
            f"({faults_in(error)[0]}).",
            "Install the newest client, from the page /client/ of the server.",
        ) from None


class Connection:
    """Speaks to one server; use it as a context manager. Its arguments are those of `Client`."""

    def __init__(
        self,
        server: str | None = None,
        token: str | None = None,
        *,
        attempts: int = ATTEMPTS,
        timeout_s: float = TIMEOUT_S,
        on_retry: OnRetry | None = None,
    ) -> None:
        self.server = find_server(server)
        self._transport = Transport(
            self.server,
            token or find_token(self.server),
            attempts=attempts,
            timeout_s=timeout_s,
            on_retry=on_retry,
        )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.server}>"

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied, with a token and open connections.

        Raises:
            InvalidArgumentError: Always.
        """
        raise InvalidArgumentError(
            "not_pickled",
            f"A {type(self).__name__} holds a token and open connections, and is not pickled.",
            "Make one in each process, and hand over ids or views of submissions.",
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def page_url(self, submission_id: str) -> str:
        """Address of the page of a submission, from upload to rank, for members of its team."""
        return f"{self.server}/submissions/{quoted(submission_id)}"

    def id_of(self, submission: str) -> str:
        """Return the id of a submission, of the address of its page too.

        Raises:
            InvalidArgumentError: The address is of another server, or no address of a submission.
        """
        if "://" not in require_text(submission, "The id of a submission"):
            return submission.strip()
        address = submission.strip().partition("?")[0].partition("#")[0].rstrip("/")
        *_, noun, found = address.split("/")
        if noun not in ("submissions", "entries"):
            raise InvalidArgumentError(
                "wrong_address",
                f"{submission} is not the address of a submission.",
                f"It is like {self.page_url('ID')}.",
            )
        if not address.startswith(f"{self.server}/"):
            raise InvalidArgumentError(
                "wrong_server",
                f"{submission} is not at {self.server}.",
                "Say which server: --server URL",
            )
        return found


@contextmanager
def open_link(url: str, from_byte: int = 0) -> Iterator[tuple[Iterator[bytes], int]]:
    """GET an address that an organizer named, as a stranger: no token, no cookie, never in the clear.

    Args:
        url: https; http to this very machine alone. The same holds of what it redirects to, which is
            this machine only where `url` is.
        from_byte: Ask for what begins there; a server that knows no ranges gives all of it.

    Yields:
        The bytes, and where among all of them they begin.

    Raises:
        InvalidArgumentError: The address, or one that it leads to, may not be followed.
        NetworkError: It cannot be had, or breaks off.
    """
    headers = {"accept-encoding": "identity"}
    if from_byte:
        headers["range"] = f"bytes={from_byte}-"
    look: Callable[..., None] = partial(require_private_link, may_be_here=is_here(url))
    hooks = {"request": [look]}
    try:
        with (
            httpx.Client(follow_redirects=True, timeout=TIMEOUT_S, event_hooks=hooks) as http,
            http.stream("GET", url, headers=headers) as response,
        ):
            if not response.is_success:
                raise NetworkError(
                    "unreachable", f"{response.url} answered {response.status_code}."
                )
            # as it comes: what a break leaves is kept
            yield response.iter_raw(), _first_byte(response)
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise NetworkError(
            "unreachable", f"{url} cannot be had: {str(error) or type(error).__name__}."
        ) from None


def is_here(url: str | httpx.URL) -> bool:
    """Whether an address is one of this very machine.

    Raises:
        InvalidArgumentError: It is no address.
    """
    try:
        return is_this_machine(httpx.URL(url).host)
    except httpx.InvalidURL:
        raise InvalidArgumentError("wrong_link", f"{url} is no address.") from None


def require_private_link(request: httpx.Request, *, may_be_here: bool) -> None:
    """Refuse an address in the clear, and one of this machine where a stranger's list leads to it.

    Raises:
        InvalidArgumentError: It is one.
    """
    here = is_here(request.url)
    if here and not may_be_here:
        raise InvalidArgumentError("wrong_link", f"{request.url} leads to this very machine.")
    if request.url.scheme != "https" and not (request.url.scheme == "http" and here):
        raise InvalidArgumentError("wrong_link", f"{request.url} is not an https address.")


def _first_byte(response: httpx.Response) -> int:
    """Return where an answer begins, by its Content-Range."""
    if response.status_code != 206:
        return 0
    given = response.headers.get("content-range", "").removeprefix("bytes ").partition("-")[0]
    return int(given) if given.isascii() and given.isdigit() else -1


def quoted(name: str) -> str:
    """Return a name as one part of a path, whatever it holds.

    Raises:
        InvalidArgumentError: It is no text, or an empty one.
    """
    if not require_text(name):
        raise InvalidArgumentError("wrong_argument", "A name or id is empty.")
    return quote(name, safe="")


def require_text(value: object, what: str = "A name or id") -> str:
    """Return a text that was given.

    Raises:
        InvalidArgumentError: It is something else.
    """
    if isinstance(value, str):
        return value
    raise InvalidArgumentError("wrong_argument", f"{what} is a text, not {type(value).__name__}.")
