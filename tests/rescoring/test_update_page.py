"""The page of an applied run, for every reader: every entry before and after."""

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from sqlalchemy import update

from exceptiondrive_records.notifications.channels import text_of
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.teams.teams import find_team

if TYPE_CHECKING:
    from tests.rescoring.application import Api

Stage = Any
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


def test_readers_see_every_entry_before_and_after_a_run_that_was_applied(
    stage: Stage, api: "Api", make_protocol: Callable[..., str]
) -> None:
    def read(path: str, status: int = 200) -> str:
        answer = api.client.get(path, headers={"Accept": "text/html"})
        assert answer.status_code == status, path
        return str(answer.text)

    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    wanted = {"phase": "dev", "protocol": "1.1", "reason": "kept to ourselves"}
    run = api("POST", "/organizer/rescoring", json=wanted).json()["id"]
    api("POST", f"/organizer/rescoring/{run}/start", json={"reason": "go"})
    stage.work()
    here = f"/rescoring/{run}"
    read(here, 404)
    digest = api("GET", f"/organizer/rescoring/{run}/preview").json()["digest"]
    body = {"preview": digest, "reason": "go"}
    assert api("POST", f"/organizer/rescoring/{run}/apply", json=body).status_code == 200
    assert f'href="{here}"' in read("/history?phase=dev")
    page = read(here)
    assert '<h1 id="h1">Protocol 1.0 to 1.1</h1>' in page
    assert "required clearance of task SE1" in page
    assert "late view" not in page
    late = {"closes_at": "2126-01-01T00:00:00Z", "policy": {"late_entries": "own_view"}}
    assert api("PATCH", "/organizer/phases/dev", json=late).status_code == 200
    assert "Entries of the late view are left out." in read(here)
    for unwanted in ("kept to ourselves", "taken back", "/organize"):
        assert unwanted not in page
    numbers = api("GET", f"/rescoring/{run}", "nobody").json()["comparison"]
    links = re.findall(r'href="(/entries/[^"]+)"', page)
    assert len(links) == len(stage.submitted)
    for one in numbers["entries"]:
        for side in (one["old"], one["new"]):
            assert f"{100 * side['metrics']['hcc']:.2f}" in page
    for board in (numbers["old_board"], numbers["new_board"]):
        read(f"/?phase=dev&board={board}")
        assert f"/?phase=dev&amp;board={board}#board" in page
    gone = stage.submitted[0]
    assert api("POST", f"/submissions/{gone}/withdraw", "alpha").status_code == 200
    stage.work()
    read(f"/entries/{gone}", 404)
    for link in links:
        assert read(link.replace("&amp;", "&")), "as it stood then"
    api("POST", f"/organizer/rescoring/{run}/rollback", json={"reason": "a mistake"})
    assert "It was taken back" in read(here)
    forgotten = api("POST", "/organizer/teams/beta/forget", json={"reason": "asked"})
    alias = forgotten.json()["name"]
    assert alias in read(here)
    assert "Beta" not in read(here)
    with stage.database.write() as session:
        session.execute(update(Phase).values(visibility="hidden"))
    hidden, none = (read(path, 404) for path in (here, "/rescoring/none"))
    assert hidden.count(run) > 0
    assert "phase" not in api("GET", f"/rescoring/{run}", "nobody").json()["detail"]
    assert re.sub(run, "none", _told(hidden)) == _told(none), "told from none by no word"


def test_a_hidden_family_is_called_so(
    stage: Stage, api: "Api", make_protocol: Callable[..., str]
) -> None:
    toml = make_protocol("1.1", "min_samples_per_cell = 1\n", "min_samples_per_cell = 100\n")
    stage.add_protocol(toml)
    wanted = {"phase": "dev", "protocol": "1.1", "reason": "small families"}
    run = api("POST", "/organizer/rescoring", json=wanted).json()["id"]
    api("POST", f"/organizer/rescoring/{run}/start", json={"reason": "go"})
    stage.work()
    digest = api("GET", f"/organizer/rescoring/{run}/preview").json()["digest"]
    api("POST", f"/organizer/rescoring/{run}/apply", json={"preview": digest, "reason": "go"})
    answer = api.client.get(f"/rescoring/{run}", headers={"Accept": "text/html"})
    cells = re.findall(r'<td class="sh fam-col"[^>]*>(.*?)</td>', answer.text, re.DOTALL)
    assert cells
    for cell in cells:
        assert re.match(r"\s*hidden<small>was \d", cell), cell


def test_a_number_that_changes_while_those_that_rank_stay_is_named(
    stage: Stage, api: "Api", make_protocol: Callable[..., str]
) -> None:
    """`slower` keeps more than the required clearance before and after, and HPR asks for no more."""
    stage.submit(0.2, "slower", "beta")
    stage.work()
    run = stage.ready(make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 2.1"))
    stage.apply(run)
    entries = api("GET", f"/rescoring/{run}", "nobody").json()["comparison"]["entries"]
    (one,) = (one for one in entries if one["method"] == "slower")
    assert (one["change"], one["metric_shifts"]["hcc"]) == ("numbers", 0)
    was, now = (f"{100 * one[side]['metrics']['hpr']:.2f} %" for side in ("old", "new"))
    page = api.client.get(f"/rescoring/{run}", headers={"Accept": "text/html"}).text
    assert page.count(f"<small>HPR {now} (was {was})</small>") == 1
    with stage.database.read() as session:
        (told,) = list_notifications(session, find_team(session, "beta").id)
    before, after = re.findall(r"  (?:before|now): +(.+)", text_of(told, "https://board.example"))
    assert after == f"{before}, HPR {now} (was {was})"


def _told(page: str) -> str:
    """What a page of a problem says, without the id of the request."""
    return re.sub(r"[0-9a-f]{32}", "REQUEST", page)
