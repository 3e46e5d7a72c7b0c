"""What stands wrongly is said at once: in the organizers' overview, by the doctor, in the metrics.

And to teams, where it is about what nobody checks of their files.
"""

import html
import os
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.phases.browsing import visitor
from tests.phases.life import SAMPLES, Beginning, Life, split_of
from tests.support.work import claim_board_of, let_time_pass
from tests.support.worker import due_jobs, score_submission
from typer.testing import CliRunner

from exceptiondrive.cli import app
from exceptiondrive_records.operations.garbage import UnknownFiles, sweep_orphans
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.phases.phases import find_phase, splits_in_use
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.lease import give_up_lead, take_lead
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_server.operations.doctor import Severity, examine
from exceptiondrive_worker.boards import run
from exceptiondrive_worker.boards.run import build_next_board
from exceptiondrive_worker.splits.store import SplitStore, SplitUnavailableError

BOTH = (Lane.LIVE, Lane.RESCORE)


def told(life: Life) -> list[tuple[str, str]]:
    """Say which troubles there are, after all three places told the same."""
    with life.database.read() as session:
        found = troubles(session)
    page = html.unescape(visitor(life, "organizer").get("/organize").text)
    doctor = [one for one in examine(life.server) if one.severity is Severity.WARNING]
    gauges = life.client.get("/metrics").text
    for one in found:
        assert one.what in page
        assert (one.what, one.do) in [(finding.what, finding.do) for finding in doctor]
        assert (
            f'exceptiondrive_troubles{{subject="{one.subject}",trouble="{one.code}"}} 1.0' in gauges
        )
    assert gauges.count("exceptiondrive_troubles{") == len(found)
    return [(one.code, one.subject) for one in found]


def say_alive(life: Life, store: SplitStore, lanes: tuple[Lane, ...] = BOTH) -> None:
    """Give a worker's sign of life, as its heartbeat does."""
    with life.database.read() as session:
        missing = store.missing(splits_in_use(session))
    with life.database.write() as session:
        beat(session, "worker", lanes, missing_splits=missing)


@pytest.fixture
def beginning() -> Beginning:
    return "driven", open_driven


def open_driven(life: Life) -> None:
    recorded = split_of({k: (t, m, None) for k, (t, m, _) in SAMPLES.items()}, "driven")
    path = tuple((2.0 * step, 0.0) for step in range(1, 7))
    samples = tuple(one.model_copy(update={"recorded": path}) for one in recorded.samples)
    life.add_split(recorded.model_copy(update={"samples": samples}))
    life.make_phase("driven", split="driven", policy={"live_part": "whole"})
    with life.database.write() as session:
        take_lead(session, "reconciler", "somebody", 86_400)


@pytest.fixture
def store(life: Life) -> SplitStore:
    return SplitStore(life.worker.splits_dir)


def test_a_server_whose_parts_are_all_there_has_none(life: Life, store: SplitStore) -> None:
    say_alive(life, store)
    assert told(life) == []


def test_a_server_without_a_reconciler(life: Life, store: SplitStore) -> None:
    """Uploads are scored all the same, so nobody would notice that no mail goes out."""
    say_alive(life, store)
    with life.database.write() as session:
        give_up_lead(session, "reconciler", "somebody")
    assert told(life) == [("no_reconciler", "reconciler")]


def test_a_file_store_with_files_that_no_record_knows(
    life: Life, store: SplitStore, tmp_path: Path
) -> None:
    files = FileStore((tmp_path / "of-another").as_uri())
    digest, _ = files.put_stream([b"later"], limit_bytes=9)
    os.utime(tmp_path / "of-another" / digest[7:9] / digest[7:], (0, 0))
    with pytest.raises(UnknownFiles):
        sweep_orphans(life.database, files, actor="reconciler", at_most=0)
    say_alive(life, store)
    assert told(life) == [("files_without_record", "file store")]
    sweep_orphans(life.database, files, actor="operator")
    assert told(life) == []


@pytest.mark.parametrize(
    ("lanes", "idle"),
    [((), "live"), ((Lane.LIVE,), "rescore"), ((Lane.RESCORE,), "live")],
)
def test_a_lane_without_a_worker(
    life: Life, store: SplitStore, lanes: tuple[Lane, ...], idle: str
) -> None:
    if lanes:
        say_alive(life, store, lanes)
    assert told(life) == [("lane_without_worker", idle)]


