"""Terminal output: results on stdout, everything else on stderr; colour and progress on terminals."""

import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from exceptiondrive.errors import ExceptionDriveError, InvalidArgumentError, InvalidFileError
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.printable import printable

PIPED_WIDTH = 200
"""Columns where no terminal says how many: tables are not cut for `grep`."""
Answer = tuple[Any, ...]
"""What a command came to: its result, as `--json` shows it, and the words for people."""
_JSON = "exceptiondrive.json"
_UNSHOWN = re.compile("[\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")
"""What `json.dumps` leaves bare although it steers terminals or hides; escaped, the same JSON."""


class SafeConsole(Console):
    """Rich's console; control characters in what is shown become replacement signs.

    Rich itself lets ESC through. Its own colours and cursor movements are not in the text of
    segments and stay.
    """

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Yield what is shown, cleaned."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(printable(segment.text), segment.style)


def remember_json(context: typer.Context, value: bool) -> bool:
    """Note that `--json` was given, so that errors are JSON too."""
    context.meta[_JSON] = value
    return value


def console(stderr: bool = False) -> Console:
    """Return a console for stdout or stderr. It shows no colour when piped, nor with NO_COLOR."""
    found = SafeConsole(stderr=stderr, highlight=False, markup=False, emoji=False)
    if not found.is_terminal:
        found.width = max(found.width, PIPED_WIDTH)
    return found


def show(*parts: RenderableType | Iterator[RenderableType], stderr: bool = False) -> None:
    """Write a result for people on stdout, or remarks on stderr; of a view, all that it yields."""
    out = console(stderr)
    for part in parts:
        for each in part if isinstance(part, Iterator) else (part,):
            out.print(each)


def show_json(value: Any) -> None:
    """Write a result for programs on stdout: one JSON document, also of documents and lists of them."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False, default=_plain)
    typer.echo(_UNSHOWN.sub(lambda found: json.dumps(found[0])[1:-1], text))


def _plain(document: Document) -> dict[str, Any]:
    return document.model_dump(mode="json", by_alias=True)


def show_result(
    result: Any, as_json: bool, *words: RenderableType | Iterator[RenderableType]
) -> None:
    """Write a result: documents or records as JSON where `--json` asks for it, else in words.

    A view makes its words only where they are shown.
    """
    if as_json:
        show_json(result)
    else:
        show(*words)


def save_new(path: Path, data: bytes) -> Answer:
    """Write a new file, never over another one, and return which.

    Raises:
        InvalidArgumentError: It is there already, or cannot be written.
    """
    from exceptiondrive.inputs import require_name

    require_name(path)
    is_ours = False
    try:
        with path.open("xb") as file:
            is_ours = True
            file.write(data)
    except FileExistsError:
        raise InvalidArgumentError(
            "not_written",
            f"{path} is there already; nothing was overwritten.",
            "Name another file: --output FILE",
        ) from None
    except OSError as error:
        if is_ours:  # half of a file would be in the way of the next attempt
            path.unlink()
        raise InvalidArgumentError(
            "not_written", f"{path} cannot be written: {error.strerror}."
        ) from None
    size = len(data)
    return {"file": str(path), "size_bytes": size}, f"{path}  {size:,} bytes"


@contextmanager
def replacing(path: Path) -> Iterator[None]:
    """Say on stderr that a file was there, where what is made or fetched anew was written over it."""
    was_there = os.path.isfile(path)
    yield
    if was_there:
        say(f"{path} was there, and is replaced")


def upload_name(submission_id: str, data: bytes) -> str:
    """Return the name of a downloaded upload, which is gzip or plain JSON."""
    suffix = ".json.gz" if data.startswith(b"\x1f\x8b") else ".json"
    return submission_id + suffix


def cut_words(found: Sized, limit: int, more: str = "--limit N shows more") -> tuple[str, ...]:
    """Say below a list that it may be cut; nothing where it is whole."""
    return (f"at most {limit:,} are shown: {more}",) if len(found) >= limit else ()


def say(text: str) -> None:
    """Write a remark on stderr."""
    typer.echo(printable(text), err=True)


def has_terminal() -> bool:
    """Whether a person sees stderr: only then is progress shown."""
    return sys.stderr.isatty()


def can_ask() -> bool:
    """Whether a person can answer a question."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def be_sure(
    sentence: str,
    is_said: bool,
    option: str = "--yes",
    *,
    question: str = "",
    nothing: str = "Nothing was changed.",
) -> None:
    """Ask before what cannot be taken back, unless an option has said yes.

    Raises:
        InvalidArgumentError: Nobody can be asked, or the answer is no.
    """
    if is_said:
        return
    if not can_ask():
        raise InvalidArgumentError(
            "not_confirmed",
            f"{sentence} {nothing}",
            f"There is no terminal to ask on: add {option}.",
        )
    if not typer.confirm(printable(f"{sentence} {question}".strip()), err=True):
        raise InvalidArgumentError("not_confirmed", nothing)


def report_error(error: ExceptionDriveError, context: typer.Context) -> None:
    """Say what is wrong and what to do: words on stderr, and with `--json` a document on stdout."""
    if context.meta.get(_JSON):
        show_json({"error": error.document()})
    elif isinstance(error, InvalidFileError):
        from exceptiondrive.cli.file_tables import report_view

        show(*report_view(error.report))
    say(f"error: {error.sentence}")
    if error.advice:
        say(error.advice)
