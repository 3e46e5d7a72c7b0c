"""The scoring run against real records: what is recorded, and what is left alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from billiard.exceptions import SoftTimeLimitExceeded
from sqlalchemy import func, select, text
from tests.support.work import claim_this
from tests.support.worker import score_submission
from typer.testing import CliRunner, Result

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_records.work.jobs import new_job
from exceptiondrive_records.work.tables import BoardRequest, Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.failures import FailureCode
from exceptiondrive_worker.operator_cli import app
from exceptiondrive_worker.scoring_run import score_next
from exceptiondrive_worker.splits.admin import publish_split_file
from exceptiondrive_worker.splits.private_store import Shelf

World = Any
MakeFile = Callable[..., bytes]
WAITING = (SubmissionStatus.RECEIVED, SubmissionStatus.QUEUED)


def sheets_of(world: World, submission_id: str) -> list[ScoreSheetRow]:
    with world.database.read() as session:
        query = select(ScoreSheetRow).where(ScoreSheetRow.submission_id == submission_id)
        return list(session.scalars(query))


def add_job(world: World, submission_id: str, toml: str) -> str:
    """A rescoring job of a submission under another protocol."""
    with world.database.write() as session:
        protocol = add_protocol(session, toml, "test")
        submission = world.submission(submission_id)
        first = session.scalars(select(Job).where(Job.submission_id == submission_id)).first()
        now = submission.received_at
        revision = first.split_revision
        job = new_job(submission, protocol.digest, revision, Lane.RESCORE, False, now)
        session.add(job)
        return job.id


def test_a_sound_upload_is_scored(phase: World, tiny: Split, planning_file: MakeFile) -> None:
    submission_id, job_id = phase.submit(planning_file(tiny))
    score_submission(phase.context, job_id)
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED
    assert phase.job(job_id).state is WorkState.DONE
    (row,) = sheets_of(phase, submission_id)
    assert row.scorer_version == SCORER_VERSION
    assert row.sheet.n == 4
    # 3 m driven: the bumper is at 6.528 m, 3.472 m before the region: every d_safe is met
    assert row.sheet.macro_family["hcc"] == 1.0
    assert row.sheet.macro_family["ur"] == 0.0
    # source at 4 m/s, edited at 1 m/s: shifts 0, 1.5, 3 ... 9 over 7 points
    assert row.sheet.micro["cts"] == 4.5
    with phase.database.read() as session:
        assert session.scalar(select(func.max(BoardRequest.asked))) == 2


def test_a_sheet_in_the_records_is_rounded(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    missing = {"a": {"source": None, "edited": None}}
    submission_id = phase.score(planning_file(tiny, edited_mps=2.1, changes=missing))
    (row,) = sheets_of(phase, submission_id)
    for key, value in row.sheet.micro.items():
        if key.startswith("source_l2"):
            assert value is None, "the split tells no recorded paths"
            continue
        assert value is not None
        assert value == round(value, 4)


def test_a_faulty_upload_is_rejected_with_its_report(phase: World) -> None:
    submission_id, job_id = phase.submit(b'{"schema": "exceptiondrive.planning/1"}')
    score_submission(phase.context, job_id)
    submission = phase.submission(submission_id)
    assert submission.status is SubmissionStatus.REJECTED
    assert submission.report is not None
    assert not submission.report.is_valid
    assert sheets_of(phase, submission_id) == []


def test_the_same_call_five_times_scores_once(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id, job_id = phase.submit(planning_file(tiny))
    for _ in range(5):
        score_submission(phase.context, job_id)
    assert len(sheets_of(phase, submission_id)) == 1
    assert phase.job(job_id).attempts == 1


def test_a_job_that_another_worker_holds_is_left_alone(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    _, job_id = phase.submit(planning_file(tiny))
    with phase.database.write() as session:
        assert claim_this(session, job_id, 60, 4) is not None
    score_submission(phase.context, job_id)
    assert phase.job(job_id).state is WorkState.LEASED


def test_an_unknown_job_is_nothing(phase: World) -> None:
    score_submission(phase.context, "nosuchjob")


def test_a_frozen_worker_that_wakes_up_late_records_nothing(
    phase: World, tiny: Split, planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission_id, job_id = phase.submit(planning_file(tiny))
    score = phase.context.stages.score

    def slowly(target: Any) -> Any:
        scored = score(target)
        with phase.database.write() as session:
            job = session.get(Job, job_id)
            job.lease_until = job.lease_until.replace(year=2020)
        with phase.database.write() as session:
            assert claim_this(session, job_id, 60, 4) is not None
        return scored

    monkeypatch.setattr(phase.context.stages, "score", slowly)
    score_submission(phase.context, job_id)
    assert sheets_of(phase, submission_id) == []
    assert phase.job(job_id).state is WorkState.LEASED


def test_without_the_registered_revision_the_job_stays_queued(
    phase: World, tiny: Split, make_split: Callable[..., Split], planning_file: MakeFile,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    submission_id, job_id = phase.submit(planning_file(tiny))
    path = phase.settings.splits_dir / "tiny" / "split.json"
    sound = path.read_text()
    path.write_text(make_split({"a": {}}).model_dump_json(by_alias=True, exclude_none=True))
    score_submission(phase.context, job_id)
    assert phase.job(job_id).state is WorkState.QUEUED
    assert phase.job(job_id).attempts == 0
    assert "split unavailable: its jobs stay queued" in capsys.readouterr().out
    path.write_text(sound)
    score_submission(phase.context, job_id)
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED


def test_an_altered_protocol_keeps_its_own_jobs_waiting_alone(
    phase: World, tiny: Split, planning_file: MakeFile, capsys: pytest.CaptureFixture[str]
) -> None:
    done = phase.score(planning_file(tiny))
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    stuck = add_job(phase, done, toml)
    with phase.database.engine.begin() as connection:
        for name in connection.scalars(
            text("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'protocols'")
        ).all():
            connection.execute(text(f"DROP TRIGGER {name}"))
        connection.execute(
            text(
                "UPDATE protocols SET toml = replace(toml, '4.084', '4.085') WHERE version = '1.1'"
            )
        )
    _, job_id = phase.submit(planning_file(tiny, edited_mps=3.0), team="beta")
    with phase.database.write() as session:
        session.get_one(Job, stuck).lane = Lane.LIVE
    assert score_next(phase.context, Lane.LIVE)
    assert phase.job(job_id).state is WorkState.DONE
    assert not score_next(phase.context, Lane.LIVE)
    assert phase.job(stuck).attempts == 0
    assert "protocol refused: its jobs stay queued" in capsys.readouterr().out


def failing(error: BaseException) -> Callable[..., Any]:
    def fail(*_: Any) -> Any:
        raise error

    return fail


@pytest.mark.row("I26")
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ZeroDivisionError("canary 77.125"), FailureCode.INTERNAL),
        (SoftTimeLimitExceeded(), FailureCode.TIME_LIMIT),
        (MemoryError(), FailureCode.OUT_OF_MEMORY),
    ],
    ids=lambda value: getattr(value, "value", type(value).__name__),
)
def test_an_error_of_ours_is_retried_and_then_shown_by_its_code(
    phase: World, tiny: Split, planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch,
    error: BaseException, code: FailureCode, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    submission_id, job_id = phase.submit(planning_file(tiny))
    monkeypatch.setattr(phase.context.stages, "score", failing(error))
    score_submission(phase.context, job_id)
    assert phase.job(job_id).state is WorkState.QUEUED
    assert phase.submission(submission_id).status is SubmissionStatus.QUEUED
    with phase.database.write() as session:
        session.get(Job, job_id).attempts = phase.settings.max_attempts - 1
        session.get(Job, job_id).available_at = phase.submission(submission_id).received_at
    score_submission(phase.context, job_id)
    submission = phase.submission(submission_id)
    assert submission.status is SubmissionStatus.FAILED
    assert submission.failure_code == code.value
    log = capsys.readouterr().out
    assert type(error).__qualname__ in log
    assert "test_scoring_run.py" in log, "the place in the code helps us"
    assert "77.125" not in log + (submission.failure_message or "")


def test_a_stored_upload_with_a_flipped_bit_is_never_scored(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    data = planning_file(tiny)
    submission_id, job_id = phase.submit(data)
    (path,) = [p for p in Path(f"{phase.settings.private_dir.parent}/uploads").rglob("*")
               if p.is_file() and p.read_bytes() == data]  # fmt: skip
    path.write_bytes(data.replace(b"4.0", b"4.1", 1))
    score_submission(phase.context, job_id)
    submission = phase.submission(submission_id)
    assert submission.status is SubmissionStatus.FAILED
    assert submission.failure_code == FailureCode.UPLOAD_DAMAGED.value


def test_a_lost_upload_is_retried(phase: World, tiny: Split, planning_file: MakeFile) -> None:
    _, job_id = phase.submit(planning_file(tiny))
    for path in Path(f"{phase.settings.private_dir.parent}/uploads").rglob("*"):
        if path.is_file():
            path.unlink()
    score_submission(phase.context, job_id)
    assert phase.job(job_id).state is WorkState.QUEUED
    assert phase.job(job_id).attempts == 1


@pytest.fixture
def at_once(make_world: Callable[..., World], tiny: Split, sqlite_url: str) -> World:
    """A world in which what is tried again is due at once."""
    world = make_world(sqlite_url, retry_backoff_s=1e-6)
    world.add_phase(tiny)
    return world


def uploads_of(world: World) -> Path:
    return Path(f"{world.settings.private_dir.parent}/uploads")


def test_while_the_store_is_away_jobs_wait_and_use_no_attempt(
    at_once: World, tiny: Split, planning_file: MakeFile
) -> None:
    sent = [at_once.submit(planning_file(tiny, speed), f"method {speed}") for speed in (1.0, 2.0)]
    uploads = uploads_of(at_once)
    away = uploads.rename(uploads.with_name("elsewhere"))
    for _ in range(2 * at_once.settings.max_attempts):
        assert not score_next(at_once.context, Lane.LIVE), "nothing else comes further now"
    for submission_id, job_id in sent:
        assert at_once.submission(submission_id).status in WAITING
        assert at_once.job(job_id).state is WorkState.QUEUED
        assert at_once.job(job_id).attempts == 0
    assert at_once.job(sent[0][1]).note == "store_unavailable"
    with at_once.database.read() as session:
        actions = set(session.scalars(select(AuditLine.action)))
    assert "scoring to be retried" not in actions, "an outage of a night would fill the log"
    away.rename(uploads)
    while score_next(at_once.context, Lane.LIVE):
        pass
    assert {at_once.submission(each).status for each, _ in sent} == {SubmissionStatus.SCORED}


def test_while_the_records_have_no_room_jobs_wait_and_use_no_attempt(
    at_once: World, tiny: Split, planning_file: MakeFile
) -> None:
    def limit(n_pages: int) -> None:  # of the one connection that this thread writes with
        with at_once.context.database.write() as session:
            session.execute(text(f"PRAGMA max_page_count = {n_pages}"))

    sent = [at_once.submit(planning_file(tiny, 1 + n / 10), f"method {n}") for n in range(12)]
    limit(1)  # no more than there are
    for _ in range(12 + 2 * at_once.settings.max_attempts):
        score_next(at_once.context, Lane.LIVE)
    left = [ids for ids in sent if at_once.submission(ids[0]).status in WAITING]
    assert left
    for _, job_id in left:
        assert at_once.job(job_id).attempts == 0
    assert {at_once.job(job_id).note for _, job_id in left} == {None, "records_unavailable"}
    limit(1_000_000)
    while score_next(at_once.context, Lane.LIVE):
        pass
    assert {at_once.submission(each).status for each, _ in sent} == {SubmissionStatus.SCORED}


def test_a_file_that_the_store_does_not_give_is_given_up(
    at_once: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id, _ = at_once.submit(planning_file(tiny))
    (path,) = (path for path in uploads_of(at_once).rglob("*") if path.is_file())
    path.unlink()
    path.symlink_to(path)  # nobody can open it, not even root
    for _ in range(at_once.settings.max_attempts):
        assert score_next(at_once.context, Lane.LIVE)
    submission = at_once.submission(submission_id)
    assert submission.status is SubmissionStatus.FAILED
    assert submission.failure_code == "upload_unreadable"


def test_rescoring_under_another_protocol_reads_no_upload(
    phase: World, tiny: Split, planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission_id = phase.score(planning_file(tiny, edited_mps=2.0))
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    job_id = add_job(phase, submission_id, toml.replace("d_safe_scale = 1.0", "d_safe_scale = 2.0"))
    monkeypatch.setattr(type(phase.context.files), "read", failing(AssertionError("read")))
    score_submission(phase.context, job_id)
    old, new = sorted(sheets_of(phase, submission_id), key=lambda row: row.sheet.protocol.version)
    assert (old.sheet.protocol.version, new.sheet.protocol.version) == ("1.0", "1.1")
    assert old.measurement_key == new.measurement_key
    assert old.sheet.micro["hcc"] != new.sheet.micro["hcc"]
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED


def test_a_protocol_that_refuses_the_split_fails_the_job_and_leaves_the_submission(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny))
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "2.0"')
    job_id = add_job(
        phase,
        submission_id,
        toml.replace("footprint_length_m = 4.084", "footprint_length_m = 40.0"),
    )
    score_submission(phase.context, job_id)
    assert phase.job(job_id).state is WorkState.FAILED
    assert phase.submission(submission_id).status is SubmissionStatus.SCORED


def test_scoring_again_from_scratch_is_identical_to_the_last_bit(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    data = planning_file(tiny, edited_mps=2.17)
    first = phase.score(data, team="alpha")
    for shelf in Shelf:
        for path in (phase.context.private.root / shelf).iterdir():
            path.unlink()
    second = phase.score(data, team="beta")
    digests = {sheets_of(phase, one)[0].exact_digest for one in (first, second)}
    assert len(digests) == 1


def test_both_databases_record_a_score(
    make_world: Callable[..., World], database_url: str, tiny: Split, planning_file: MakeFile
) -> None:
    world = make_world(database_url)
    world.add_phase(tiny)
    submission_id = world.score(planning_file(tiny))
    assert world.submission(submission_id).status is SubmissionStatus.SCORED


@pytest.mark.publishes_regions
def test_the_clearance_curve_is_published_of_a_public_split_alone(
    world: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny)
    (withheld,) = sheets_of(world, world.score(planning_file(tiny)))
    assert withheld.sheet.clearance_curve is None
    publish_split_file(
        world.database, world.files, world.context.splits, "tiny", protocol, while_open=True
    )
    (shown,) = sheets_of(world, world.score(planning_file(tiny, edited_mps=2.1)))
    curve = shown.sheet.clearance_curve
    assert curve is not None
    assert len(curve.micro) == 21
    assert curve.micro[0] == 1 - (shown.sheet.micro["ur"] or 0.0)
    assert curve.micro[10] == shown.sheet.micro["clear"]


@pytest.mark.publishes_regions
def test_a_split_that_an_open_phase_is_scored_on_is_made_public_on_purpose_alone(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    settings = phase.context.settings
    names = ("database_url", "file_store_url", "splits_dir")
    env = {f"EXCEPTIONDRIVE_{name.upper()}": str(getattr(settings, name)) for name in names}

    def publish(*options: str) -> Result:
        return CliRunner().invoke(app, ["publish-split", "tiny", *options], env=env)

    def is_public() -> bool:
        with phase.database.read() as session:
            return find_split(session, "tiny").public_file_digest is not None

    phase.score(planning_file(tiny))
    refused = publish()
    assert isinstance(refused.exception, Conflict)
    assert "files of dev are scored on it" in str(refused.exception)
    assert "Close the phase first, or publish it --while-open." in str(refused.exception)
    assert not is_public()
    assert publish("--while-open").exit_code == 0
    assert is_public()
    assert publish().exit_code == 0, "it is public already"


@pytest.mark.publishes_regions
@pytest.mark.parametrize("is_scored", [True, False], ids=["over", "no score yet"])
def test_where_no_test_goes_on_a_split_is_made_public_at_once(
    phase: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument, is_scored: bool
) -> None:
    if is_scored:
        phase.score(planning_file(tiny))
        with phase.database.write() as session:
            session.get_one(Phase, "dev").closes_at = database_now(session)
    publish_split_file(phase.database, phase.files, phase.context.splits, "tiny", protocol)
    with phase.database.read() as session:
        assert find_split(session, "tiny").public_file_digest is not None
