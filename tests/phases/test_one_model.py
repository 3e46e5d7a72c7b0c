"""A setting of a phase is one field: a further one stands everywhere, and is kept."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.phases import toy_setting

from exceptiondrive_schemas.api.form_fields import document_of, fields_of, values_of
from exceptiondrive_schemas.api.phase_settings import (
    NewPhase,
    PhaseChange,
    PhasePolicy,
    PhaseSettings,
)

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What a program says that runs with one field more."""
    folder = tmp_path_factory.mktemp("toy")
    done = subprocess.run(
        [sys.executable, "-m", toy_setting.__name__, f"sqlite:///{folder / 'records.sqlite3'}"],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_one_field_more_stands_in_the_api(told: Any) -> None:
    field = told["openapi"]["stickers_per_day"]
    assert (field["minimum"], field["maximum"], field["default"]) == (2, 70, 5)
    assert field["description"] == "Of a team, for its doors."


def test_one_field_more_stands_in_the_form(told: Any) -> None:
    assert "stickers_per_day" in told["form"]


def test_one_field_more_is_an_option_of_the_command_line(told: Any) -> None:
    assert "--stickers-per-day 2..70" in told["help"]
    assert "Of a team, for its doors." in " ".join(told["help"].split())


def test_one_field_more_stands_in_the_documents_table(told: Any) -> None:
    row = "| `stickers_per_day` | `policy` | 2 to 70 | `5` | Of a team, for its doors. |"
    assert row in told["table"]


def test_one_field_more_is_kept_with_the_phase(told: Any) -> None:
    assert told["kept"] == 7


def test_no_two_settings_have_one_name() -> None:
    names = [field.name for field in fields_of(NewPhase)]
    assert len(set(names)) == len(names)


def test_the_values_of_the_fields_make_the_document_again() -> None:
    fields = fields_of(PhaseSettings)
    settings = PhaseSettings(
        title="Test", policy=PhasePolicy(anonymous=True, late_entries="refused")
    )
    document = document_of(fields, values_of(fields, settings))
    assert PhaseSettings.model_validate(document) == settings
    change = PhaseChange.model_validate(document_of(fields, {"anonymous": False}))
    assert change.model_fields_set == {"policy"}
    assert change.policy.model_fields_set == {"anonymous"}
