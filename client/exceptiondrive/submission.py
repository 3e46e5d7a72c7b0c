"""A submission to follow until it is scored."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from exceptiondrive.errors import (
    InvalidFileError,
    NetworkError,
    ScoringFailedError,
    WaitTimeoutError,
)
from exceptiondrive_schemas.submission import SubmissionStatus, SubmissionView

if TYPE_CHECKING:
    from exceptiondrive.client import Client

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
WAIT_FOR_RANK_S = 10.0
"""A board is built right after the score; longer than this is not waited for it."""
MAX_OUTAGES = 5
"""Requests in a row, each with its own retries, that may fail while waiting: about a minute."""

OnChange = Callable[[SubmissionView], None]


class Submission:
    """One submission of the team, as last seen.

    Attributes:
        view: What the server said last.
    """

    def __init__(self, client: "Client", view: SubmissionView) -> None:
        self._client = client
        self.view = view
        self._outages = 0

    @property
    def id(self) -> str:
        """Id, as `exceptiondrive status ID` takes it."""
        return self.view.id

    @property
    def status(self) -> SubmissionStatus:
        """Status, as last seen."""
        return self.view.status

    @property
    def page_url(self) -> str:
        """Address of its page, from upload to rank; for members of the team."""
        return self._client.page_url(self.id)

    def refresh(self) -> SubmissionView:
        """Ask the server again."""
        is_duplicate = self.view.is_duplicate
        view = self._client.status(self.id)
        self.view = view.model_copy(update={"is_duplicate": is_duplicate})
        return self.view

    def withdraw(self) -> SubmissionView:
        """Take it off the board."""
        self.view = self._client.withdraw(self.id)
        return self.view

    def wait(
        self, timeout_s: float | None = None, on_change: OnChange | None = None
    ) -> SubmissionView:
        """Wait until it is scored, and for its rank.

        Args:
            timeout_s: Give up after so long; None waits as long as it takes.
            on_change: Called with each new view.

        Returns:
            The scored submission, with score sheet and, unless it cannot be ranked, its rank.

        Raises:
            InvalidFileError: The file was rejected; the error carries every fault.
            ScoringFailedError: It failed, or was withdrawn meanwhile.
            WaitTimeoutError: It was not scored in time; it still will be.
            NetworkError: The server was away for about a minute; the submission is safe.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause_s = FIRST_PAUSE_S
        while not self.status.is_terminal:
            if deadline is not None and time.monotonic() + pause_s > deadline:
                raise self._timed_out(timeout_s)
            pause_s = self._look_again(pause_s, on_change)
        self._raise_unless_scored()
        self._wait_for_rank(deadline, on_change)
        return self.view

    def _look_again(self, pause_s: float, on_change: OnChange | None) -> float:
        """Pause, ask, and return the next pause; a short outage of the network is waited out."""
        time.sleep(pause_s)
        before = self.view
        try:
            self.refresh()
        except NetworkError:
            self._outages += 1
            if self._outages > MAX_OUTAGES:
                raise
            return LONGEST_PAUSE_S
        self._outages = 0
        if on_change is not None and self.view != before:
            on_change(self.view)
        return min(pause_s * 1.3, LONGEST_PAUSE_S)

    def _wait_for_rank(self, deadline: float | None, on_change: OnChange | None) -> None:
        until = time.monotonic() + WAIT_FOR_RANK_S
        until = until if deadline is None else min(until, deadline)
        pause_s = FIRST_PAUSE_S
        is_shown = False
        while self.view.rank is None and not is_shown and time.monotonic() < until:
            is_shown = self._is_on_board()
            pause_s = self._look_again(pause_s, on_change)

    def _is_on_board(self) -> bool:
        """Whether the board shows it, be it unranked; an outage is left to the next look."""
        try:
            return self._client.is_on_board(self.id)
        except NetworkError:
            return False

    def _raise_unless_scored(self) -> None:
        view = self.view
        if view.status is SubmissionStatus.REJECTED and view.report is not None:
            raise InvalidFileError(view.report)
        if view.status is SubmissionStatus.WITHDRAWN:
            raise ScoringFailedError(
                "withdrawn", f"Submission {view.id} was withdrawn.", "Submit again.", view
            )
        if view.status is not SubmissionStatus.SCORED:
            reason = view.failure.message if view.failure else "no reason was given."
            raise ScoringFailedError(
                view.failure.code if view.failure else "failed",
                f"Submission {view.id} could not be scored: {reason}",
                "This is a fault on our side; the organizers see it, and it cost no quota.",
                view,
            )

    def _timed_out(self, timeout_s: float | None) -> WaitTimeoutError:
        return WaitTimeoutError(
            "wait_timed_out",
            f"Submission {self.id} was not scored within {timeout_s:g} s.",
            f"It is safe and will be scored; look with: exceptiondrive status {self.id}",
            self.view,
        )
