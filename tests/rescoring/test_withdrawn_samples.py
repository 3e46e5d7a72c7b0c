"""A revision that withdraws samples and moves regions, from the workshop to the board and back."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session
from tests.build.deciding import PEOPLE, decisions, record
from tests.build.shop import make_shop
from tests.rescoring.documents import split_document
from tests.rescoring.stage import STEP, Stage
from tests.support import documents
from tests.support.floors import leave_open
from tests.support.records import add_phase
from typer.testing import CliRunner

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.cli import app
from exceptiondrive_build.records import Kind
from exceptiondrive_build.values import Verified
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.rescoring import changes
from exceptiondrive_records.rescoring.comparison import split_steps
from exceptiondrive_records.rescoring.views import board_history, public_run
from exceptiondrive_records.splits.shown import shown_revision
from exceptiondrive_records.splits.splits import find_split, publish_split
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.teams.teams import create_team, find_team
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import packaged_protocol, parse_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.admin import register_all_splits
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.store import SplitStore, load_split, read_split
from exceptiondrive_worker.stages import Target
from exceptiondrive_worker.upload_reader import read_upload

CANARY_M = 14.271828
WORDS = "Sample b failed the audit; the region of d lay too far."


def revised(split: Split) -> Split:
    """Sample b withdrawn, and the region of d nearer."""
    changes: dict[str, dict[str, Any]] = {
        "b": {"withdrawn": "The hazard stands on the pavement."},
        "d": {"region": ((7.0, -1.0), (9.0, -1.0), (9.0, 1.0), (7.0, 1.0))},
    }
    samples = [it.model_copy(update=changes.get(it.sample_id, {})) for it in split.samples]
    return split.model_copy(update={"samples": tuple(samples)})


def put_revision(stage: Stage, split: Split, words: str = WORDS, number: int = 2) -> str:
    """Put a later revision beside the earlier one, and register it with words for readers."""
    path = stage.settings.splits_dir / "tiny" / f"split-{number}.json"
    path.write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    splits = SplitStore(stage.settings.splits_dir)
    register_all_splits(stage.context.database, splits, packaged_protocol(), words)
    return split.revision


def told(session: Session, stage: Stage) -> list[tuple[str, ...]]:
    team = find_team(session, "alpha")
    notices = list_notifications(session, team.id)
    assert all("of split tiny" in notice.title for notice in notices)
    return [notice.what_changed for notice in notices]


def test_old_files_answer_what_is_withdrawn_and_no_sheet_counts_it(stage: Stage) -> None:
    before = stage.board()
    later = revised(split_document())
    run_id = stage.draft(split_revision=put_revision(stage, later))
    expected = (
        WORDS,
        "the region of 1 sample changes",
        "1 sample withdrawn: files still answer, none counts",
        "N goes from 4 to 3",
    )
    assert stage.view(run_id).difference.sentences == expected
    stage.step("start", run_id)
    stage.work()
    stage.apply(run_id)
    board = json.loads(stage.board())
    assert (json.loads(before)["n_samples"], board["n_samples"]) == (4, 3)
    assert board["split"]["revision"] == later.revision
    with stage.database.read() as session:
        assert board_history(session, "dev")[0].what_changed == expected
        assert public_run(session, run_id).changes == WORDS
        assert told(session, stage)[0] == expected
    fresh = stage.submit(1.5, "later", "gamma")
    stage.work()
    assert fresh in stage.board(), "a file that answers all four is still what is asked for"
    stage.rollback(run_id)
    assert json.loads(stage.board())["n_samples"] == 4


def test_a_run_tells_that_a_later_revision_of_a_public_split_is_withheld_until_it_is_published(
    stage: Stage,
) -> None:
    first, later = split_document(), revised(split_document())
    run_id = stage.draft(split_revision=put_revision(stage, later))
    told = "the regions of the new revision are withheld; those of the earlier one are public"
    assert told not in stage.view(run_id).difference.sentences
    for split, sentences in ((first, [told]), (later, [])):
        with stage.context.database.write() as session:
            publish_split(session, "tiny", split.revision, bytes_digest(b"its file"), "ops")
        assert [one for one in stage.view(run_id).difference.sentences if "public" in one] == (
            sentences
        )


def test_a_run_over_two_revisions_tells_what_each_of_them_changed(stage: Stage) -> None:
    second = revised(split_document())
    first = second.model_copy(
        update={
            "samples": tuple(it.model_copy(update={"withdrawn": None}) for it in second.samples)
        }
    )
    put_revision(stage, first, "The region of d lay too far.")
    run_id = stage.draft(split_revision=put_revision(stage, second, "b failed the audit.", 3))
    assert stage.view(run_id).difference.sentences == (
        "The region of d lay too far.",
        "in a revision between: the region of 1 sample changes",
        "b failed the audit.",
        "1 sample withdrawn: files still answer, none counts",
        "N goes from 4 to 3",
    )
    stage.step("start", run_id)
    stage.work()
    stage.apply(run_id)
    with stage.database.read() as session:
        changes = public_run(session, run_id).changes
    assert changes == "The region of d lay too far. b failed the audit."


def test_of_the_steps_from_one_revision_to_another_no_earlier_one_is_told_and_none_on_the_way_back(
    stage: Stage,
) -> None:
    first, third = split_document(), revised(split_document())
    near = third.samples[3]
    second = first.model_copy(update={"samples": (*first.samples[:3], near)})
    put_revision(stage, second, "The region of d lay too far.")
    put_revision(stage, third, "b failed the audit.", 3)
    with stage.database.read() as session:
        rows = [find_split(session, "tiny", it.revision) for it in (first, second, third)]
        ways = [[rows[1], rows[2]], [rows[2], rows[1]], [rows[0], rows[2]]]
        told = [[step.words for step in split_steps(session, *way)] for way in ways]
    both = ["The region of d lay too far.", "b failed the audit."]
    assert told == [both[1:], [], both]


def test_the_sheet_is_that_of_a_split_without_the_sample(stage: Stage) -> None:
    """Scored by another way: the three samples that are left, as a split of their own."""
    later = revised(split_document())
    run_id = stage.draft(split_revision=put_revision(stage, later))
    stage.step("start", run_id)
    stage.work()
    stage.apply(run_id)
    left = later.model_copy(update={"samples": later.counted})
    shorter = load_split(left, packaged_protocol())
    for speed_mps, method in ((1.0, "slow"), (2.0, "middle"), (6.0, "fast")):
        answers = read_upload(
            documents.planning_file(dict.fromkeys("acd", speed_mps)),
            challenge=PLANNING,
            manifest=shorter.manifest,
            protocol=packaged_protocol(),
        )
        assert not isinstance(answers, CheckReport)
        target = Target(method, PLANNING, shorter, packaged_protocol(), made=answers)
        exact = stage.context.stages.score(target).sheet
        (entry,) = [it for it in json.loads(stage.board())["entries"] if it["method"] == method]
        for key in ("hcc", "ur"):
            value = exact.macro_family[key]
            assert value is not None
            assert entry["metrics"][key] == pytest.approx(value, abs=5e-5)


def test_a_region_that_a_new_footprint_touches_can_be_withdrawn(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    """The larger car touches it before it moves: the protocol alone fails, with the revision not."""
    longer = make_protocol("1.2", "footprint_length_m = 4.084", "footprint_length_m = 4.8")
    near = ((3.7, -1.0), (5.7, -1.0), (5.7, 1.0), (3.7, 1.0))
    first = split_document()
    samples = [
        it.model_copy(update={"region": near}) if it.sample_id == "b" else it
        for it in first.samples
    ]
    crowded = first.model_copy(update={"samples": tuple(samples)})
    with pytest.raises(SplitRefusedError, match="touch the footprint"):
        load_split(crowded, parse_protocol(longer))
    withdrawn = crowded.model_copy(
        update={
            "samples": tuple(
                it.model_copy(update={"withdrawn": "Too near."}) if it.region == near else it
                for it in crowded.samples
            )
        }
    )
    assert load_split(withdrawn, parse_protocol(longer)).arrays.n_samples == 3


# From the workshop.


@pytest.fixture
def shop(tmp_path: Path) -> Path:
    folder = make_shop(tmp_path / "made", width_px=160)
    with Workshop(folder) as workshop:
        workshop.records.append(*decisions(workshop))
    return folder


def build(*command: str | Path) -> None:
    result = CliRunner().invoke(app, [str(part) for part in command])
    assert result.exit_code == 0, result.output


def hang_up(stage: Stage, frozen: Path, suffix: str = "") -> Split:
    """Take a frozen split to the worker, as an organizer does."""
    folder = stage.settings.splits_dir / "made-2027"
    leave_open(folder)
    (folder / f"split{suffix}.json.gz").write_bytes((frozen / "split.json.gz").read_bytes())
    (folder / f"datasheet{suffix}.json").write_bytes((frozen / "datasheet.json").read_bytes())
    splits = SplitStore(stage.settings.splits_dir)
    register_all_splits(stage.context.database, splits, packaged_protocol())
    return read_split(folder / f"split{suffix}.json.gz")


def submit(stage: Stage, split: Split, speed_mps: float) -> None:
    answers = documents.planning_file(
        {it.sample_id: speed_mps for it in split.samples}, split=split.name
    )
    digest, size = stage.context.files.put_stream([answers], limit_bytes=2**20)
    with stage.database.write() as session:
        slug = f"team-{10 * speed_mps:g}"
        team = create_team(session, slug, slug, actor="test")
        accept(
            session,
            team_id=team.id,
            phase_id="made",
            method=f"at {speed_mps:g} m/s",
            linked_to=None,
            file_digest=digest,
            size_bytes=size,
        )


def board_of_made(stage: Stage) -> dict[str, Any]:
    with stage.database.read() as session:
        row = current_board(session, "made")
        assert row is not None
        document: dict[str, Any] = json.loads(row.body)
    return document


def test_from_the_workshop_to_a_rescored_board(stage: Stage, shop: Path) -> None:
    build("freeze", shop / "1", "--workshop", shop)
    first = hang_up(stage, shop / "1")
    with stage.database.write() as session:
        add_phase(session, "made", split="made-2027", quota_per_day=100, rejected_per_day=100)
    for speed_mps in (0.5, 2.0, 5.0):
        submit(stage, first, speed_mps)
    stage.work()
    before = board_of_made(stage)
    assert before["n_samples"] == len(first.samples)
    assert sum(entry["source"] == "scored" for entry in before["entries"]) == 3

    ids = [it.sample_id for it in first.samples]
    reason = ("--reason", "The hazard stands on the pavement.", "--by", PEOPLE[0])
    build("withdraw", *ids[:2], "--workshop", shop, *reason)
    with Workshop(shop) as workshop:
        moved = walk(workshop)[ids[4]]
        corners = ((CANARY_M, -1.5), (19.5, -1.5), (19.5, 1.5), (CANARY_M, 1.5))
        word = Verified(accepted=True, corners=corners)
        for person in PEOPLE:
            workshop.records.append(record(Kind.VERIFY, ids[4], person, moved.pictures, word))
    previous = shop / "1" / "split.json.gz"
    build(
        "freeze", shop / "2", "--workshop", shop, "--previous", previous, "--words", WORDS
    )  # fmt: skip
    second = hang_up(stage, shop / "2", "-2")
    with stage.database.write() as session:
        run_id = changes.create_run(session, "made", split_revision=second.revision, **STEP).id
    with stage.database.read() as session:
        page = shown_revision(session, "made-2027", None)
        assert page.revision == first.revision, "what is drafted is not shown"
    stage.step("start", run_id)
    stage.work()
    stage.apply(run_id)

    after = board_of_made(stage)
    assert after["n_samples"] == len(first.samples) - 2
    expected = (
        WORDS,
        "the region of 1 sample changes",
        "2 samples withdrawn: files still answer, none counts",
        f"N goes from {len(first.samples)} to {len(first.samples) - 2}",
    )
    with stage.database.read() as session:
        assert board_history(session, "made")[0].what_changed == expected
        page = shown_revision(session, "made-2027", None)
        assert page.revision == second.revision
        assert page.datasheet is not None
        assert page.datasheet.n_withdrawn == 2
        assert page.datasheet.withdrawn[0].reason == "The hazard stands on the pavement."
        every = [table for table in Base.metadata.sorted_tables]
        kept = "".join(str(row) for table in every for row in session.execute(select(table)))
    assert second.samples[4].region[0][0] == CANARY_M
    assert second.revision in kept, "the tables were read"
    assert str(CANARY_M) not in kept, "no corner is in any row that the server may read"
