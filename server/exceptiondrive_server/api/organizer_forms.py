"""What organizers send: strict where JSON has a type of its own, times as ISO 8601 text."""

from typing import Annotated

from pydantic import AwareDatetime, BaseModel, BeforeValidator, ConfigDict


def _only_text(value: object) -> object:
    """Refuse what pydantic would also read as a time: a number of seconds or milliseconds."""
    if value is not None and not isinstance(value, str):
        raise ValueError("must be text such as 2026-11-21T12:00:00Z")
    return value


Time = Annotated[AwareDatetime, BeforeValidator(_only_text)]


class Form(BaseModel):
    """Base of what is sent: an unknown field is an error."""

    model_config = ConfigDict(extra="forbid")
