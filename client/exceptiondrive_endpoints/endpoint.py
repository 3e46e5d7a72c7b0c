"""The network edge: a chat completion, or an edited picture, from an OpenAI-compatible endpoint.

Endpoints differ in structured output and in the name of the token limit: every refusal leads to a
plainer dialect, never back, so asking ends after a few tries. Retries with back-off and Retry-After
are the openai library's (429, 408, 409, 5xx, timeouts, broken connections); every HTTP request,
retries included, waits for its slot. Redirects are not followed: images go to the address that was
given and nowhere else.
"""

import asyncio
import base64
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, TypeVar

import openai
from pydantic import AliasChoices, BaseModel, BeforeValidator, Field, ValidationError, WrapValidator

from exceptiondrive_endpoints.answers import Schema
from exceptiondrive_endpoints.errors import (
    GO_ON,
    EndpointError,
    EndpointRefusesError,
    NoAnswerError,
    Reason,
)
from exceptiondrive_endpoints.images import CleanImage
from exceptiondrive_schemas.python310 import Self, StrEnum

Message = dict[str, Any]
Answer = TypeVar("Answer", "Completion", "EditedPicture")
LONGEST_ANSWER = 10
"""A whole answer may take so many times as long as an endpoint may be silent."""
MAX_ANSWER_BYTES = 256_000_000
"""Unpacked: more than any picture, where a megabyte can unpack to a gigabyte."""
_UNKNOWN_SIGNER = ("self-signed", "self signed", "local issuer")
_HEADERS = frozenset(
    {
        "accept",
        "accept-encoding",
        "authorization",
        "connection",
        "content-length",
        "content-type",
        "host",
        "transfer-encoding",
        "user-agent",
        "x-stainless-raw-response",  # the library reads it back from the request
    }
)
"""What is sent; the library adds what describes this machine, and what the environment sets for OpenAI."""


def text_part(text: str) -> dict[str, Any]:
    """A text within a message."""
    return {"type": "text", "text": text}


def picture_part(image: CleanImage) -> dict[str, Any]:
    """A picture within a message."""
    return {"type": "image_url", "image_url": {"url": image.data_url}}


@dataclass(frozen=True)
class ModelSettings:
    """What is asked of the model beside the messages."""

    model: str
    temperature: float = 0.0
    max_tokens: int = 1000
    extra: dict[str, Any] = field(default_factory=dict)


class Pace:
    """Hands out time slots that lie at least 60 s / `requests_per_minute` apart."""

    def __init__(self, requests_per_minute: float | None) -> None:
        self._interval_s = 60.0 / requests_per_minute if requests_per_minute else 0.0
        self._next_s = float("-inf")

    def reserve(self, now_s: float) -> float:
        """Take the next free slot and return how many seconds away it is, by a clock that never goes back."""
        slot_s = max(now_s, self._next_s)
        self._next_s = slot_s + self._interval_s
        return slot_s - now_s


class AnswerForm(StrEnum):
    """How the answer's form is asked for: by schema, as any JSON object, or in words alone."""

    JSON_SCHEMA = "json_schema"
    JSON_OBJECT = "json_object"
    WORDS = "words"


_PLAINER = {
    AnswerForm.JSON_SCHEMA: AnswerForm.JSON_OBJECT,
    AnswerForm.JSON_OBJECT: AnswerForm.WORDS,
}


@dataclass(frozen=True)
class Dialect:
    """One way of asking."""

    form: AnswerForm = AnswerForm.JSON_SCHEMA
    token_limit: str = "max_tokens"
    sends_temperature: bool = True


def plainer(dialect: Dialect, refused_field: str | None) -> Dialect | None:
    """Return the dialect to try after a refusal, or None when there is none left.

    The endpoint may name the field of the request that it refuses.
    """
    if refused_field == "max_tokens" and dialect.token_limit == "max_tokens":
        return replace(dialect, token_limit="max_completion_tokens")
    if refused_field == "temperature" and dialect.sends_temperature:
        return replace(dialect, sends_temperature=False)
    if dialect.form in _PLAINER:
        return replace(dialect, form=_PLAINER[dialect.form])
    return None


