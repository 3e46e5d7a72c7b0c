"""The network edge: one chat completion from any OpenAI-compatible endpoint.

Retries with back-off and Retry-After are the openai library's (429, 408, 409, 5xx, timeouts, broken
connections); every HTTP request, retries included, waits for its slot. Redirects are not followed:
images go to the address that was given and nowhere else.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Self

import openai

from exceptiondrive.agent.answer_schemas import Schema
from exceptiondrive.agent.completion import Completion, read_completion
from exceptiondrive.agent.dialect import Dialect, ModelSettings, plainer, request_body
from exceptiondrive.agent.errors import (
    AgentError,
    EndpointRefusesError,
    NoAnswerError,
    Reason,
)
from exceptiondrive.agent.pace import Pace
from exceptiondrive.agent.prompts import Message

Sleep = Callable[[float], Awaitable[None]]
_RAW_RESPONSE = "x-stainless-raw-response"  # the library reads it back from the request
_KEY_ADVICE = "Set EXCEPTIONDRIVE_AGENT_KEY or OPENAI_API_KEY."


@dataclass(frozen=True)
class EndpointSettings:
    """Where and how to reach the endpoint."""

    base_url: str
    key: str | None = None
    timeout_s: float = 120.0
    max_retries: int = 5
    requests_per_minute: float | None = None


class Endpoint:
    """A connection pool to one endpoint; use it as an asynchronous context manager."""

    def __init__(
        self, settings: EndpointSettings, model: ModelSettings, sleep: Sleep = asyncio.sleep
    ) -> None:
        self._sleep = sleep
        self._key = settings.key
        self._model = model
        self._pace = Pace(settings.requests_per_minute)
        self._dialect = Dialect()
        self.n_requests = 0
        self._client = openai.AsyncOpenAI(
            base_url=settings.base_url,
            api_key=settings.key or "none",
            timeout=settings.timeout_s,
            max_retries=settings.max_retries,
            http_client=openai.DefaultAsyncHttpxClient(
                follow_redirects=False, event_hooks={"request": [self._before_request]}
            ),
        )

    async def __aenter__(self) -> Self:
        """Return the endpoint."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Close all connections."""
        await self._client.close()

    async def _before_request(self, request: Any) -> None:
        """Wait for a slot, and drop the headers in which the library describes this machine."""
        for name in set(request.headers):
            if name.startswith("x-stainless-") and name != _RAW_RESPONSE:
                del request.headers[name]
        self.n_requests += 1
        await self._sleep(self._pace.reserve(asyncio.get_running_loop().time()))

    async def complete(
        self, messages: list[Message], name: str, schema: Schema
    ) -> tuple[Completion, Dialect]:
        """Ask once, in the plainest dialect that has proved necessary so far.

        Raises:
            NoAnswerError: The endpoint did not answer, refused this request or answered nonsense.
            ExceptionDriveError: No sample can be asked: key, account or model name is refused.
        """
        dialect: Dialect | None = self._dialect
        while dialect is not None:
            body = request_body(self._model, dialect, messages, name, schema)
            try:
                completion = read_completion(await self._post(body))
            except (openai.BadRequestError, openai.UnprocessableEntityError) as error:
                refusal = error
                dialect = plainer(dialect, error.param)
            else:
                self._dialect = dialect
                return completion, dialect
        raise self._refused(refusal) from None

    async def _post(self, body: dict[str, Any]) -> bytes:
        try:
            response = await self._client.chat.completions.with_raw_response.create(
                model=body["model"], messages=body["messages"], extra_body=body
            )
            return bytes(response.content)
        except openai.APITimeoutError:
            raise NoAnswerError(Reason.TIMEOUT, "no answer in time, after retries") from None
        except openai.APIConnectionError as error:
            detail = f"no connection, after retries: {self._clean(str(error.__cause__ or error))}"
            raise NoAnswerError(Reason.CONNECTION, detail) from None
        except (openai.BadRequestError, openai.UnprocessableEntityError):
            raise
        except openai.APIStatusError as error:
            self._stop_if_hopeless(error)
            raise self._refused(error) from None

    def _stop_if_hopeless(self, error: openai.APIStatusError) -> None:
        said = self._clean(error.message)
        if error.status_code == 401:
            raise EndpointRefusesError(f"The endpoint refuses the key: {said}.", _KEY_ADVICE)
        if error.status_code == 402 or error.code == "insufficient_quota":
            raise EndpointRefusesError(f"The endpoint says that the account is used up: {said}.")
        if error.status_code == 404:
            advice = "Correct --base-url or --model."
            raise AgentError(f"The endpoint knows no such address or model: {said}.", advice)

    def _refused(self, error: openai.APIStatusError) -> NoAnswerError:
        reason = Reason.REQUEST_REFUSED
        if error.status_code == 429:
            reason = Reason.RATE_LIMITED
        elif error.status_code in (408, 409) or error.status_code >= 500:
            reason = Reason.SERVER_ERROR
        return NoAnswerError(reason, f"HTTP {error.status_code}: {self._clean(error.message)}")

    def _clean(self, text: str) -> str:
        return (text.replace(self._key, "***") if self._key else text)[:300]
