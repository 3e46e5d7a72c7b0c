import json
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.inputs import given_manifest
from exceptiondrive_agent.run import (
    strategy_submission,
    write_submission,
)
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission_files import ReminderRecord, StrategySubmission
from exceptiondrive_schemas.taxonomy import Strategy

MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="dev",
    title="Dev",
    revision="sha256:0",
    waypoints=6,
    time_step_s=0.5,
    sample_ids=("s2", "s1", "s3"),
)


def test_every_sample_of_the_manifest_stands_in_the_file_once_and_null_where_unanswered(
    tmp_path: Path, record: dict[str, Any]
) -> None:
    reminders = {"s1": ReminderRecord.model_validate_json(json.dumps(record))}
    strategies = {"s1": Strategy.C, "elsewhere": Strategy.A}
    write_submission(strategy_submission(MANIFEST, strategies, reminders), tmp_path / "f.json")
    text = (tmp_path / "f.json").read_text()
    assert json.loads(text) == {
        "schema": "exceptiondrive.strategy/1",
        "split": "dev",
        "predictions": [
            {"sample_id": "s2", "strategy": None},
            {"sample_id": "s1", "strategy": "C", "reminder": record},
            {"sample_id": "s3", "strategy": None},
        ],
    }
    StrategySubmission.model_validate_json(text)


def test_nothing_but_the_file_is_left_in_the_folder(tmp_path: Path) -> None:
    write_submission(strategy_submission(MANIFEST, {}, {}), tmp_path / "f.json")
    assert [path.name for path in tmp_path.iterdir()] == ["f.json"]


@pytest.mark.parametrize("text", ["", "{}", '{"schema": "exceptiondrive.split/1"}'])
def test_what_is_no_manifest_is_refused_with_where_to_get_one(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(InvalidArgumentError, match="exceptiondrive manifest PHASE"):
        given_manifest(tmp_path / "m.json")
