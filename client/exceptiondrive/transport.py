"""Requests to the server: token, retries with Retry-After, errors as exceptions."""

from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import stamina
from pydantic import ValidationError

from exceptiondrive.errors import NetworkError
from exceptiondrive.http import httpx
from exceptiondrive.problem_errors import raise_problem, retry_after_s
from exceptiondrive_schemas.problems import Problem, ProblemCode

RETRIED_STATUSES = frozenset({502, 503, 504})
LONGEST_RETRY_AFTER_S = 30.0
"""Who asks to come back later than this is told to the user instead."""

Query = Mapping[str, str | int | None]


class _NotNowError(Exception):
    """The server asked to come back."""

    def __init__(self, response: "httpx.Response") -> None:
        self.response = response
        self.wait_s = retry_after_s(response)


class Transport:
    """Sends requests to one server.

    Args:
        server: Address, without a slash at the end.
        token: Bearer token, or None.
        attempts: How often a request is sent at most.
        timeout_s: Longest time without a byte, per request.
    """

    def __init__(
        self, server: str, token: str | None, *, attempts: int = 5, timeout_s: float = 30.0
    ) -> None:
        self.server = server
        self._attempts = attempts
        headers = {"user-agent": f"exceptiondrive/{version('exceptiondrive')}"}
        if token:
            headers["authorization"] = f"Bearer {token}"
        self._http = httpx.Client(
            base_url=f"{server}/api/v1", headers=headers, timeout=httpx.Timeout(timeout_s)
        )

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def get(
        self, path: str, query: Query | None = None, headers: Mapping[str, str] | None = None
    ) -> "httpx.Response":
        """GET; raises the error of a problem, or `NetworkError`."""
        params = {key: value for key, value in (query or {}).items() if value is not None}
        return self._send(lambda: self._http.get(path, params=params, headers=headers))

    def post(
        self, path: str, body: Callable[[], dict[str, Any]], *, is_repeatable: bool = True
    ) -> "httpx.Response":
        """POST; `body` makes the arguments of each attempt anew, streams included.

        Args:
            path: Below `/api/v1`.
            body: Gives the keyword arguments of one request.
            is_repeatable: Whether the same request twice is as good as once: the server recognises
                the same upload, and withdrawing twice is one.
        """
        return self._send(lambda: self._http.post(path, **body()), is_repeatable)

    def patch(self, path: str, body: Callable[[], dict[str, Any]]) -> "httpx.Response":
        """PATCH; the same change twice is one."""
        return self._send(lambda: self._http.patch(path, **body()))

    def _send(
        self, request: Callable[[], "httpx.Response"], is_repeatable: bool = True
    ) -> "httpx.Response":
        try:
            response = self._with_retries(request, self._attempts if is_repeatable else 1)
        except _NotNowError as not_now:
            response = not_now.response
        except httpx.TransportError as error:
            raise NetworkError(
                "unreachable",
                f"{self.server} cannot be reached: {str(error) or type(error).__name__}.",
                "Check the address (--server) and the network, then run the command again.",
            ) from None
        if not response.is_success:
            raise_problem(response)
        return response

    def _with_retries(
        self, request: Callable[[], "httpx.Response"], attempts: int
    ) -> "httpx.Response":
        for attempt in stamina.retry_context(
            on=_should_retry, attempts=attempts, wait_initial=0.2, wait_max=5.0, timeout=120.0
        ):
            with attempt:
                response = request()
                if response.status_code in RETRIED_STATUSES or _is_too_fast(response):
                    raise _NotNowError(response)
        return response


def _should_retry(error: Exception) -> bool | float:
    """Whether to send again: True for the usual pause, or the seconds that the server asks for."""
    if isinstance(error, httpx.TransportError):
        return not isinstance(error, httpx.UnsupportedProtocol | httpx.LocalProtocolError)
    if not isinstance(error, _NotNowError):
        return False
    if error.wait_s is None:
        return True
    return error.wait_s if error.wait_s <= LONGEST_RETRY_AFTER_S else False


def _is_too_fast(response: "httpx.Response") -> bool:
    """Whether the server wants fewer requests a second; a spent quota is another 429."""
    if response.status_code != 429:
        return False
    try:
        return Problem.read(response.content).code is ProblemCode.TOO_MANY_REQUESTS
    except ValidationError:
        return True
