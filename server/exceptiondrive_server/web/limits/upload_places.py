"""Limit on concurrent uploads in one process: of all teams together, and of one team.

A slot is taken after the sender is authenticated and before the body is read. So clients without a
token take none, and a team that sends slowly does not block others. Once half of all slots are taken,
a team gets at most one, so that a few teams cannot take them all.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.problem_vocabulary import ApiProblem

RETRY_AFTER_S = 5


class UploadPlaces:
    """Places of one process; for one thread, the one that runs the event loop."""

    def __init__(self, at_once: int, per_team: int) -> None:
        self._at_once = at_once
        self._per_team = per_team
        self._taken: Counter[int] = Counter()

    @property
    def taken(self) -> int:
        """How many uploads are under way."""
        return self._taken.total()

    @contextmanager
    def held_by(self, team_id: int) -> Iterator[None]:
        """Hold a place while an upload of a team comes and is stored.

        Raises:
            ApiProblem: There is none left, for this team (429) or for anybody (503). Nothing was
                read, so nothing is lost.
        """
        n_held, is_short = self._taken[team_id], 2 * self.taken >= self._at_once
        if n_held >= (1 if is_short else self._per_team):
            detail = (
                f"As many files of your team arrive right now ({n_held}) as may at a time"
                f"{' while places are short' if is_short else ''}. Nothing was taken; send it again "
                "when one of them is through."
            )
            raise ApiProblem(ProblemCode.TOO_MANY_REQUESTS, detail, retry_after_s=RETRY_AFTER_S)
        if self.taken >= self._at_once:
            detail = "Many files arrive right now. Nothing was taken; send it again shortly."
            raise ApiProblem(ProblemCode.STORE_UNAVAILABLE, detail, retry_after_s=RETRY_AFTER_S)
        self._taken[team_id] += 1
        try:
            yield
        finally:
            self._taken[team_id] -= 1
            if not self._taken[team_id]:
                del self._taken[team_id]
