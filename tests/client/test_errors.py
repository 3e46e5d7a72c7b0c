"""Errors and documents between processes: a pool hands them from its workers to who asked."""

import copy
import pickle
from datetime import datetime, timezone

import pytest

from exceptiondrive import (
    Client,
    ExceptionDriveError,
    InvalidArgumentError,
    Submission,
    check_file,
    errors,
)
from exceptiondrive_agent.errors import AgentError
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.score_sheet import ScoreSheet

VIEW = SubmissionView.read(example_text("submission"))
MADE: dict[type[ExceptionDriveError], ExceptionDriveError] = {
    errors.InvalidArgumentError: errors.InvalidArgumentError("c", "No.", "Do.", {"limit": "many"}),
    errors.InvalidFileError: errors.InvalidFileError(check_file(b"{}")),
    errors.RecorderError: errors.RecorderError("No."),
    errors.QuotaError: errors.QuotaError("c", "No.", datetime(2026, 11, 30, tzinfo=timezone.utc)),
    errors.ScoringFailedError: errors.ScoringFailedError("c", "No.", "Do.", VIEW),
    errors.WaitTimeoutError: errors.WaitTimeoutError("c", "No.", "Do.", VIEW),
    AgentError: AgentError("No.", "Do."),
}


KINDS = [
    kind
    for name, kind in vars(errors).items()
    if not name.startswith("_") and isinstance(kind, type) and issubclass(kind, ExceptionDriveError)
]


@pytest.mark.parametrize("kind", [*KINDS, AgentError], ids=lambda kind: kind.__name__)
def test_an_error_of_every_kind_is_the_same_on_the_other_side_of_a_process(
    kind: type[ExceptionDriveError],
) -> None:
    error = MADE[kind] if kind in MADE else kind("c", "No.", "Do.")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(again) is kind
        assert str(again) == str(error)
        assert vars(again) == vars(error)
        assert again.document() == error.document()


def test_the_error_of_a_file_tells_each_kind_of_fault_where_it_is_raised() -> None:
    report = check_file(b"{}")
    lines = str(errors.InvalidFileError(report)).splitlines()
    assert lines[0].startswith("The file cannot be scored: missing_key (3).")
    assert lines[1:] == [f"- missing_key (3): {report.faults[0].message}"]


def test_a_client_is_not_pickled_and_says_what_to_do() -> None:
    with Client("http://127.0.0.1:9", "edk_t_1") as client:
        for each in (client, Submission(client, VIEW)):
            with pytest.raises(InvalidArgumentError, match="A Client holds a token") as told:
                pickle.dumps(each)
            assert "in each process" in told.value.advice


@pytest.mark.parametrize("kind", [Board, CheckReport, ScoreSheet, SubmissionView])
def test_a_document_is_the_same_on_the_other_side_of_a_process_and_as_json(
    kind: type[Document],
) -> None:
    names = {Board: "board", CheckReport: "check-report", ScoreSheet: "score-sheet"}
    document = kind.read(example_text(names.get(kind, "submission")))
    assert pickle.loads(pickle.dumps(document)) == document
    assert copy.deepcopy(document) == document
    assert kind.read(document.model_dump_json(by_alias=True)) == document
