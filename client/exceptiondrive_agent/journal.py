"""The agent's journals: the header and the lines of `remind` and `decide`."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_agent.errors import AgentError, as_client_errors
from exceptiondrive_endpoints import journal
from exceptiondrive_endpoints.errors import Reason
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.submission_files import ReminderRecord, SampleId
from exceptiondrive_schemas.taxonomy import Strategy

MAX_RAW_CHARACTERS = 2000


class JournalHeader(Document):
    """First line: what was asked of which model. Lines of other settings never mix with these."""

    schema_: Literal["exceptiondrive_agent-journal/1"] = Field(
        default="exceptiondrive_agent-journal/1", alias="schema"
    )
    question: Literal["remind", "decide"]
    model: str
    settings: dict[str, str] = Field(description="digest of each, by what the command calls it")


class JournalLine(Document):
    """One asked sample: an answer, or the reason why there is none and the raw text, truncated."""

    sample_id: SampleId
    asked_at: str = Field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    reason: Reason | None = None
    detail: str | None = None
    raw: Annotated[str, Field(max_length=MAX_RAW_CHARACTERS)] | None = None
    reminder: ReminderRecord | None = None
    strategy: Strategy | None = None
    given_reminder_digest: str | None = Field(
        default=None, description="digest of the reminder in the request"
    )
    model: str | None = None
    form: str | None = None
    prompt_tokens: int | None = None
    completion_tokens: int | None = None

    @property
    def is_done(self) -> bool:
        """Whether the sample has an answer."""
        return self.reason is None


def read_journal(path: Path) -> tuple[JournalHeader, tuple[JournalLine, ...]]:
    """Return the header and the readable lines of a journal.

    Raises:
        AgentError: There is no such file, or it is no journal.
    """
    with as_client_errors():
        return journal.read_journal(path, JournalHeader, JournalLine)


class Journal(journal.Journal[JournalHeader, JournalLine]):
    """An open journal of one question and its settings; use it as a context manager."""

    def __init__(self, path: Path, header: JournalHeader) -> None:
        """Open or create the journal.

        Raises:
            AgentError: The file is no journal, one of other settings, in use by another run, or
                cannot be written.
        """
        with as_client_errors():
            super().__init__(path, header, JournalLine)
        if self.header != header:
            self.__exit__()
            made, asked = self.header.settings, header.settings
            other = ", ".join(name for name in asked if made.get(name) != asked[name])
            raise AgentError(
                f"{path}: made by `{self.header.question}` with model {self.header.model!r}"
                f"{other and f' and other settings: {other}'}.",
                "Ask as it was asked, or name another file.",
            )
