"""The workshop folder: settings, prompts, scenes, records, answers and pictures in one place.

workshop.toml      settings, with the prompts by file        prompts/, tasks.toml
scenes.jsonl       keyframes, one a line                     images/<sha256>.<ext>
records.sqlite3    decisions, append-only                    answers/<stage>.jsonl
"""

import hashlib
import hmac
import os
import re
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from secrets import token_hex
from typing import Self

import tomllib
from pydantic import TypeAdapter, ValidationError

from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.records import Kind, Record, Records
from exceptiondrive_build.scenes.keyframe import Keyframe, read_keyframes
from exceptiondrive_build.settings import MIN_KEY_LENGTH, TaskTexts, WorkshopSettings
from exceptiondrive_schemas.base import faults_in
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    parse_protocol,
)
from exceptiondrive_schemas.split import SPLIT_NAME_PATTERN
from exceptiondrive_schemas.taxonomy import Task

SETTINGS = "workshop.toml"
SCENES = "scenes.jsonl"
RECORDS = "records.sqlite3"
IMAGES = "images"
ANSWERS = "answers"
GIT_IGNORE, IGNORE_ALL = ".gitignore", "*\n"
"""Keeps a folder with withheld regions out of the repository that it may be in."""
_READ_AGAIN = "Read the scenes in again: exceptiondrive-build scenes read SOURCE --replace"
_ADVICE = (
    "`exceptiondrive-build new FOLDER --name NAME` makes a workshop with all files that it needs; "
    "--workshop FOLDER names one."
)


