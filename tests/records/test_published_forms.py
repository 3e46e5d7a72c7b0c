"""What of a sheet is shown before the date of its families."""

from datetime import timedelta
from typing import Any

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.phases.policy import shown_sheet
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.api.phase_settings import PhaseChange, PhasePolicy

World = Any


def test_until_their_date_no_row_tells_of_some_samples_alone(world: World) -> None:
    extra: dict[str, dict[str, float | None]] = {
        "confusion_CD": {"n": 2.0, "A": 1.0, "C": 1.0},  # as telling as a task
        "reminder": {"n": 1.0, "type_task_accuracy": 1.0},
        "d_safe_x2": {"hcc_micro": 0.5},
    }
    row = ScoreSheetRow(sheet=world.sheet().model_copy(update={"extra": extra}))
    with world.database.write() as session:
        policy = PhasePolicy(families_from=database_now(session) + timedelta(days=1))
        phase = update_phase(session, "dev", PhaseChange(policy=policy), actor="test")
        shown = shown_sheet(phase, row, database_now(session))
        assert (shown.families, shown.tasks) == ({}, {})
        assert shown.extra == {"reminder": {"n": 1.0}, "d_safe_x2": {"hcc_micro": 0.5}}
        phase.policy = PhasePolicy()
        assert shown_sheet(phase, row, database_now(session)) == row.sheet
