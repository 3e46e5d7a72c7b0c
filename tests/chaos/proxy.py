"""A small TCP proxy before the broker: slow, cutting, or silent, as a bad network is."""

import contextlib
import random
import select
import socket
import threading
import time
from collections import deque
from pathlib import Path

_CHUNK_BYTES = 65536


class _Stream:
    """One connection in both directions."""

    def __init__(self) -> None:
        self.doomed = threading.Event()
        """Once a byte was swallowed it cannot go on."""
        self._speaker: socket.socket | None = None

    def turns_to(self, speaker: socket.socket) -> float:
        """Return how much of a round trip it is that this side speaks: half, after the other one."""
        is_other, self._speaker = self._speaker is not speaker, speaker
        return 0.5 if is_other else 0.0


class Proxy:
    """Forwards a TCP port to a unix socket; a fault holds until `heal`."""

    def __init__(self, target: Path) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._random = random.Random(7)
        self._open: set[socket.socket] = set()
        self.delay_s = 0.0
        self.reset_share = 0.0
        self.n_resets = 0
        self.n_delayed = 0
        self.n_round_trips = 0.0
        self.n_swallowed_bytes = 0
        self.is_silent = False
        threading.Thread(target=self._accept, daemon=True).start()

    def heal(self) -> None:
        """Forward faithfully again; what was half open stays so until somebody notices."""
        self.delay_s, self.reset_share, self.is_silent = 0.0, 0.0, False

    def cut(self) -> None:
        """End every connection."""
        for end in list(self._open):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()
        self.cut()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                far.connect(str(self._target))
            except OSError:
                near.close()
                far.close()
                continue
            self._open |= {near, far}
            stream = _Stream()
            for source, sink in ((near, far), (far, near)):
                arguments = (source, sink, stream)
                threading.Thread(target=self._forward, args=arguments, daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, stream: _Stream) -> None:
        late: deque[tuple[float, bytes]] = deque()
        """What is under way, and when it arrives: what follows closely is not held up by it."""
        doomed, heard = stream.doomed, select.poll()
        with contextlib.suppress(OSError, ValueError):  # the other direction may have closed both
            heard.register(source, select.POLLIN)
            while True:
                while late and late[0][0] <= time.monotonic():
                    sink.sendall(late.popleft()[1])
                if not heard.poll(1000 * (late[0][0] - time.monotonic()) if late else None):
                    continue
                data = source.recv(_CHUNK_BYTES)
                if not data:
                    break
                if self.is_silent or doomed.is_set():
                    doomed.set()
                    self.n_swallowed_bytes += len(data)
                    continue
                if self.reset_share and self._random.random() < self.reset_share:
                    self.n_resets += 1
                    break
                self.n_round_trips += stream.turns_to(source)
                self.n_delayed += self.delay_s > 0
                late.append((time.monotonic() + self.delay_s, data))
            for due_s, data in late:
                time.sleep(max(0.0, due_s - time.monotonic()))
                sink.sendall(data)
        for end in (source, sink):
            self._open.discard(end)
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
