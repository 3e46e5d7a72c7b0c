"""The same arrivals with more slots than this machine has, in the order of fair share."""

import heapq
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from tests.support.fair_share import TeamQueue, served, team_to_serve

from benchmarks.load_traffic import FLOOD, arrivals

_START = datetime(2026, 1, 1, tzinfo=UTC)
SLOTS = (1, 2, 4, 8, 16, 32)


def simulated_waits(
    service_s: float, slots: int, n_uploads: int, rush_s: float, n_teams: int
) -> tuple[list[float], list[float]]:
    """Return seconds from arrival to score of all files, and of every team's first one."""
    queue = _Queue()
    coming = sorted(arrivals(n_uploads, rush_s, n_teams), reverse=True)
    running: list[tuple[float, str]] = []
    now_s, waits, firsts = 0.0, list[float](), list[float]()
    while coming or running or queue.is_waiting:
        while coming and coming[-1][0] <= now_s:
            queue.add(*coming.pop())
        while running and running[0][0] <= now_s:
            queue.end(heapq.heappop(running)[1])
        while len(running) < slots and queue.is_waiting:
            team, at_s, is_first = queue.take(now_s)
            heapq.heappush(running, (now_s + service_s, team))
            waits.append(now_s + service_s - at_s)
            if is_first and team != FLOOD:
                firsts.append(waits[-1])
        events = [coming[-1][0]] if coming else []
        events += [running[0][0]] if running else []
        now_s = min(events, default=now_s)
    return waits, firsts


class _Queue:
    """Live jobs of teams, as the records hold them."""

    def __init__(self) -> None:
        self._arrived_s: dict[str, list[float]] = {}
        self._taken: dict[str, int] = {}
        self._of_team: dict[str, TeamQueue] = {}

    @property
    def is_waiting(self) -> bool:
        return any(team.n_waiting for team in self._of_team.values())

    def add(self, at_s: float, team: str) -> None:
        known = self._of_team.get(team) or TeamQueue(len(self._of_team), 0, 0, _START, None)
        self._arrived_s.setdefault(team, []).append(at_s)
        self._of_team[team] = replace(known, n_waiting=known.n_waiting + 1)

    def take(self, now_s: float) -> tuple[str, float, bool]:
        """Give a slot its next job: team, arrival, whether it is the team's first."""
        queues = {name: self._with_oldest(name) for name in self._of_team}
        chosen = team_to_serve(list(queues.values()))
        assert chosen is not None
        team = next(name for name, queue in queues.items() if queue.team_id == chosen.team_id)
        n_taken = self._taken.get(team, 0)
        self._taken[team] = n_taken + 1
        self._of_team[team] = served(chosen, _START + timedelta(seconds=now_s))
        return team, self._arrived_s[team][n_taken], n_taken == 0

    def end(self, team: str) -> None:
        known = self._of_team[team]
        self._of_team[team] = replace(known, n_running=known.n_running - 1)

    def _with_oldest(self, team: str) -> TeamQueue:
        known, n_taken = self._of_team[team], self._taken.get(team, 0)
        arrived_s = self._arrived_s[team]
        oldest_s = arrived_s[min(n_taken, len(arrived_s) - 1)]
        return replace(known, oldest_at=_START + timedelta(seconds=oldest_s))