def test_a_split_without_its_file_or_under_another_name(life: Life, store: SplitStore) -> None:
    folder: Path = life.worker.splits_dir / "driven"
    folder.rename(folder.with_name("other"))
    say_alive(life, store)
    assert told(life) == [("split_without_file", "driven")]
    folder.with_name("other").rename(folder)
    say_alive(life, store)
    assert told(life) == []


def test_a_split_whose_floors_cannot_be_read(life: Life, store: SplitStore) -> None:
    floors: Path = life.worker.splits_dir / "driven" / "floors.toml"
    floors.write_text("max_protocol = 3\n")
    waiting = life.submit("alpha", 4.0, "Planner", "driven", "driven")
    say_alive(life, store)
    assert told(life) == [("split_without_file", "driven")]
    assert life.json(f"/api/v1/submissions/{waiting}", "alpha")["queue"]["workers_alive"] == 0
    floors.write_text("max_protocols = 3\n")
    say_alive(life, store)
    assert told(life) == []


def test_a_split_that_was_asked_for_while_its_file_is_away_is_told_once(
    life: Life, store: SplitStore
) -> None:
    folder = life.worker.splits_dir / "driven"
    folder.rename(folder.with_name("other"))
    with pytest.raises(SplitUnavailableError):
        store.find("driven", "sha256:asked", packaged_protocol())
    say_alive(life, store)
    assert told(life) == [("split_without_file", "driven")]


def test_a_split_that_one_of_two_workers_lacks_keeps_nothing_waiting(
    life: Life, store: SplitStore
) -> None:
    def sentence(*lanes: Lane) -> tuple[str, bool]:
        with life.database.write() as session:
            beat(session, "another", lanes)
        assert ("split_without_file", "driven") in told(life)
        with life.database.read() as session:
            (found,) = (one for one in troubles(session) if one.code == "split_without_file")
        return found.what.partition(": ")[2], found.stops_scoring

    (life.worker.splits_dir / "driven").rename(life.worker.splits_dir / "other")
    say_alive(life, store)
    assert sentence(Lane.RESCORE) == ("its submissions wait.", True)
    assert sentence(*BOTH) == ("the others alone score its submissions.", False)


def test_a_split_whose_file_is_of_another_revision(life: Life, store: SplitStore) -> None:
    life.make_phase("plain", split="plain", policy={"live_part": "whole"})
    newer = split_of({"a": ("LB1", 10.0, None)}, "plain")
    file = life.worker.splits_dir / "plain" / "split.json"
    file.write_text(newer.model_dump_json(by_alias=True, exclude_none=True))
    revision = life.json("/api/v1/phases/plain")["split_revision"]
    with pytest.raises(SplitUnavailableError):
        store.find("plain", revision, packaged_protocol())
    assert store.missing(["driven", "plain"]) == [f"plain@{revision}"]
    say_alive(life, store)
    assert ("split_without_file", f"plain@{revision}") in told(life)
    with pytest.raises(SplitUnavailableError):
        store.find("driven", "sha256:later", packaged_protocol())
    say_alive(life, store)
    with life.database.read() as session:
        found = {one.subject: one for one in troubles(session)}
    shown, later = found[f"plain@{revision}"], found["driven@sha256:later"]
    assert (shown.what.partition(": its ")[2], shown.stops_scoring) == ("submissions wait.", True)
    assert later.what.endswith("driven at the revision sha256:later: sheets of a rescoring wait.")
    assert not later.stops_scoring


