"""What the drill stands on: the real topology, and in its records split, phase, team and organizer."""

import gzip
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.chaos.topology import Topology

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.database import Database
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
WORKERS = (("live", 2), ("rescore", 1))
"""Lane and slots of each worker: what compose.yaml starts."""
SETTINGS = {
    "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "10",
    "EXCEPTIONDRIVE_TIME_LIMIT_S": "11",
    "EXCEPTIONDRIVE_LEASE_S": "12",
    "EXCEPTIONDRIVE_BOARD_LEASE_S": "12",
    "EXCEPTIONDRIVE_RETRY_BACKOFF_S": "2",
    "EXCEPTIONDRIVE_RECONCILE_EVERY_S": "1",
    "EXCEPTIONDRIVE_HEARTBEAT_EVERY_S": "4",
    "EXCEPTIONDRIVE_HEARTBEAT_TTL_S": "15",
}
"""As usual, but for leases so short that the work of a killed worker is taken up again while one waits."""


def prepare_records(
    topology: Topology, n_submissions: int, made: Iterator[bytes]
) -> dict[str, str]:
    """Fill the records with everything but scores; return a token of a team and an organizer."""
    database, split = topology.database, topology.splits / "carla-pairs"
    split.mkdir()
    shutil.copy(SPLIT_FILE, split)
    (split / FLOORS_FILE).write_text(OPEN_FLOORS)
    register_all_splits(database, SplitStore(topology.splits), packaged_protocol())
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
    _submit_all(database, topology.files, team, n_submissions, made)
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


REALDATA = Path(__file__).parents[3] / "shared" / "realdata" / "carla-pairs"
SPLIT_FILE = REALDATA / "split.json.gz"


def variations() -> Iterator[bytes]:
    """Yield real planner files, then the same with every waypoint moved a little further."""
    documents = [
        json.loads(gzip.decompress(path.read_bytes()))
        for path in sorted(REALDATA.glob("*.json.gz"))
        if path != SPLIT_FILE
    ]
    number = 0
    while True:
        for document in documents:
            yield gzip.compress(_stretched(document, 1 + number / 1000), compresslevel=1)
        number += 1


def _stretched(document: dict[str, Any], factor: float) -> bytes:
    predictions = [
        {
            key: [[round(x * factor, 4), round(y * factor, 4)] for x, y in value]
            if isinstance(value, list)
            else value
            for key, value in prediction.items()
        }
        for prediction in document["predictions"]
    ]
    return json.dumps({**document, "predictions": predictions}).encode()
