"""The organizer's routes and the reader's, over the real application."""

import json
import re
import threading
from collections.abc import Callable
from csv import DictReader
from typing import Any

Api = Any
Stage = Any
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")
REASON = {"reason": "because"}


def test_an_update_goes_from_document_to_rollback_over_the_api(
    stage: Stage, api: Api, make_protocol: Callable[..., str]
) -> None:
    toml: dict[str, Any] = {
        "content": make_protocol("1.1", *D_SAFE),
        "headers": {"content-type": "application/toml"},
    }
    checked = api("POST", "/organizer/protocols/check?phase=dev", **toml).json()
    assert checked["sentence"] == "regrade only, 3 sheets"
    against_the_last = "/organizer/protocols/check"
    assert api("POST", against_the_last, **toml).json() == checked, "1.0 is the last"
    assert api("POST", "/organizer/protocols", **toml).status_code == 201
    assert api("POST", against_the_last, **toml).json()["changes"] == [], "now it is the last"
    drafted = api(
        "POST", "/organizer/rescoring", json={"phase": "dev", "protocol": "1.1", **REASON}
    )
    path = f"/organizer/rescoring/{drafted.json()['id']}"
    assert api("POST", f"{path}/start", json=REASON).json()["state"] == "scoring"
    stage.work()
    before = api("GET", "/leaderboard?phase=dev", "nobody")
    address = {"channel": "email", "address": "alpha@example.org"}
    assert api("POST", "/contacts", "alpha", json=address).json()["last_message"] is None
    preview = api("GET", f"{path}/preview").json()
    csv = api("GET", f"{path}/preview.csv").text.splitlines()
    assert len(csv) == 1 + preview["comparison"]["n_entries"]
    told = list(DictReader(csv))
    assert {"old_rank_low", "new_rank_high", "new_hcc.sudden_emergence"} <= set(told[0])
    assert {row["newly_failing"] for row in told} == {"False"}, "as in the board's CSV"
    assert compared(csv) == {("apply", "dev", "1.0", "1.1")}
    stale = api("POST", f"{path}/apply", json={"preview": "sha256:0", **REASON})
    assert (stale.status_code, "or it is none of this run" in stale.json()["detail"]) == (
        409,
        True,
    )
    applied = api("POST", f"{path}/apply", json={"preview": preview["digest"], **REASON})
    assert applied.json()["state"] == "applied"
    back = api("GET", f"{path}/preview.csv").text.splitlines()
    assert compared(back) == {("roll_back", "dev", "1.1", "1.0")}
    public = api("GET", f"/rescoring/{drafted.json()['id']}", "nobody").json()
    assert public["comparison"] == preview["comparison"]
    assert "reason" not in public
    last = api("GET", "/contacts", "alpha").json()[0]["last_message"]
    assert last == {"state": "waiting", "attempts": 0, "sent_at": None}
    (told,) = api("GET", "/notifications?unread=true", "alpha").json()
    assert api("POST", f"/notifications/{told['id']}/read", "alpha").json()["read_at"]
    assert api("GET", "/notifications?unread=true", "alpha").json() == []
    assert api("POST", f"{path}/rollback", json=REASON).json()["state"] == "rolled_back"
    done = api("GET", f"{path}/preview.csv").text.splitlines()
    assert compared(done) == {("applied", "dev", "1.0", "1.1")}
    assert api("GET", "/leaderboard?phase=dev", "nobody").content == before.content
    history = api("GET", "/boards?phase=dev", "nobody").json()
    assert [line["protocol"]["version"] for line in history[:3]] == ["1.0", "1.1", "1.0"]
    for line in history:  # at the very moment of a flip the new board counts
        shown = api("GET", f"/leaderboard?phase=dev&as_of={line['shown_from']}", "nobody").json()
        assert shown["board"] == line["board"]


