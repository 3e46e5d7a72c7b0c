"""Ends connections whose requests do not come: slow headers, slow bodies, endless headers.

Uvicorn waits for ever. Behind the production proxy such clients never reach us; without one they do.
"""

import asyncio
from dataclasses import dataclass
from enum import Enum
from typing import Any

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

HEAD_TOO_LARGE = "The headers of the request are too large."
TOO_SLOW = "The request took too long to arrive; send it again."


@dataclass(frozen=True)
class Patience:
    """How long a request may take to arrive, and how large its head may be."""

    head_s: float = 10.0
    """From the first moment of a connection or request to the end of its headers."""
    body_s: float = 30.0
    """From then to the end of its body, and longer as long as `body_bytes_per_s` keep coming."""
    body_bytes_per_s: float = 16 * 1024
    head_bytes: int = 32 * 1024
    discarded_bytes: int = 32 * 1024 * 1024
    """What may still come of a request that is answered already, so that its sender reads that."""
    lingering_s: float = 2.0


class _Stage(Enum):
    """What a connection is expected to send next."""

    SILENT = "the first byte of a request"
    HEAD = "the rest of a head"
    BODY = "the rest of a body"
    ENDED = "nothing"


class PatientProtocol(HttpToolsProtocol):
    """HTTP/1.1 as Uvicorn speaks it, with an end to waiting."""

    patience = Patience()

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._deadline: asyncio.TimerHandle | None = None
        self._stage = _Stage.SILENT
        self._head_bytes = 0
        self._body_bytes = 0
        self._body_began_s = 0.0
        self._discarded_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a head."""
        super().connection_made(transport)
        self._wait_s(self.patience.head_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Count what comes before the end of a head; a head without end is refused."""
        if self._stage is _Stage.ENDED:
            self._discard(len(data))
            return
        was_in_head = self._stage is _Stage.HEAD
        super().data_received(data)
        if was_in_head and self._stage is _Stage.HEAD:
            self._head_bytes += len(data)
            if self._head_bytes > self.patience.head_bytes:
                self._end(431, HEAD_TOO_LARGE)

    def send_400_response(self, msg: str) -> None:
        """Say that a request is no HTTP, unless it was told something better already."""
        if self._stage is not _Stage.ENDED:
            self._end(400, msg)

    def on_message_begin(self) -> None:
        """Begin to wait for a head, also on a connection that is used again."""
        super().on_message_begin()
        self._stage, self._head_bytes = _Stage.HEAD, 0
        self._wait_s(self.patience.head_s)

    def on_headers_complete(self) -> None:
        """Wait for the body.

        Raises:
            ValueError: The head is too large; the parser stops there.
        """
        if len(self.url) + sum(len(n) + len(v) for n, v in self.headers) > self.patience.head_bytes:
            self._end(431, HEAD_TOO_LARGE)
            raise ValueError(HEAD_TOO_LARGE)
        self._stage = _Stage.BODY
        self._body_bytes = self._discarded_bytes = 0
        self._body_began_s = self.loop.time()
        self._wait_s(self.patience.body_s)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Count what came: who sends at a fair rate may take as long as it needs."""
        self._body_bytes += len(body)
        super().on_body(body)
        if self.cycle.response_complete:
            self._discard(len(body))

    def on_message_complete(self) -> None:
        """Wait no more; the answer is ours, and Uvicorn ends idle connections."""
        self._stage = _Stage.SILENT
        self._stop_waiting()
        super().on_message_complete()

    def _wait_s(self, seconds: float) -> None:
        self._stop_waiting()
        self._deadline = self.loop.call_later(seconds, self._lose_patience)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _lose_patience(self) -> None:
        left_s = self._body_left_s() if self._stage is _Stage.BODY else 0.0
        if left_s > 0:
            self._wait_s(left_s)
        elif self._stage in (_Stage.SILENT, _Stage.ENDED):
            self.transport.close()
        else:
            self._end(408, TOO_SLOW)

    def _body_left_s(self) -> float:
        earned_s = self._body_bytes / self.patience.body_bytes_per_s
        until_s = self._body_began_s + self.patience.body_s + earned_s
        left_s = until_s - self.loop.time()
        return max(left_s, 1.0) if self.flow.read_paused else left_s  # paused: we do not read

    def _discard(self, n_bytes: int) -> None:
        self._discarded_bytes += n_bytes
        if self._discarded_bytes > self.patience.discarded_bytes:
            self.transport.close()

    def _end(self, status: int, text: str) -> None:
        """Answer, if that is still possible, and read on for a moment: so the answer arrives."""
        if self.transport.is_closing():
            return
        if self._stage is _Stage.BODY:
            is_answered = self.cycle.response_started
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        else:
            is_answered = self._body_began_s > 0 and not self.cycle.response_complete
        self._stage = _Stage.ENDED
        if is_answered:
            self.transport.close()
            return
        head = "content-type: text/plain; charset=utf-8\r\nconnection: close\r\n"
        head += f"content-length: {len(text)}\r\n\r\n"
        self.transport.write(STATUS_LINE[status] + (head + text).encode())
        self.transport.write_eof()
        self._wait_s(self.patience.lingering_s)
