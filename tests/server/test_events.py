"""GET /submissions/{id}/events."""

import itertools
import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from tests.support.application import entry
from tests.support.serving import served

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_server.submissions import events

if TYPE_CHECKING:
    from tests.support.application import Api


def events_of(text: str) -> list[dict[str, Any]]:
    blocks = [block.splitlines() for block in text.split("\n\n") if "event: submission" in block]
    return [
        json.loads(line.removeprefix("data: "))
        for block in blocks
        for line in block
        if line.startswith("data: ")
    ]


@contextmanager
def following(api: "Api", submission_id: str) -> Iterator[Iterator[str]]:
    """The parts of a stream as they come, from a server of its own."""
    path = f"/api/v1/submissions/{submission_id}/events"
    bearer = {"Authorization": f"Bearer {api.tokens['alpha']}"}
    with (
        served(api.app) as address,
        httpx.stream("GET", address + path, headers=bearer, timeout=60) as stream,
    ):
        yield stream.iter_text()


def test_a_submission_that_has_ended_is_told_once(api: "Api") -> None:
    own = api.submit("a").json()["id"]
    api.score(own)
    api.publish()
    response = api.get(f"/submissions/{own}/events", "alpha")
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/event-stream")
    assert response.headers["cache-control"] == "no-store"
    (event,) = events_of(response.text)
    assert event == api.get(f"/submissions/{own}", "alpha").json()


def test_changes_are_told_until_the_board_has_it(
    make_api: Callable[..., "Api"], database_url: str
) -> None:
    api = make_api(database_url, events_longest_s=60)
    own = api.submit("a").json()["id"]
    with following(api, own) as parts:
        told = next(parts)
        api.score(own)
        while '"awaits_board":true' not in told:
            told += next(parts)
        api.publish(entry("Planner", submission_id=own))
        told += "".join(parts)
    events = events_of(told)
    seen = [(event["status"], event["awaits_board"], event["rank"]) for event in events]
    assert seen[0] == ("received", False, None)
    assert seen[-2:] == [("scored", True, None), ("scored", False, 1)]
    assert all(one != other for one, other in itertools.pairwise(events))


def test_a_board_that_comes_while_a_submission_is_read_is_awaited(api_on_both: "Api") -> None:
    """Each statement of PostgreSQL sees what is there by then: the board was read before."""
    own = api_on_both.submit("a").json()["id"]
    api_on_both.score(own)
    with api_on_both.database.read() as session:
        submission = find_submission(session, own, team_id=None)
        phase = session.get_one(Phase, submission.phase_id)
        assert phase.current_board_id is None
        api_on_both.publish(entry("Planner", submission_id=own))
        assert view(session, submission).awaits_board
    assert api_on_both.get(f"/submissions/{own}", "alpha").json()["rank"] == 1


def test_nothing_more_is_told_once_the_token_is_revoked(
    make_api: Callable[..., "Api"], sqlite_url: str
) -> None:
    api = make_api(sqlite_url, events_longest_s=60)
    own = api.submit("a").json()["id"]
    with following(api, own) as parts:
        told = next(parts)
        api.post(f"/tokens/{api.tokens['alpha'].split('_')[2]}/revoke", "alpha")
        api.score(own)
        told += "".join(parts)
    assert [event["status"] for event in events_of(told)] == ["received"]


def test_a_stream_ends_with_its_token_though_nothing_changes(
    make_api: Callable[..., "Api"], sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "KEEP_ALIVE_S", 0.0)
    api = make_api(sqlite_url, events_longest_s=3600)
    with following(api, api.submit("a").json()["id"]) as parts:
        assert ": still here" in next(parts) + next(parts)
        api.post(f"/tokens/{api.tokens['alpha'].split('_')[2]}/revoke", "alpha")
        more = list(itertools.islice(parts, 20))
    assert len(more) < 20, "it ended long before its longest time"
    assert "event:" not in "".join(more)


def test_a_stream_ends_in_order_when_its_team_becomes_part_of_another(
    make_api: Callable[..., "Api"], sqlite_url: str
) -> None:
    api = make_api(sqlite_url, events_longest_s=3600)
    merged = {"into": "beta", "reason": "one group"}
    with following(api, api.submit("a").json()["id"]) as parts:
        told = next(parts)
        done = api.post("/organizer/teams/alpha/merge", "organizer", json=merged)
        assert done.status_code == 200, done.text
        told += "".join(parts)
    assert [event["status"] for event in events_of(told)] == ["received"]


@pytest.mark.parametrize("longest_s", [0.05])
def test_a_stream_ends_in_time_and_the_follower_connects_again(
    make_api: Callable[..., "Api"], sqlite_url: str, longest_s: float
) -> None:
    api = make_api(sqlite_url, events_longest_s=longest_s)
    own = api.submit("a").json()["id"]
    response = api.get(f"/submissions/{own}/events", "alpha")
    assert [event["status"] for event in events_of(response.text)] == ["received"]
    assert "retry: 2000" in response.text


def test_however_many_follow_a_submission_it_is_polled_once(
    make_api: Callable[..., "Api"], sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two hundred streams of one team kept the API of all others waiting for half a minute."""
    every_s, n_streams = 0.2, 24
    api = make_api(sqlite_url, events_every_s=every_s, events_longest_s=3)
    path = f"/api/v1/submissions/{api.submit('a').json()['id']}/events"
    polls: list[float] = []

    def counted(*arguments: Any) -> Any:
        polls.append(time.monotonic())
        return read(*arguments)

    read = events._read
    monkeypatch.setattr(events, "_read", counted)
    bearer = {"Authorization": f"Bearer {api.tokens['alpha']}"}
    with served(api.app) as address, ThreadPoolExecutor(n_streams) as followers:
        asked = [
            followers.submit(httpx.get, address + path, headers=bearer, timeout=60)
            for _ in range(n_streams)
        ]
        told = [events_of(stream.result().text) for stream in asked]
    assert [len(each) for each in told] == [1] * n_streams
    assert len(polls) <= n_streams + (polls[-1] - polls[0]) / every_s + 1


def test_head_on_a_stream_is_405(api: "Api") -> None:
    own = api.submit("a").json()["id"]
    assert api.request("HEAD", f"/submissions/{own}/events", "alpha").status_code == 405