def test_a_phase_on_a_split_without_recorded_drives_says_so_to_both_sides(
    life: Life, store: SplitStore
) -> None:
    made: dict[str, Any] = life.make_phase("plain", split="plain")
    say_alive(life, store)
    assert told(life) == [("no_recorded_drives", "plain")]
    (sentence,) = made["not_checked"]
    assert "no recorded drives" in sentence
    assert life.json("/api/v1/phases/driven")["not_checked"] == []
    for address in ("/phases/plain", "/submit?phase=plain"):
        assert sentence in html.unescape(life.client.get(address).text)
    for address in ("/phases/driven", "/submit?phase=driven"):
        assert "no recorded drives" not in life.client.get(address).text
    organizer = visitor(life, "organizer")
    life.make_phase("beside", split="plain", policy={"live_part": "whole"})
    beside = html.unescape(organizer.get("/organize/phases/beside").text)
    assert "(beside) has no" in beside
    assert "(plain) has no" not in beside, "a phase may have the name of the split of another"
    page = html.unescape(organizer.get("/organize/phases/plain").text)
    assert "exceptiondrive-worker add-drives" in page
    assert "no_recorded_drive" in organizer.get("/organize/phases").text
    with life.database.read() as session:
        (found,) = [one for one in troubles(session) if one.code == "no_recorded_drives"]
    assert found.subject == "plain"
    assert found.what.startswith(
        "Split plain of phases Test (plain), Test (beside) has no recorded drives"
    )
    assert life.make_phase("letters", split="plain", challenge="strategy")["not_checked"] == []


@pytest.mark.parametrize(
    ("has_board", "seen_meanwhile"),
    [(True, "readers see the one before."), (False, "there is none yet.")],
)
def test_a_board_that_is_begun_again_and_again(
    life: Life,
    store: SplitStore,
    monkeypatch: pytest.MonkeyPatch,
    has_board: bool,
    seen_meanwhile: str,
) -> None:
    life.submit("alpha", 4.0, "Planner", "driven", "driven")
    if has_board:
        life.work()
        life.submit("beta", 5.0, "Planner", "driven", "driven")
    with monkeypatch.context() as little_memory:
        little_memory.setattr(run, "board_entries", raising(MemoryError))
        for seen in ([], [("board_not_built", "driven")]):
            for job_id in due_jobs(life.database):
                score_submission(life.context, job_id)
            assert build_next_board(life.context, Lane.LIVE)
            say_alive(life, store)
            assert told(life) == seen
            with life.database.read() as session:
                ends = [one.what.endswith(seen_meanwhile) for one in troubles(session)]
            assert ends == [True] * len(seen)
            with life.database.write() as session:
                let_time_pass(session, timedelta(hours=1))
    assert build_next_board(life.context, Lane.LIVE)
    say_alive(life, store)
    assert told(life) == []


def test_a_board_that_is_asked_for_while_it_is_built_was_not_begun_in_vain(
    life: Life, store: SplitStore
) -> None:
    life.submit("alpha", 4.0, "Planner", "driven", "driven")
    life.work()
    with life.database.read() as session:
        digest = find_phase(session, "driven").protocol_digest
    for _ in range(3):
        with life.database.write() as session:
            want_board(session, "driven", digest)
        with life.database.write() as session:
            claimed = claim_board_of(session, "driven", digest)
        assert claimed is not None
        with life.database.write() as session:
            want_board(session, "driven", digest)
        run.build_board(life.context, claimed)
        with life.database.write() as session:
            assert claim_board_of(session, "driven", digest) is not None
        say_alive(life, store)
        assert told(life) == []
        with life.database.write() as session:
            let_time_pass(session, timedelta(hours=1))
        assert build_next_board(life.context, Lane.LIVE)


def raising(error: type[Exception]) -> Any:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    return fail


def test_the_papers_rows_beside_a_withheld_split(
    life: Life, store: SplitStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    life.change({"shows_reported": True}, "driven")
    say_alive(life, store)
    assert told(life) == [("reported_beside_other_split", "driven")]
    with life.database.read() as session:
        (found,) = troubles(session)
    words = found.do.split()[1:]
    environment = {
        "EXCEPTIONDRIVE_SERVER": "http://127.0.0.1:1",
        "EXCEPTIONDRIVE_TOKEN": "edk_none",
    }
    monkeypatch.setattr("exceptiondrive.transport.LONGEST_OF_ALL_RETRIES_S", -1.0)  # asked once
    done = CliRunner().invoke(app, words, env=environment)
    assert done.exit_code != 2, f"what is advised is no command: {done.stderr}"
    life.done("/phases/driven", {"visibility": "archived"}, "PATCH")
    assert told(life) == []
