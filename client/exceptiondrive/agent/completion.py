"""Read the endpoint's response: the model's text and its token counts, or why there is none."""

from pydantic import BaseModel, ValidationError

from exceptiondrive.agent.errors import NoAnswerError, Reason


class Usage(BaseModel):
    """Tokens that the endpoint says it counted."""

    prompt_tokens: int = 0
    completion_tokens: int = 0


class _Message(BaseModel):
    content: str | None = None
    refusal: str | None = None


class _Choice(BaseModel):
    message: _Message
    finish_reason: str | None = None


class Completion(BaseModel):
    """The part of a chat completion that we read; whatever else it holds is ignored."""

    choices: tuple[_Choice, ...]
    usage: Usage | None = None
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
            detail = "the answer hit the token limit; raise --max-tokens"
            raise NoAnswerError(Reason.TRUNCATED, detail, content)
        if content is None or not content.strip():
            raise NoAnswerError(Reason.EMPTY, "the answer is empty")
        return content


def read_completion(body: bytes) -> Completion:
    """Return the chat completion in a response body.

    Raises:
        NoAnswerError: `bad_response`: the body is not a chat completion.
    """
    try:
        return Completion.model_validate_json(body)
    except ValidationError:
        raw = body.decode("utf-8", errors="replace")
        raise NoAnswerError(
            Reason.BAD_RESPONSE, "the response is no chat completion", raw
        ) from None
