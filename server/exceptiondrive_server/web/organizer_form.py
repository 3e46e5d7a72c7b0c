"""What organizers send: an unknown field is an error."""

from pydantic import BaseModel, ConfigDict


class Form(BaseModel):
    """Base of what is sent."""

    model_config = ConfigDict(extra="forbid")