def request_body(
    settings: ModelSettings, dialect: Dialect, messages: list[Message], name: str, schema: Schema
) -> dict[str, Any]:
    """The chat-completions request in one dialect; `extra` fields win over ours."""
    body: dict[str, Any] = {"model": settings.model, "messages": messages}
    body[dialect.token_limit] = settings.max_tokens
    if dialect.sends_temperature:
        body["temperature"] = settings.temperature
    if dialect.form is AnswerForm.JSON_SCHEMA:
        body["response_format"] = {
            "type": "json_schema",
            "json_schema": {"name": name, "strict": True, "schema": schema},
        }
    elif dialect.form is AnswerForm.JSON_OBJECT:
        body["response_format"] = {"type": "json_object"}
    return {**body, **settings.extra}


_Count = Annotated[
    int, Field(ge=0, le=10**9), BeforeValidator(lambda told: 0 if told is None else told)
]


def _alias_choices(chat: str, pictures: str) -> AliasChoices:
    """The name of a count in an answer of chat completions, and in one of `images/edits`."""
    return AliasChoices(f"{chat}_tokens", f"{pictures}_tokens")


class Usage(BaseModel):
    """Tokens that the endpoint says it counted; some say null for none."""

    prompt_tokens: _Count = Field(default=0, validation_alias=_alias_choices("prompt", "input"))
    completion_tokens: _Count = Field(
        default=0, validation_alias=_alias_choices("completion", "output")
    )


class _Message(BaseModel):
    content: str | None = None
    refusal: str | None = None


class _Choice(BaseModel):
    message: _Message
    finish_reason: str | None = None


def _or_none(told: Any, read: Callable[[Any], Usage | None]) -> Usage | None:
    """Counts that cannot be read are as none: they spoil no answer."""
    try:
        return read(told)
    except ValidationError:
        return None


_ToldUsage = Annotated[Usage | None, WrapValidator(_or_none)]


class Completion(BaseModel):
    """The part of a chat completion that we read; whatever else it holds is ignored."""

    name: ClassVar[str] = "chat completion"
    choices: tuple[_Choice, ...]
    usage: _ToldUsage = None
    model: str | None = None

    @property
    def text(self) -> str:
        """The model's whole text.

        Raises:
            NoAnswerError: `refusal`, `filtered`, `truncated`, `empty` or `bad_response`.
        """
        if len(self.choices) != 1:
            detail = f"expected one choice, got {len(self.choices)}"
            raise NoAnswerError(Reason.BAD_RESPONSE, detail)
        choice = self.choices[0]
        content = choice.message.content
        if choice.message.refusal:
            raise NoAnswerError(
                Reason.REFUSAL, "the model refused to answer", choice.message.refusal
            )
        if choice.finish_reason == "content_filter":
            raise NoAnswerError(Reason.FILTERED, "the endpoint's filter cut the answer", content)
        if choice.finish_reason == "length":
            detail = "the answer hit the token limit; raise it"
            raise NoAnswerError(Reason.TRUNCATED, detail, content)
        if content is None or not content.strip():
            raise NoAnswerError(Reason.EMPTY, "the answer is empty")
        return content


class _Picture(BaseModel):
    b64_json: str | None = None
    url: Any = None


class EditedPicture(BaseModel):
    """The part of an answer of `images/edits` that we read."""

    name: ClassVar[str] = "edited picture"
    data: tuple[_Picture, ...]
    usage: _ToldUsage = None

    @property
    def picture(self) -> bytes:
        """The picture's bytes, whatever they are.

        Raises:
            NoAnswerError: `no_picture`: there is none, more than one, or an address instead.
        """
        found = [each.b64_json for each in self.data if each.b64_json]
        if len(found) != 1:
            is_address = not found and any(each.url for each in self.data)
            got = "an address" if is_address else len(found)
            detail = f"expected one picture as base64, got {got}"
            raise NoAnswerError(Reason.NO_PICTURE, detail)
        try:
            return base64.b64decode(found[0], validate=True)
        except ValueError:
            raise NoAnswerError(Reason.NO_PICTURE, "the picture is no base64") from None


def read_answer(form: type[Answer], body: bytes) -> Answer:
    """Return the completion or the edited picture in a response body.

    Raises:
        NoAnswerError: `bad_response`: the body is none.
    """
    try:
        return form.model_validate_json(body)
    except ValidationError:
        raw = body.decode("utf-8", errors="replace")
        raise NoAnswerError(Reason.BAD_RESPONSE, f"the response is no {form.name}", raw) from None


