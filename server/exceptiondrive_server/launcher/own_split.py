"""`exceptiondrive-server run --split FILE`: a live phase on the operator's own split.

Only the worker's command opens the file; this process reads only what the records may hold.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.launcher.child import Say, run_step
from exceptiondrive_server.launcher.layout import Layout, find_command, worker_environment

ACTOR = "operator:run"


def open_phase_on(
    split_file: Path, layout: Layout, shared: Mapping[str, str], database: Database, say: Say
) -> None:
    """Add a split, and open a planning phase on it where it has none; a second time nothing changes.

    Raises:
        LaunchError: The file is refused; the worker's words are part of the text.
        Conflict: Another split has a phase of that id.
    """
    worker = find_command("exceptiondrive-worker")
    command = [worker, "add-split", "--json", str(split_file)]
    told = json.loads(run_step(command, worker_environment(layout, shared)))
    with database.write() as session:
        phase = _phase_of(session, told["name"]) or create_phase(
            session,
            NewPhase(
                id=told["name"].replace(".", "-"),
                challenge=PLANNING.id,
                title=told["title"],
                split=told["name"],
            ),
            actor=ACTOR,
        )
        say(
            f"split {told['name']} ({told['n_samples']} samples) is phase {phase.id}: "
            f"{counted(phase.quota_per_day, 'submission')} a day for each team"
        )
    for warning in told["warnings"]:
        say(f"  warning {warning['code']} ({warning['count']}): {warning['what']}")


def _phase_of(session: Session, split_name: str) -> Phase | None:
    using = select(Phase).where(Phase.split_name == split_name).order_by(Phase.created_at)
    return session.scalars(using).first()
