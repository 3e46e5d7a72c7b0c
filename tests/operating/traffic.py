"""Uploads by the real client and readers of pages, all through the proxy, until stopped."""

import itertools
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx
from tests.chaos.clients import planning_file
from tests.chaos.history import Call, History
from tests.chaos.topology import PHASE, Topology
from tests.deploy.nginx import Nginx
from tests.support.documents import digest_of

from exceptiondrive import Client, ExceptionDriveError

BOARD = f"/api/v1/leaderboard?phase={PHASE}"
PAGES = ("/", f"/?phase={PHASE}", BOARD)
UPLOADERS = ("alpha", "beta")
_numbers = itertools.count()


class Traffic:
    """What people do while operators work.

    Attributes:
        failures: What a participant or reader would have complained about.
        ids: Submissions that were accepted.
        board_numbers: Of the boards that were read, in the order of reading.
        n_pages: Pages that were read.
    """

    def __init__(self, nginx: Nginx, topology: Topology, history: History, folder: Path) -> None:
        self.failures: list[str] = []
        self.ids: list[str] = []
        self.board_numbers: list[int] = []
        self.n_pages = 0
        self._nginx, self._topology, self._history = nginx, topology, history
        self._folder = folder
        self._stopped = threading.Event()
        self._threads = [
            *(threading.Thread(target=self._upload, args=(team,)) for team in UPLOADERS),
            threading.Thread(target=self._read, args=("127.0.0.81",)),
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stopped.set()
        for thread in self._threads:
            thread.join()

    def _upload(self, team: str) -> None:
        with Client(self._nginx.url, self._topology.tokens[team]) as client:
            while not self._stopped.wait(0.25):
                file = self._folder / f"{next(_numbers)}.json"
                speed_mps = 20 + int(file.stem) / 1000
                file.write_bytes(planning_file(self._topology.sample_ids, speed_mps))
                try:
                    self.ids.append(submit(client, file, team, self._history))
                except ExceptionDriveError as error:
                    self.failures.append(f"{team}: {error}")

    def _read(self, source: str) -> None:
        """Look with a cookie: nothing of what is read comes out of the proxy's cache."""
        with self._nginx.browser(source) as browser:
            browser.cookies.set("theme", "dark")
            while not self._stopped.wait(0.2):
                for page in PAGES:
                    self._look(browser, page)

    def _look(self, browser: httpx.Client, page: str) -> None:
        try:
            answer = browser.get(page)
        except httpx.HTTPError as error:
            self.failures.append(f"{page}: {error!r}")
            return
        self.n_pages += 1
        if answer.status_code != 200:
            self.failures.append(f"{page}: {answer.status_code} {answer.text[:200]}")
        elif page == BOARD:
            self.board_numbers.append(answer.json()["board"])


def submit(client: Client, file: Path, team: str, history: History) -> str:
    """Submit by the real client, note the call, and return the id of the submission."""
    began_s, digest = history.now_s(), digest_of(file.read_bytes())
    method = f"proxied-{team}"
    status, submission_id = None, None
    try:
        submission_id = client.submit(file, phase=PHASE, method=method, replace=True).id
        status = 202
    finally:
        took_s = history.now_s() - began_s
        history.note(Call(team, digest, method, began_s, took_s, status, submission_id))
    return submission_id