@dataclass(frozen=True)
class EndpointSettings:
    """Where and how to reach the endpoint."""

    base_url: str
    key: str | None = None
    timeout_s: float = 120.0
    max_retries: int = 5
    requests_per_minute: float | None = None
    key_advice: str = ""
    address_advice: str = ""


class _EndlessAnswerError(openai.APITimeoutError):
    """Bytes came, and no end of them; it is not asked again in this run."""


class _Http(openai.DefaultAsyncHttpxClient):
    """Follows no redirect; each request waits for its slot, and each answer is awaited so long."""

    def __init__(self, before: Callable[[Any], Awaitable[None]], longest_s: float) -> None:
        super().__init__(follow_redirects=False)
        self._before = before
        self._longest_s = longest_s

    async def send(self, request: Any, **more: Any) -> Any:
        """Send a request and read the answer.

        Raises:
            _EndlessAnswerError: It did not end in time, or in a size that can be read.
        """
        await self._before(request)
        try:
            return await asyncio.wait_for(self._whole(request, more), self._longest_s)
        except asyncio.TimeoutError:
            raise _EndlessAnswerError(request) from None

    async def _whole(self, request: Any, more: Mapping[str, Any]) -> Any:
        response = await super().send(request, **{**more, "stream": True})
        body = bytearray()
        try:
            async for part in response.aiter_bytes():
                body += part
                if len(body) > MAX_ANSWER_BYTES:
                    raise _EndlessAnswerError(request)
        finally:
            await response.aclose()
        response.headers.pop("content-encoding", None)
        kind, headers = type(response), response.headers
        return kind(response.status_code, headers=headers, content=bytes(body), request=request)


