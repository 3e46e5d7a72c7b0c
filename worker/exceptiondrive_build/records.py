"""The append-only table of decisions: who decided what about which candidate, from which inputs.

A record is never changed or removed; the database itself refuses it. A later record supersedes an
earlier one by naming it. Commits wait for the disk, so confirmed records survive any end of the
process; several processes may append at once.
"""

import json
import sqlite3
import unicodedata
from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Self

from pydantic import Field, model_validator

from exceptiondrive_build.database import Database
from exceptiondrive_build.errors import BuildError
from exceptiondrive_schemas.base import Document, canonical_json, content_digest

_TABLE = """
CREATE TABLE IF NOT EXISTS records (
  id INTEGER PRIMARY KEY AUTOINCREMENT,
  at TEXT NOT NULL,
  kind TEXT NOT NULL,
  candidate TEXT NOT NULL,
  by TEXT NOT NULL,
  inputs TEXT NOT NULL,
  value TEXT NOT NULL,
  supersedes INTEGER REFERENCES records (id)
) STRICT;
CREATE INDEX IF NOT EXISTS records_of_kind ON records (kind, candidate);
CREATE TRIGGER IF NOT EXISTS records_stay BEFORE UPDATE ON records
  BEGIN SELECT RAISE(ABORT, 'records are never changed'); END;
CREATE TRIGGER IF NOT EXISTS records_are_kept BEFORE DELETE ON records
  BEGIN SELECT RAISE(ABORT, 'records are never removed'); END;
"""
MAX_NAME_LENGTH = 64
_COLUMNS = "id, at, kind, candidate, by, inputs, value, supersedes"


class Kind(StrEnum):
    """The kinds of decisions."""

    SCREEN = "screen"
    EDIT = "edit"
    REVIEW = "review"
    INSPECT = "inspect"
    LOCALIZE = "localize"
    VERIFY = "verify"
    WITHDRAW = "withdraw"


class Author(Document):
    """Who or what decided: a person by name, or a model with digests of its prompt and settings."""

    person: str | None = None
    model: str | None = None
    prompt: str | None = None
    settings: str | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if (self.person is None) == (self.model is None):
            raise ValueError("a record is by a person or by a model")
        return self


def person_named(name: str) -> str:
    """Return the name of a person as stored in records.

    Raises:
        BuildError: It is empty, too long, or not printable.
    """
    name = " ".join(name.split())
    if not (0 < len(name) <= MAX_NAME_LENGTH and name.isprintable()):
        raise BuildError(f"Give a name of at most {MAX_NAME_LENGTH} characters.")
    return name


def person_key(name: str | None) -> str:
    """Return a key that is equal for all spellings of a name, to tell people apart."""
    return unicodedata.normalize("NFKC", name or "").casefold()


def now_text() -> str:
    """Return the time in the format of records and answers."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class Record(Document):
    """One decision.

    Attributes:
        kind: The kind of decision.
        candidate: Sample id of the keyframe and task.
        by: Who decided.
        inputs: Digests of what was looked at, in a fixed order.
        value: The decision, as the document of its kind in `values`; null takes back the superseded
            record and decides nothing.
        supersedes: Id of the record that no longer counts.
        at: When, in UTC.
        id: Number in the table, once appended.
    """

    kind: Kind
    candidate: str
    by: Author
    inputs: tuple[str, ...]
    value: dict[str, Any] | None
    supersedes: int | None = None
    at: str = Field(default_factory=now_text)
    id: int | None = None

    @property
    def digest(self) -> str:
        """Digest of the decision, independent of when and in which order it was made."""
        return content_digest(self.model_dump(mode="json", exclude={"id", "at", "supersedes"}))


class Records(Database):
    """The table in a file."""

    tables = _TABLE

    def append(self, *records: Record) -> tuple[Record, ...]:
        """Append decisions, all or none, and return them with their ids, once they are on disk.

        Raises:
            BuildError: They cannot be written, or one supersedes a superseded record.
        """
        with self._transaction() as write:
            return tuple(self._insert(write, record) for record in records)

    def _insert(self, write: sqlite3.Connection, record: Record) -> Record:
        if record.supersedes is not None:
            already = write.execute(
                "SELECT 1 FROM records WHERE supersedes = ?", (record.supersedes,)
            ).fetchone()
            if already:
                raise BuildError(
                    f"Record {record.supersedes} is superseded already.",
                    "Somebody decided anew meanwhile; look again.",
                )
        row = (
            record.at,
            record.kind.value,
            record.candidate,
            canonical_json(record.by.model_dump(exclude_none=True)).decode(),
            canonical_json(list(record.inputs)).decode(),
            canonical_json(record.value).decode(),
            record.supersedes,
        )
        columns = _COLUMNS.removeprefix("id, ")
        done = write.execute(f"INSERT INTO records ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", row)
        return record.model_copy(update={"id": done.lastrowid})

    def read(self, *kinds: Kind, after: int = 0) -> Iterator[Record]:
        """Yield records in the order in which they were appended, superseded ones too.

        Only of the given kinds, if any, and with an id above `after`.
        """
        wanted = kinds or tuple(Kind)
        marks = ", ".join("?" for _ in wanted)
        query = f"SELECT {_COLUMNS} FROM records WHERE kind IN ({marks}) AND id > ? ORDER BY id"
        with self._told():
            rows = self._connection.execute(query, (*(kind.value for kind in wanted), after))
            for row in rows:
                yield _record(row)

    def standing(self, kind: Kind) -> dict[str, tuple[Record, ...]]:
        """Return the records of a kind that nothing supersedes, oldest first, by candidate."""
        return standing(tuple(self.read(kind)))


def standing(records: Sequence[Record]) -> dict[str, tuple[Record, ...]]:
    """Return the records that decide something and that none of the others supersedes."""
    gone = {record.supersedes for record in records}
    found: dict[str, list[Record]] = defaultdict(list)
    for record in records:
        if record.id not in gone and record.value is not None:
            found[record.candidate].append(record)
    return {candidate: tuple(decisions) for candidate, decisions in found.items()}


def _record(row: tuple[Any, ...]) -> Record:
    number, at, kind, candidate, by, inputs, value, supersedes = row
    return Record(
        id=number,
        at=at,
        kind=Kind(kind),
        candidate=candidate,
        by=Author.model_validate(json.loads(by)),
        inputs=tuple(json.loads(inputs)),
        value=json.loads(value),
        supersedes=supersedes,
    )
