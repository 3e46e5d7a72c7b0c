"""The multipart body of an upload, made anew for each attempt, with progress."""

import io
from collections.abc import Callable, Mapping
from typing import Any

Progress = Callable[[int, int], None]
"""Called with bytes sent and bytes in all."""


class UploadBody:
    """Gives the arguments of one POST each time it is called.

    Args:
        name: File name, for people who read logs.
        data: The bytes.
        fields: Form fields; those that are None or empty are left out.
        on_progress: Told how far the upload is.
    """

    def __init__(
        self,
        name: str,
        data: bytes,
        fields: Mapping[str, str | None],
        on_progress: Progress | None = None,
    ) -> None:
        self._name = name
        self._data = data
        self._fields = {key: value for key, value in fields.items() if value}
        self._on_progress = on_progress

    def __call__(self) -> dict[str, Any]:
        """Return the keyword arguments of the request."""
        stream = _CountingStream(self._data, self._on_progress)
        file = (self._name, stream, "application/octet-stream")
        return {"data": self._fields, "files": {"file": file}}


class _CountingStream(io.BytesIO):
    """Bytes that tell how many of them were read."""

    def __init__(self, data: bytes, on_progress: Progress | None) -> None:
        super().__init__(data)
        self._size = len(data)
        self._on_progress = on_progress

    def read(self, size: int | None = -1, /) -> bytes:
        chunk = super().read(size)
        if self._on_progress is not None:
            self._on_progress(self.tell(), self._size)
        return chunk