class Endpoint:
    """A connection pool to one endpoint; use it as an asynchronous context manager."""

    def __init__(self, settings: EndpointSettings, model: ModelSettings) -> None:
        self._settings = settings
        self._model = model
        self._pace = Pace(settings.requests_per_minute)
        self._dialect = Dialect()
        self._untaken: tuple[str, ...] = ()
        self.n_requests = 0
        try:
            http = _Http(self._before_request, LONGEST_ANSWER * settings.timeout_s)
        except (ImportError, OSError, ValueError) as error:
            raise EndpointError(
                f"What the environment says of the network cannot be used: {str(error).rstrip('.')}.",
                "Look at HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, SSL_CERT_FILE and SSL_CERT_DIR.",
            ) from None
        self._client = openai.AsyncOpenAI(
            base_url=settings.base_url,
            api_key=settings.key or "none",
            timeout=settings.timeout_s,
            max_retries=settings.max_retries,
            http_client=http,
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._client.close()

    async def _before_request(self, request: Any) -> None:
        """Wait for a slot, and send no header but the usual ones and the key that was given."""
        for name in set(request.headers) - _HEADERS:
            del request.headers[name]
        request.headers["authorization"] = f"Bearer {self._client.api_key}"
        self.n_requests += 1
        await asyncio.sleep(self._pace.reserve(asyncio.get_running_loop().time()))

    async def complete(
        self, messages: list[Message], name: str, schema: Schema
    ) -> tuple[Completion, Dialect]:
        """Ask once, in the plainest dialect that has proved necessary so far.

        Raises:
            NoAnswerError: The endpoint did not answer, refused this request or answered nonsense.
            EndpointError: No sample can be asked: key, account or model name is refused.
        """
        dialect: Dialect | None = self._dialect
        while dialect is not None:
            request = self._client.chat.completions.with_raw_response.create(
                model=self._model.model,
                messages=messages,  # type: ignore[arg-type]
                extra_body=request_body(self._model, dialect, messages, name, schema),
            )
            try:
                completion = self._read(Completion, await self._sent_or_error(request))
            except (openai.BadRequestError, openai.UnprocessableEntityError) as error:
                refusal = error
                dialect = plainer(dialect, error.param)
            else:
                self._dialect = dialect
                return completion, dialect
        raise self._refusal_error(refusal) from None

    async def edit(
        self, image: CleanImage, instruction: str, seed: int | None
    ) -> tuple[EditedPicture, tuple[str, ...]]:
        """Have one picture edited, with a seed if the model takes one.

        Returns:
            The edited picture, and the names of fields that this endpoint does not take.

        Raises:
            NoAnswerError: The endpoint did not answer, refused this request or answered nonsense.
            EndpointError: No picture can be edited: key, account or model name is refused.
        """
        while True:
            fields = {"response_format": "b64_json", "seed": seed, **self._model.extra}
            untaken = self._untaken
            extra = {name: fields[name] for name in fields if name not in untaken}
            request = self._client.images.with_raw_response.edit(
                model=self._model.model,
                image=(f"source.{image.extension}", image.data, image.media_type),
                prompt=instruction,
                extra_body={name: value for name, value in extra.items() if value is not None},
            )
            try:
                return self._read(EditedPicture, await self._sent_or_error(request)), untaken
            except (openai.BadRequestError, openai.UnprocessableEntityError) as error:
                if error.param not in extra:
                    raise self._refusal_error(error) from None
                self._untaken = (*untaken, error.param)

    def _read(self, form: type[Answer], body: bytes) -> Answer:
        try:
            return read_answer(form, body)
        except NoAnswerError as error:
            said = self._without_key(error.raw or "") or "it is empty"
            raise NoAnswerError(error.reason, f"{error.detail}: {said}", error.raw) from None

    async def _sent_or_error(self, request: Awaitable[Any]) -> bytes:
        try:
            return bytes((await request).content)
        except openai.APIConnectionError as error:
            raise self._not_connected(error) from None
        except (openai.BadRequestError, openai.UnprocessableEntityError):
            raise
        except openai.APIStatusError as error:
            self._stop_if_hopeless(error)
            raise self._refusal_error(error) from None

    def _not_connected(self, error: openai.APIConnectionError) -> NoAnswerError:
        cause = error.__cause__ or error
        if isinstance(cause, _EndlessAnswerError):
            longest_s = LONGEST_ANSWER * self._settings.timeout_s
            within = f"{longest_s:g} s and {MAX_ANSWER_BYTES:,} bytes"
            return NoAnswerError(Reason.TIMEOUT, f"no end of an answer within {within}")
        if isinstance(error, openai.APITimeoutError):
            return NoAnswerError(Reason.TIMEOUT, "no answer in time, after retries")
        said = self._without_key(str(cause)) or type(cause).__name__
        if any(words in said for words in _UNKNOWN_SIGNER):
            said += "; if it is yours, name the certificate that signed it in SSL_CERT_FILE"
        detail = f"no connection to {self._settings.base_url}, after retries: {said}"
        return NoAnswerError(Reason.CONNECTION, detail)

    def _stop_if_hopeless(self, error: openai.APIStatusError) -> None:
        said = self._message_of(error)
        if error.status_code == 401:
            raise EndpointRefusesError(
                f"The endpoint refuses the key: {said}.", self._settings.key_advice
            )
        if error.status_code == 402 or error.code == "insufficient_quota":
            raise EndpointRefusesError(
                f"The endpoint says that the account is used up: {said}.", GO_ON
            )
        if error.status_code == 404:
            raise EndpointError(
                f"{self._settings.base_url} knows no such address, or no model "
                f"{self._model.model}: {said}.",
                self._settings.address_advice,
            )

    def _refusal_error(self, error: openai.APIStatusError) -> NoAnswerError:
        reason = Reason.REQUEST_REFUSED
        if error.status_code == 429:
            reason = Reason.RATE_LIMITED
        elif error.status_code in (408, 409) or error.status_code >= 500:
            reason = Reason.SERVER_ERROR
        said = self._message_of(error)
        detail = f"HTTP {error.status_code}: {said}" if said else f"HTTP {error.status_code}"
        headers = error.response.headers
        if 300 <= error.status_code < 400 and "location" in headers:
            to = self._without_key(headers["location"])
            detail = (
                f"HTTP {error.status_code}: it leads to {to}, and no redirect is followed; "
                "if images may go there, that is the address to ask"
            )
        elif "retry-after" in headers:
            detail += f" (Retry-After: {self._without_key(headers['retry-after'])})"
        return NoAnswerError(reason, detail)

    def _message_of(self, error: openai.APIStatusError) -> str:
        """The endpoint's own words."""
        said = error.body.get("message") if isinstance(error.body, dict) else error.body
        return self._without_key(str(said or error.response.text))

    def _without_key(self, text: str) -> str:
        """The beginning of what was said, to stand in a sentence, without the key."""
        key = self._settings.key
        return (text.replace(key, "***") if key else text).strip().rstrip(".")[:300]
