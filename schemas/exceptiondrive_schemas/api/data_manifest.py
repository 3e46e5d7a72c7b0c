"""The list of files that an organizer offers as the data of a phase, each with size and digest.

It is hosted with the data; the phase has its address. Names are paths below the folder into which
files are downloaded, of plain characters only: a foreign list affects nothing outside that folder.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import Self

_PART = r"[A-Za-z0-9_][A-Za-z0-9_+-]*(\.[A-Za-z0-9_+-]+)*"
FileName = Annotated[str, Field(max_length=200, pattern=rf"^{_PART}(/{_PART})*$")]
PARTIAL = ".part"
"""Suffix of a file while it is being downloaded."""


class DataFile(Document):
    """One file."""

    name: FileName
    url: Annotated[str, Field(min_length=1, max_length=2000)]
    """https address, or relative to that of the list."""
    bytes: Annotated[int, Field(ge=0, le=2**50)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class DataManifest(Document):
    """What is to be had, and under which licence."""

    schema_: Annotated[Literal["exceptiondrive.data/1"], Field(alias="schema")]
    licence: Annotated[str, Field(min_length=1, max_length=200)]
    licence_url: Annotated[str, Field(max_length=2000)] = ""
    files: Annotated[tuple[DataFile, ...], Field(min_length=1, max_length=100_000)]

    @model_validator(mode="after")
    def _names_are_apart(self) -> Self:
        names = [file.name.lower() for file in self.files]
        if len(set(names)) < len(names):
            raise ValueError("two files have one name")
        if any(name.endswith(PARTIAL) for name in names):
            raise ValueError(f"a name ends in {PARTIAL}, which is for unfinished downloads")
        return self

    @property
    def total_bytes(self) -> int:
        """Total size of all files."""
        return sum(file.bytes for file in self.files)
