"""Before a run begins, a worker tries the split under the new protocol or revision, and says why it does not fit."""

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import delete, update
from tests.canary.values import CANARY_M
from tests.phases.browsing import visitor
from tests.phases.life import CAREFUL
from tests.support.documents import region_ahead, split_document
from tests.support.floors import let_begin_together, write_floors

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.operations.reconciler import reconcile_once
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.splits.openings import opened_protocols
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_records.work.tables import Trial, WorkState
from exceptiondrive_schemas.protocol import packaged_protocol_toml, parse_protocol
from exceptiondrive_worker.splits.admin import publish_split_file
from exceptiondrive_worker.trial_run import try_next_split

if TYPE_CHECKING:
    from tests.phases.life import Life

TOUCH = "hazard regions that touch the footprint at t = 0"


def draft(life: "Life", version: str, phase: str = "test", **geometry: float) -> Any:
    toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
    usual = {"footprint_length_m": 4.084, "footprint_width_m": 1.85, "min_samples_per_cell": 1}
    for name, value in geometry.items():
        assert f"{name} = {usual[name]}" in toml
        toml = toml.replace(f"{name} = {usual[name]}", f"{name} = {value}")
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    return life.done("/rescoring", {"phase": phase, "protocol": version, "reason": "try"})


def seen(life: "Life", run: Any) -> Any:
    return life.json(f"/api/v1/organizer/rescoring/{run['id']}", "organizer")


@pytest.fixture
def scored(life: "Life") -> "Life":
    life.make_phase(split="plain")
    life.submit("alpha", 5.0, "Planner", "plain")
    life.work()
    return life


def test_regions_that_touch_the_new_footprint_are_told_before_anything_begins(
    scored: "Life",
) -> None:
    run = draft(scored, "1.2", footprint_length_m=20.0)
    assert run["trial"] == {"state": "waiting", "found": []}
    page = f"/organize/rescoring/{run['id']}"
    organizer = visitor(scored, "organizer")
    assert "A worker will try the split" in organizer.get(page).text
    scored.work()
    after = seen(scored, run)
    assert after["trial"] == {"state": "refused", "found": [{"what": f"some {TOUCH}", "n": None}]}
    assert after["actions"] == ["cancel"]
    text = organizer.get(page).text
    assert f"some {TOUCH}" in text
    assert "Start scoring" not in text
    for words in (text, str(after)):
        assert str(CANARY_M)[:8] not in words
        assert "scene-" not in words
    for place in (page, "/organize"):
        told = organizer.get(place).text
        assert "drafted, but it cannot be started: cancel it." in told, place
        assert "until you start it" not in told, place
    refused = scored.refused(f"/rescoring/{run['id']}/start", {"reason": "go"}, 409)
    assert f"some {TOUCH}" in refused
    assert "Teams can do nothing about it" in refused
    assert scored.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})["state"] == "cancelled"
    assert len(scored.entry_ids()) == 1


def test_a_split_that_fits_is_said_to_fit(scored: "Life") -> None:
    run = draft(scored, "1.2", footprint_width_m=1.9)
    scored.work()
    assert seen(scored, run)["trial"]["state"] == "fits"
    organizer, page = visitor(scored, "organizer"), f"/organize/rescoring/{run['id']}"
    text = organizer.get(page).text
    assert "it can be scored" in text
    assert "<code>organizer rescore begin</code>" in text
    assert "<dd>Test</dd>" in organizer.get(f"{page}/start").text
    scored.done(f"/rescoring/{run['id']}/start", {"reason": "go"})
    scored.work()
    assert seen(scored, run)["state"] == "ready"
    for shown in (text, organizer.get(f"{page}/preview").text):
        assert "<b>Test</b>" in shown, "the phase is called by its title"


def test_a_split_that_ends_its_worker_each_time_is_said_not_to_have_been_tried(
    scored: "Life",
) -> None:
    run = draft(scored, "1.2", footprint_width_m=1.9)
    with scored.database.write() as session:
        past = database_now(session) - timedelta(hours=1)
        session.execute(update(Trial).values(state=WorkState.LEASED, lease_until=past, attempts=4))
    nobody = Dispatcher("redis://127.0.0.1:1/0")
    reconcile_once(scored.database, nobody, RecordsSettings(max_attempts=4))
    assert seen(scored, run)["trial"]["state"] == "failed"
    text = visitor(scored, "organizer").get(f"/organize/rescoring/{run['id']}").text
    assert "could not be tried: trying it did not finish in any of its attempts" in text


def test_a_run_that_was_begun_at_once_fails_with_a_reason_for_all_sheets(scored: "Life") -> None:
    scored.submit("beta", 6.0, "Other", "plain")
    scored.work()
    run = draft(scored, "1.2", footprint_length_m=20.0)
    scored.done(f"/rescoring/{run['id']}/start", {"reason": "go"})
    scored.work()
    (blocker,) = seen(scored, run)["blockers"]
    assert f"some {TOUCH}" in blocker
    assert "withdraw ID" not in blocker


