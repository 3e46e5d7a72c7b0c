"""The checker finds every violation that is planted, and none where there is none."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
from sqlalchemy import text
from sqlalchemy.orm import Session
from tests.chaos.checker import check
from tests.chaos.history import BoardSeen, Call, Sighting

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.tables import Job

if TYPE_CHECKING:
    from tests.chaos.story import Story

Plant = Callable[["Story"], None]


def rules(story: Story) -> set[str]:
    return {found.rule for found in check(story.database, story.files, story.history)}


def test_an_honest_story_has_no_violation(story: Story) -> None:
    assert check(story.database, story.files, story.history) == []


def _sql(statement: str) -> Plant:
    def plant(story: Story) -> None:
        with story.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
            connection.execute(text("COMMIT"))
            connection.execute(text("BEGIN"))
            connection.execute(text(statement))
            connection.execute(text("COMMIT"))

    return plant


def _scored_elsewhere(story: Story) -> None:
    for table in ("score_sheets", "work"):
        _sql(f"UPDATE {table} SET split_revision = 'sha256:other'")(story)


def _lose_the_row(story: Story) -> None:
    best = story.scored[0]
    for table in ("score_sheets", "work"):
        _sql(f"DELETE FROM {table} WHERE submission_id = '{best}'")(story)
    _sql(f"DELETE FROM submissions WHERE id = '{best}'")(story)


def _two_first_jobs(story: Story) -> None:
    same = (
        "kind, lane, state, asked, attempts, fence, created_at, available_at, finished_at, "
        "submission_id, team_id, protocol_digest, is_first"
    )
    _sql(
        f"INSERT INTO work (id, key, split_revision, {same}) SELECT 'twin', 'twin', 'sha256:other', "
        f"{same} FROM work WHERE submission_id = '{story.scored[0]}'"
    )(story)


def _status_alone(story: Story) -> None:
    _sql(f"UPDATE submissions SET status = 'queued' WHERE id = '{story.scored[0]}'")(story)


def _sheet_lost(story: Story) -> None:
    _sql(f"DELETE FROM score_sheets WHERE submission_id = '{story.scored[0]}'")(story)


def _sheet_from_nowhere(story: Story) -> None:
    def change(session: Session) -> None:
        row = session.get_one(Submission, story.failed)
        like = session.query(ScoreSheetRow).first()
        assert like is not None
        session.add(
            ScoreSheetRow(
                submission_id=row.id,
                protocol_digest=like.protocol_digest,
                split_revision=like.split_revision,
                sheet=like.sheet,
                exact_digest="sha256:x",
                measurement_key="m",
                scorer_version="1",
                created_at=like.created_at,
            )
        )

    story.plant(change)


def _scored_twice(story: Story) -> None:
    def change(session: Session) -> None:
        from exceptiondrive_records.audit.log import audit

        protocol = session.query(ScoreSheetRow).first()
        assert protocol is not None
        detail = {"protocol": protocol.protocol_digest}
        audit(session, "worker", "submission scored", story.scored[0], detail)

    story.plant(change)


def _same_bytes_other_scores(story: Story) -> None:
    best, second = story.scored
    _sql(
        f"UPDATE submissions SET file_digest = (SELECT file_digest FROM submissions "
        f"WHERE id = '{best}') WHERE id = '{second}'"
    )(story)


def _flip_a_bit(story: Story) -> None:
    path = next(path for path in (story.folder / "uploads").rglob("*") if path.is_file())
    data = bytearray(path.read_bytes())
    data[0] ^= 1
    path.write_bytes(data)


def _lose_a_file(story: Story) -> None:
    next(path for path in (story.folder / "uploads").rglob("*") if path.is_file()).unlink()


def _alter_board(change: Callable[[dict[str, object]], None]) -> Plant:
    def plant(story: Story) -> None:
        def alter(session: Session) -> None:
            row = session.query(BoardRow).one()
            document = json.loads(row.body)
            change(document)
            row.body = json.dumps(document)

        story.plant(alter)

    return plant


def _entries(document: dict[str, object]) -> list[dict[str, object]]:
    found = document["entries"]
    assert isinstance(found, list)
    return found


def _other_score(document: dict[str, object]) -> None:
    _entries(document)[0]["macro_family"] = {"hcc": 0.99, "ur": 0.0}


def _skip_a_rank(document: dict[str, object]) -> None:
    _entries(document)[1]["rank"] = 3


def _rank_the_scoreless(document: dict[str, object]) -> None:
    for name in ("metrics", "micro", "macro_family"):
        _entries(document)[0][name] = {"hcc": None}


def _rank_the_failed(story: Story) -> None:
    def change(document: dict[str, object]) -> None:
        _entries(document)[0]["submission_id"] = story.failed

    _alter_board(change)(story)


def _still_open(story: Story) -> None:
    _sql("UPDATE work SET state = 'queued' WHERE kind = 'board'")(story)


def _forget_who_sent_it(story: Story) -> None:
    del story.history.calls[0]


def _say_refused(story: Story) -> None:
    call = story.history.calls[0]
    story.history.calls[0] = dataclasses.replace(call, status=429, submission_id=None)


def _promise_more(story: Story) -> None:
    story.history.note(Call("alpha", "sha256:z", "m", 1.0, 0.1, 202, "nowhere"))


def _swap_ids(story: Story) -> None:
    call = story.history.calls[0]
    story.history.calls[0] = dataclasses.replace(call, submission_id=story.scored[1])


def _take_an_ending_back(story: Story) -> None:
    story.history.note(Sighting(30.0, story.scored[0], "scoring"))


def _tell_another_score(story: Story) -> None:
    seen = story.history.sightings[0]
    assert seen.sheet is not None
    sheet = {**seen.sheet, "macro_family": {"hcc": 0.125, "ur": 0.25}}
    story.history.note(Sighting(30.0, story.scored[0], "scored", sheet))


def _show_another_board(story: Story) -> None:
    seen = story.history.boards[0]
    body = seen.body.replace(b"second", b"sacond")
    story.history.note(BoardSeen(30.0, 0.1, seen.etag, body))


def _show_an_older_board(story: Story) -> None:
    seen = story.history.boards[0]
    body = seen.body.replace(b'"board":1', b'"board":7')
    story.history.boards.insert(0, BoardSeen(5.0, 0.1, "other", body))


PLANTED: dict[str, tuple[str, Plant]] = {
    "an accepted submission is gone": ("accepted and lost", _lose_the_row),
    "a 202 names a submission that never was": ("accepted and lost", _promise_more),
    "a 202 names another team's submission": ("accepted as another", _swap_ids),
    "a refused upload stands in the records": ("refused and kept", _say_refused),
    "a submission that nobody sent": ("nobody sent it", _forget_who_sent_it),
    "a submission has two first jobs": ("not exactly one job", _two_first_jobs),
    "a status moved without its job": ("status is not that of the job", _status_alone),
    "a lease without an end": (
        "lease and state differ",
        _sql("UPDATE work SET state = 'leased', finished_at = NULL WHERE kind = 'score'"),
    ),
    "a job ended without a time": (
        "end and state differ",
        _sql("UPDATE work SET finished_at = NULL WHERE kind = 'score'"),
    ),
    "a score sheet is gone": ("scored without a sheet", _sheet_lost),
    "a sheet without a job": ("sheet without a finished job", _sheet_from_nowhere),
    "nothing makes a sheet under what the phase shows": (
        "stands on no board",
        _scored_elsewhere,
    ),
    "one scoring was recorded twice": ("not scored exactly once", _scored_twice),
    "the same bytes have two scores": ("same bytes, other scores", _same_bytes_other_scores),
    "a failure without a code": (
        "failure and status differ",
        _sql("UPDATE submissions SET failure_code = NULL"),
    ),
    "a rejection without a report": (
        "rejected without a report",
        _sql("UPDATE submissions SET status = 'rejected' WHERE status = 'scored'"),
    ),
    "a withdrawal without a time": (
        "withdrawal and status differ",
        _sql("UPDATE submissions SET status = 'withdrawn' WHERE status = 'scored'"),
    ),
    "a bit of an upload flipped": ("upload damaged", _flip_a_bit),
    "an upload is gone": ("upload missing", _lose_a_file),
    "a protocol was edited in place": (
        "protocol altered",
        _sql("UPDATE protocols SET toml = replace(toml, '4.084', '4.085')"),
    ),
    "an audit line was rewritten": (
        "audit chain broken",
        _sql("UPDATE audit_lines SET actor = 'nobody' WHERE id = 3"),
    ),
    "an audit line was taken out": (
        "audit chain broken",
        _sql("DELETE FROM audit_lines WHERE id = 3"),
    ),
    "a board shows another score": ("entry is not its sheet", _alter_board(_other_score)),
    "a board was altered": ("board altered", _alter_board(_other_score)),
    "a board skips a rank": ("ranks do not follow", _alter_board(_skip_a_rank)),
    "a row without a score ranks": ("rank without a score", _alter_board(_rank_the_scoreless)),
    "a failed submission ranks": ("entry without a sheet", _rank_the_failed),
    "a board is gone": ("board number skipped", _sql("UPDATE boards SET number = 2")),
    "a board of another protocol": (
        "board of another protocol",
        _sql("UPDATE boards SET split_revision = 'sha256:other'"),
    ),
    "the pointer leads nowhere": (
        "current board missing",
        _sql("UPDATE phases SET current_board_id = 99"),
    ),
    "a job was never finished": (
        "unfinished",
        _sql("UPDATE work SET state = 'queued', finished_at = NULL WHERE state = 'failed'"),
    ),
    "a board is still owed": ("unfinished", _still_open),
    "more than the quota was taken": (
        "quota exceeded",
        _sql("UPDATE phases SET quota_per_day = 0"),
    ),
    "an ending was taken back": ("ending changed", _take_an_ending_back),
    "another score was told": ("score changed", _tell_another_score),
    "a reader saw another board": ("board not on the records", _show_another_board),
    "one tag stood for two boards": ("one tag, two boards", _show_another_board),
    "the board went back": ("board went back", _show_an_older_board),
}


@pytest.mark.parametrize("what", PLANTED)
def test_it_finds(what: str, embedded_story: Story) -> None:
    rule, plant = PLANTED[what]
    plant(embedded_story)
    assert rule in rules(embedded_story), what


def test_a_job_still_open_is_no_violation_before_everything_has_settled(
    embedded_story: Story,
) -> None:
    _still_open(embedded_story)
    story = embedded_story
    assert check(story.database, story.files, story.history, is_settled=False) == []


def test_two_submissions_of_the_same_bytes_are_one_too_many(embedded_story: Story) -> None:
    def change(session: Session) -> None:
        session.connection().exec_driver_sql("DROP INDEX uq_submissions_same_bytes")
        best, second = (session.get_one(Submission, key) for key in embedded_story.scored)
        second.team_id, second.file_digest = best.team_id, best.file_digest
        job = session.query(Job).first()
        assert job is not None

    embedded_story.plant(change)
    assert "same bytes taken twice" in rules(embedded_story)
