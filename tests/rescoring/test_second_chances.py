"""What organizers do with one submission: recompute it, let it stand again, and answer for it."""

import html
import io
import json
import tarfile
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import select

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import entries_on
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.changes import verify_submission
from exceptiondrive_records.rescoring.retry import restore_submission
from exceptiondrive_records.rescoring.verification import rechecks_of
from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.receipt import Receipt, altered_fields

Stage = Any
Api = Callable[..., Any]


def shown(stage: Stage) -> dict[str, dict[str, Any]]:
    """Place and numbers of each scored entry on the board that readers see."""
    with stage.database.read() as session:
        entries = entries_on(session, session.get_one(Phase, "dev").current_board_id)
    return {
        entry.method: {"rank": entry.rank, "metrics": entry.metrics, "at": entry.submitted_at}
        for entry in entries.values()
    }


def taken_back(stage: Stage, submission_id: str) -> None:
    with stage.database.write() as session:
        withdraw(session, submission_id, actor="team")


def restored(stage: Stage, submission_id: str) -> SubmissionStatus:
    with stage.database.write() as session:
        found = restore_submission(session, submission_id, actor="organizer", reason="a mistake")
        return found.status


def whole(stage: Stage) -> bool:
    with stage.database.read() as session:
        return violations(session) == []


def test_what_is_restored_stands_where_it_stood_with_the_score_that_was_kept(stage: Stage) -> None:
    before, first = shown(stage), stage.submitted[0]
    taken_back(stage, first)
    stage.work()
    assert "slow" in before
    assert "slow" not in shown(stage)
    with stage.database.read() as session:
        n_sheets = session.query(ScoreSheetRow).count()
    assert restored(stage, first) is SubmissionStatus.SCORED
    stage.work()
    assert shown(stage) == before
    assert whole(stage)
    with stage.database.read() as session:
        assert session.query(ScoreSheetRow).count() == n_sheets, "nothing is scored again"
        line = session.scalars(
            select(AuditLine).where(AuditLine.action == "submission restored")
        ).one()
    assert (line.subject, line.actor, line.detail) == (first, "organizer", {"reason": "a mistake"})


def test_what_was_withdrawn_before_its_score_is_scored_after_all(stage: Stage) -> None:
    early = stage.submit(3.0, "early")
    taken_back(stage, early)
    stage.work()
    assert restored(stage, early) is SubmissionStatus.RECEIVED
    assert whole(stage)
    stage.work()
    assert "early" in shown(stage)
    assert whole(stage)


