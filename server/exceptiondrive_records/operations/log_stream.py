"""Where log lines go: what logs one does not end of a disk that is full."""

import io
from contextlib import suppress
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