class Workshop:
    """One workshop; use it as a context manager."""

    def __init__(self, folder: Path) -> None:
        """Open it.

        Raises:
            BuildError: There is no workshop, its settings are wrong, or its records cannot be read.
        """
        self.folder = folder
        if not (folder / SETTINGS).is_file():
            raise BuildError(f"{folder}: no workshop: there is no {SETTINGS} in it.", _ADVICE)
        self._read_settings()
        (folder / IMAGES).mkdir(exist_ok=True)
        if (folder / ANSWERS).is_dir() and not (folder / RECORDS).exists():
            raise BuildError(
                f"{folder / RECORDS} is missing; models were asked, so decisions stood in it.",
                "Put it back from a copy of the workshop. An empty file of this name begins without any "
                "decision: models' answers count again, what people said is gone.",
            )
        self.records = Records(folder / RECORDS)

    def __enter__(self) -> Self:
        """Return the workshop."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the records."""
        self.records.close()

    def current(self, kind: Kind) -> dict[str, Record]:
        """Return the newest record of a kind that nothing supersedes, by candidate.

        Whether its inputs are still current is checked by `candidates.walk`.
        """
        return {key: found[-1] for key, found in self.records.standing(kind).items()}

    def text(self, name: str) -> str:
        """Return a text file of the workshop, such as a prompt.

        Raises:
            BuildError: It cannot be read.
        """
        try:
            return (self.folder / name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise BuildError(f"{self.folder / name}: {_reason_of(error)}.", _ADVICE) from None

    def read_changes(self) -> bool:
        """Reload settings, prompts and scenes changed since; return whether any did.

        Raises:
            BuildError: The settings are wrong; the former ones stay.
        """
        if self._written == self._stamps(self.settings):
            return False
        self._read_settings()
        for name in ("protocol", "tasks", "task_texts", "keyframes"):
            self.__dict__.pop(name, None)
        return True

    def _read_settings(self) -> None:
        at = self._stamp(SETTINGS)
        try:
            document = tomllib.loads(self.text(SETTINGS))
            self.settings = WorkshopSettings.model_validate(document, strict=False)
        except (tomllib.TOMLDecodeError, ValidationError) as error:
            raise BuildError(f"{self.folder / SETTINGS}: {_reason_of(error)}.") from None
        self._written = self._stamps(self.settings) | {SETTINGS: at}

    def _stamps(self, settings: WorkshopSettings) -> dict[str, tuple[int, ...]]:
        """Return when each file that people write was last written."""
        prompts = (model.prompt for model in settings.models.values())
        names = (SETTINGS, SCENES, settings.task_texts, settings.protocol, *prompts)
        return {name: self._stamp(name) for name in names if name}

    def _stamp(self, name: str) -> tuple[int, ...]:
        try:
            found = (self.folder / name).stat()
        except OSError:
            return ()
        return found.st_mtime_ns, found.st_size, found.st_ino

    @cached_property
    def protocol(self) -> ProtocolDocument:
        """The protocol whose taxonomy and geometry are in force.

        Raises:
            BuildError: Its file cannot be read.
        """
        if not self.settings.protocol:
            return packaged_protocol(NEWEST)
        try:
            return parse_protocol(self.text(self.settings.protocol))
        except ProtocolError as error:
            raise BuildError(f"{self.folder / self.settings.protocol}: {error}") from None

    @cached_property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks in use, in the order of the taxonomy.

        Raises:
            BuildError: The settings name a task that is not in the protocol.
        """
        known = {task.id: task for task in self.protocol.taxonomy.tasks}
        unknown = sorted(set(self.settings.tasks) - known.keys())
        if unknown:
            raise BuildError(
                f"{self.folder / SETTINGS}: tasks that the protocol does not know: "
                f"{', '.join(unknown)}. It knows {', '.join(known)}."
            )
        wanted = self.settings.tasks or tuple(known)
        return tuple(task for task in known.values() if task.id in wanted)

    @cached_property
    def task_texts(self) -> dict[str, TaskTexts]:
        """The texts about each task in use.

        Raises:
            BuildError: The file is wrong, or lacks a task.
        """
        path = self.folder / self.settings.task_texts
        try:
            document = tomllib.loads(self.text(self.settings.task_texts))
            found = TypeAdapter(dict[str, TaskTexts]).validate_python(document, strict=False)
        except (tomllib.TOMLDecodeError, ValidationError) as error:
            raise BuildError(f"{path}: {_reason_of(error)}.") from None
        missing = [task.id for task in self.tasks if task.id not in found]
        if missing:
            raise BuildError(f"{path}: no words for the tasks {', '.join(missing)}.")
        return found

    @cached_property
    def keyframes(self) -> dict[str, Keyframe]:
        """The keyframes of `scenes.jsonl` by id, in its order; none before scenes are read in.

        Raises:
            BuildError: A line is no keyframe, or an id occurs twice.
        """
        path = self.folder / SCENES
        if not path.exists():
            return {}
        return read_keyframes(path, self.text(SCENES).encode(), _READ_AGAIN)

    def sample_id(self, keyframe_id: str, task_id: str) -> str:
        """Return a candidate's id: 16 hex digits that reveal neither without the workshop's key."""
        text = f"{keyframe_id}\n{task_id}".encode()
        return hmac.new(self.settings.id_key.encode(), text, hashlib.sha256).hexdigest()[:16]

    def keep_image(self, data: bytes, extension: str) -> str:
        """Store a picture under its digest and return its name, `<sha256>.<ext>`.

        It is complete and on disk when this returns.

        Raises:
            BuildError: It cannot be written.
        """
        name = f"{hashlib.sha256(data).hexdigest()}.{extension}"
        path = self.folder / IMAGES / name
        if path.is_file():
            return name
        part = path.with_name(f"{name}.{token_hex(8)}.part")
        try:
            with part.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            advice = "Everything decided so far is kept; make room and run the command again."
            raise BuildError(f"{path}: {_reason_of(error)}.", advice) from None
        return name

    def image_path(self, name: str) -> Path:
        """Return the path of a picture."""
        return self.folder / IMAGES / name

    def image(self, name: str) -> bytes:
        """Return a picture's bytes.

        Raises:
            BuildError: It does not exist, cannot be read, or does not match the digest in its name.
        """
        path = self.image_path(name)
        try:
            data = path.read_bytes()
        except OSError as error:
            advice = (
                "Put it back from a copy of the workshop. A picture of the scenes comes back, too, when "
                "they are read in again; an edited one does not."
            )
            raise BuildError(f"{path}: {_reason_of(error)}.", advice) from None
        if hashlib.sha256(data).hexdigest() != path.stem:
            raise BuildError(f"{path}: the picture is damaged.", "Put the original back.")
        return data


def new_workshop(folder: Path, name: str, id_key: str) -> None:
    """Make a workshop: settings to be filled in, prompts, and the words of all tasks.

    Raises:
        BuildError: One exists already, name or key is invalid, or the folder cannot be written.
    """
    if not re.fullmatch(SPLIT_NAME_PATTERN, name):
        advice = "At most 64 of a-z, 0-9, . and -; first a letter or a digit."
        raise BuildError(f"{name[:80]!r} is no name of a split.", advice)
    if len(id_key) < MIN_KEY_LENGTH or not id_key.isprintable() or {'"', "\\"} & set(id_key):
        advice = f"At least {MIN_KEY_LENGTH} characters, no quotation mark and no backslash."
        raise BuildError("This is no key of sample ids.", advice)
    if (folder / SETTINGS).exists():
        raise BuildError(f"{folder}: there is a workshop already.")
    template = files("exceptiondrive_build") / "template"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not (folder / GIT_IGNORE).exists():
            (folder / GIT_IGNORE).write_text(IGNORE_ALL)
        (folder / "prompts").mkdir(exist_ok=True)
        for path in ("prompts/screen.md", "prompts/edit.md", "prompts/review.md", "tasks.toml"):
            (folder / path).write_text((template / path).read_text("utf-8"), encoding="utf-8")
        settings = (template / SETTINGS).read_text("utf-8")
        settings = settings.replace("NAME", name).replace("ID_KEY", id_key)
        (folder / SETTINGS).write_text(settings, encoding="utf-8")
        (folder / SETTINGS).chmod(0o600)
    except OSError as error:
        raise BuildError(f"{folder}: {_reason_of(error)}.") from None


def _reason_of(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or type(error).__name__
    if isinstance(error, ValidationError):
        return faults_in(error)[0]
    return str(error)