def compared(lines: list[str]) -> set[tuple[str, ...]]:
    """What a comparison as CSV says that it compares, of all its lines."""
    keys = ("direction", "phase", "old_protocol", "new_protocol")
    return {tuple(row[key] for key in keys) for row in DictReader(lines)}


def test_a_protocol_that_nobody_can_mean_is_refused_by_check_and_add_alike(
    api: Api, make_protocol: Callable[..., str]
) -> None:
    toml = make_protocol("1.1", "footprint_length_m = 4.084", "footprint_length_m = 60.0")
    toml = re.sub(r'changes = ".*"', 'changes = ""', toml)
    for path in ("/organizer/protocols/check", "/organizer/protocols"):
        refused = api("POST", path, content=toml, headers={"Content-Type": "application/toml"})
        assert refused.status_code == 400, refused.text
        assert "no vehicle is 60 m" in refused.json()["detail"]
        assert "changes: is empty" in refused.json()["detail"]


def test_every_response_during_the_flip_is_one_whole_board(
    stage: Stage, api: Api, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    seen: set[tuple[str, bytes]] = set()
    stop = threading.Event()

    def read() -> None:
        while not stop.is_set():
            answer = api("GET", "/leaderboard?phase=dev", "nobody")
            seen.add((answer.headers["etag"], answer.content))

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    for _ in range(3):
        stage.apply(run_id)
        stage.rollback(run_id)
        run_id = stage.draft(protocol="1.1")
        stage.step("start", run_id)
        stage.work()
    stop.set()
    for reader in readers:
        reader.join()
    assert len({etag for etag, _ in seen}) == len(seen) <= 2
    for etag, body in seen:
        assert json.loads(body)["protocol"]["version"] in ("1.0", "1.1")
        assert etag


def test_only_organizers_steer_and_each_step_needs_a_reason(api: Api) -> None:
    wanted = {"phase": "dev", "protocol": "1.0"}
    assert (
        api("POST", "/organizer/rescoring", "alpha", json={**wanted, **REASON}).status_code == 403
    )
    assert api("POST", "/organizer/rescoring", "nobody", json=wanted).status_code == 401
    for step in ("start", "pause", "resume", "apply", "cancel", "rollback", "close"):
        assert api("POST", f"/organizer/rescoring/x/{step}", json={}).status_code == 400
    assert api("POST", "/organizer/rescoring", json=wanted).status_code == 400


def test_a_draft_is_for_organizers_alone(
    stage: Stage, api: Api, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    number = stage.preview(run_id).comparison.new_board
    for path in (
        f"/rescoring/{run_id}",
        f"/boards/dev/{number}",
        "/leaderboard?phase=dev&protocol=1.1",
    ):
        assert api("GET", path, "nobody").status_code == 404


def test_a_webhook_secret_is_shown_once(api: Api) -> None:
    wanted = {"channel": "webhook", "address": "https://example.org/hook"}
    added = api("POST", "/contacts", "alpha", json=wanted)
    assert added.json()["secret"].startswith("edw_")
    assert api("GET", "/contacts", "alpha").json()[0]["secret"] is None
    assert api("POST", "/contacts", "alpha", json=wanted).status_code == 409
    removed = api("POST", f"/contacts/{added.json()['id']}/remove", "alpha")
    assert removed.status_code == 200
    assert api("GET", "/contacts", "alpha").json() == []


def test_no_route_takes_a_score_or_a_rank(api: Api) -> None:
    document = api.client.app.openapi()
    schemas = document["components"]["schemas"]
    numbers = {"score", "rank", "metrics", "micro", "macro_family", "sheet", "hcc", "ur", "entries"}
    for path, methods in document["paths"].items():
        for method, route in methods.items():
            assert method in ("get", "post", "put", "patch", "delete", "head"), path
            bodies = json.dumps(route.get("requestBody", {}))
            for name, schema in schemas.items():
                if f'"#/components/schemas/{name}"' in bodies:
                    assert not numbers & set(schema.get("properties", {})), (path, name)