def test_after_a_protocol_update_it_is_scored_under_what_is_shown(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    first = stage.submitted[0]
    taken_back(stage, first)
    stage.work()
    stage.apply(stage.ready(make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 4.5")))
    assert "slow" not in shown(stage)
    restored(stage, first)
    stage.work()
    assert "slow" in shown(stage)
    assert whole(stage)


def test_only_what_is_withdrawn_and_did_not_come_again_is_restored(stage: Stage) -> None:
    first = stage.submitted[0]
    with pytest.raises(Conflict, match="only withdrawn ones"):
        restored(stage, first)
    taken_back(stage, first)
    again = stage.submit(1.0, "slow")
    assert again != first
    with pytest.raises(Conflict, match="same file again"):
        restored(stage, first)
    with pytest.raises(NotFound):
        restored(stage, "nothing")


def test_one_submission_is_recomputed_and_every_bit_comes_again(stage: Stage) -> None:
    first, other = stage.submitted[:2]
    with stage.database.write() as session:
        verify_submission(session, first, actor="organizer", reason="the team asked")
    stage.verify_all()
    with stage.database.read() as session:
        (found,) = rechecks_of(session, first)
        assert rechecks_of(session, other) == ()
        kept = session.query(ScoreSheetRow).filter_by(submission_id=first).one().exact_digest
    assert (found.state, found.expected_digest, found.found_digest) == ("equal", kept, kept)
    assert found.ended_at is not None
    taken_back(stage, first)
    with stage.database.write() as session, pytest.raises(InvalidRecord, match="no score sheet"):
        verify_submission(session, first, actor="organizer", reason="once more")


def members(answer: Any) -> dict[str, bytes]:
    """The files of a tar, by name."""
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/x-tar"
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as tar:
        return {one.name: tar.extractfile(one).read() for one in tar}  # type: ignore[union-attr]


def test_the_story_of_a_dispute_holds_all_that_happened(stage: Stage, api: Api) -> None:
    first, other = stage.submitted[:2]
    here = f"/organizer/submissions/{first}"
    elsewhere = f"/organizer/submissions/{other}/note"
    another = api("POST", elsewhere, json={"words": "Of another."}).json()["id"]
    told = api("POST", f"{here}/note", json={"words": "We look into it.\n\nBack on Monday."})
    assert told.status_code == 201
    assert told.json()["what_changed"] == ["We look into it.", "Back on Monday."]
    assert api("POST", f"{here}/verify", json={"reason": "a dispute"}).status_code == 202
    stage.verify_all()
    upload = api("GET", f"{here}/file")
    files = members(api("GET", f"{here}/folder"))
    folder = f"submission-{first}"
    assert files[f"{folder}/upload.json"] == upload.content
    receipt = json.loads(files[f"{folder}/receipt.json"])
    assert altered_fields(Receipt.model_validate_json(files[f"{folder}/receipt.json"])) == ()
    assert receipt["statement"]["submission_id"] == first
    story = json.loads(files[f"{folder}/story.json"])
    assert story["submission"]["sheet"]["macro_family"] == receipt["statement"]["macro_family"]
    assert [item["state"] for item in story["recomputed"]] == ["equal"]
    assert [notice["id"] for notice in story["notices"]] == [told.json()["id"]]
    done = {line["action"] for line in story["audit"]}
    assert {
        "submission received",
        "submission scored",
        "team told",
        "sheet recomputed by hand",
        "upload downloaded",
    } <= done
    page = html.unescape(files[f"{folder}/story.html"].decode())
    assert "<link" not in page, "it stands alone"
    said = [
        receipt["signature"],
        receipt["statement"]["file_digest"],
        receipt["statement"]["sheet_digest"],
        "We look into it.",
        "Back on Monday.",
        *(job["split_revision"] for job in story["jobs"]),
        *(item["found_digest"] for item in story["recomputed"]),
        *(line["hash"] for line in story["audit"]),
        *(line["action"] for line in story["audit"]),
        *(line["detail"]["reason"] for line in story["audit"] if "reason" in line["detail"]),
    ]
    assert [one for one in said if one not in page] == []
    words = files[f"{folder}/README.md"].decode()
    assert receipt["statement"]["file_digest"] in words
    assert "1 equal bit for bit" in " ".join(words.split())
    assert "We look into it." not in json.dumps(story["audit"])
    inbox = api("GET", "/notifications", "alpha").json()
    assert [notice["id"] for notice in inbox] == [told.json()["id"], another]


def test_an_archive_holds_each_file_that_matches_and_names_what_is_lost(
    stage: Stage, api: Api
) -> None:
    files = members(api("GET", "/organizer/submissions/archive?team=alpha"))
    *names, last = files
    assert last == "manifest.json"
    listed = json.loads(files["manifest.json"])["files"]
    assert [one["file"] for one in listed] == names
    assert sorted(one["submission"]["method"] for one in listed) == ["middle", "slow"]
    assert all(name.startswith("dev/alpha/") for name in names)
    with stage.database.read() as session:
        digest = find_submission(session, stage.submitted[2]).file_digest
    stage.context.files.remove(digest)
    files = members(api("GET", "/organizer/submissions/archive"))
    lost = [one for one in json.loads(files["manifest.json"])["files"] if one["file"] is None]
    assert [one["missing_because"] for one in lost] == ["the file is kept no longer"]
    for typo in ("team=nobody", "phase=typo"):
        assert api("GET", f"/organizer/submissions/archive?{typo}").status_code == 404
    lines = api("GET", "/organizer/audit?limit=500").json()
    assert "typo" not in [line["subject"] for line in lines], "nothing was downloaded"


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("GET", "", None),
        ("GET", "/file", None),
        ("GET", "/folder", None),
        ("POST", "/verify", {"reason": "x"}),
        ("POST", "/restore", {"reason": "x"}),
        ("POST", "/note", {"words": "x"}),
    ],
)
def test_only_organizers_do_any_of_it(
    stage: Stage, api: Api, method: str, path: str, body: dict[str, str] | None
) -> None:
    more = {} if body is None else {"json": body}
    for submission in (stage.submitted[0], "archive"):
        address = f"/organizer/submissions/{submission}{path}"
        assert api(method, address, "alpha", **more).status_code == 403
        assert api(method, address, "nobody", **more).status_code == 401
    unknown = api(method, f"/organizer/submissions/nothing{path}", **more)
    assert unknown.status_code == 404