def test_floors_hold_for_trials_and_trials_count_among_the_protocols(scored: "Life") -> None:
    run = draft(scored, "1.2", footprint_length_m=40.0)
    scored.work()
    trial = seen(scored, run)["trial"]
    assert trial["state"] == "held"
    assert "footprint_length_m" in str(trial["found"])
    assert TOUCH not in str(trial)
    (blocker,) = seen(scored, run)["blockers"]
    assert "The floors of the withheld split forbid it: footprint_length_m" in blocker
    assert "Cancel the run" in blocker
    browser = visitor(scored, "organizer")
    told = "The floors of split plain refused"
    overview = browser.get("/organize").text
    assert told in overview
    assert "drafted, but the floors of its split forbid it" in overview
    scored.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})
    assert told not in browser.get("/organize").text
    bound(scored, 2)
    for version, length_m in (("1.3", 18.0), ("1.4", 22.0)):
        run = draft(scored, version, footprint_length_m=length_m)
        scored.work()
        trial = seen(scored, run)["trial"]
        scored.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})
    assert "at most 2" in str(trial)
    actions = [line["action"] for line in scored.json("/api/v1/organizer/audit", "organizer")]
    assert "split floor held" in actions


def test_the_overview_says_what_floors_hold_of_one_part_while_another_is_scored(
    life: "Life",
) -> None:
    folder = life.worker.splits_dir / "parted"
    write_floors(folder, "private_part_from = 2999-01-01T00:00:00Z")
    life.make_phase(closes_at=life.ahead(60))
    life.submit("alpha", CAREFUL)
    life.work()
    life.done("/phases/test/reveal", {"what": "split", "reason": "too early"})
    life.work()
    life.submit("beta", CAREFUL)
    life.work()
    browser, told = visitor(life, "organizer"), "the private part is closed until 2999-01-01"
    assert told in browser.get("/organize").text
    (run,) = life.json("/api/v1/organizer/rescoring", "organizer")
    life.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})
    assert told not in browser.get("/organize").text


def bound(life: "Life", max_protocols: int) -> None:
    write_floors(life.worker.splits_dir / "plain", f"max_protocols = {max_protocols}")


def test_trials_stop_no_submission_under_what_the_split_was_scored_under(scored: "Life") -> None:
    run = draft(scored, "1.2", footprint_length_m=18.0)
    scored.work()
    assert seen(scored, run)["trial"]["state"] == "refused"
    bound(scored, 1)
    submission_id = scored.submit("beta", 6.0, "Other", "plain")
    scored.work()
    assert submission_id in scored.entry_ids()
    scored.make_phase("other", split="plain")
    other = draft(scored, "1.3", "other", footprint_width_m=1.9)
    scored.work()
    assert seen(scored, other)["trial"]["state"] == "held"


def test_two_trials_at_once_take_no_more_than_is_left(
    scored: "Life", monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are let pass at first, since neither is counted."""
    scored.make_phase("other", split="plain")
    bound(scored, 2)
    runs = [
        draft(scored, "1.2", footprint_width_m=1.9),
        draft(scored, "1.3", "other", footprint_width_m=1.95),
    ]
    let_begin_together(monkeypatch)
    with ThreadPoolExecutor(2) as pool:
        assert all(pool.map(lambda _: try_next_split(scored.context), runs))
    assert sorted(seen(scored, run)["trial"]["state"] for run in runs) == ["fits", "held"]
    with scored.database.read() as session:
        assert len(opened_protocols(session, "plain")) == 2


def test_what_the_server_makes_of_a_run_later_takes_no_trial_out_of_the_count(
    scored: "Life",
) -> None:
    scored.make_phase("other", split="plain")
    bound(scored, 2)
    run = draft(scored, "1.2", footprint_length_m=18.0)
    scored.work()
    scored.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})
    with scored.database.write() as session:
        session.execute(
            update(RescoringRun).values(
                to_protocol_digest=RescoringRun.from_protocol_digest, phase_id="other"
            )
        )
        session.execute(delete(Trial))
    run = draft(scored, "1.3", footprint_length_m=22.0)
    scored.work()
    trial = seen(scored, run)["trial"]
    assert trial["state"] == "held"
    assert "at most 2" in str(trial["found"])


def test_samples_of_a_withheld_split_are_never_counted_out(scored: "Life") -> None:
    """Each protocol that the floors let pass would be a count of regions, exact to one."""
    for n, length_m in ((2, 18.0), (3, 20.0)):
        run = draft(scored, f"1.{n}", footprint_length_m=length_m, min_samples_per_cell=1)
        scored.work()
        found = seen(scored, run)["trial"]["found"]
        assert found == [{"what": f"some {TOUCH}", "n": None}]
        page = visitor(scored, "organizer").get(f"/organize/rescoring/{run['id']}").text
        for words in (page, str(seen(scored, run))):
            assert f"2 {TOUCH}" not in words
        scored.done(f"/rescoring/{run['id']}/cancel", {"reason": "no"})


def test_samples_of_a_public_split_are_counted_and_no_floor_holds(scored: "Life") -> None:
    split = split_document({"s": {"region": region_ahead(10.0)}}, "open")
    scored.add_split(split)
    scored.make_phase("open", split="open")
    context, protocol = scored.context, parse_protocol(packaged_protocol_toml())
    publish_split_file(scored.database, context.files, context.splits, "open", protocol)
    run = draft(scored, "1.2", "open", footprint_length_m=40.0)
    scored.work()
    assert seen(scored, run)["trial"]["found"] == [{"what": TOUCH, "n": 1}]
