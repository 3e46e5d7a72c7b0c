"""Where log lines go, and what they say of an error: whoever logs does not end of a full disk."""

import io
import traceback
from contextlib import suppress
from pathlib import Path
from typing import TextIO, cast


class _Patient(io.TextIOBase):
    """Writes to a stream, and loses what it does not take."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()


def patient(stream: TextIO) -> TextIO:
    """Return a stream that raises nothing where `stream` cannot be written."""
    return cast("TextIO", _Patient(stream))


def places(error: BaseException) -> list[str]:
    """Return where an error came from, innermost last: file, line and function, no values."""
    frames = traceback.extract_tb(error.__traceback__)
    return [f"{Path(frame.filename).name}:{frame.lineno} {frame.name}" for frame in frames]
