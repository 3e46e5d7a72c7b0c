"""What the records alone cannot tell: whether each score is right, and whether anything withheld got out.

Scores are made anew with the client's `evaluate`; leaks are looked for with the canary of the tests.
"""

import math
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session
from tests.canary.watch import Watch, files_outside_workers, look_in_postgres
from tests.chaos.postgres import Postgres

from exceptiondrive.checking import manifest_of
from exceptiondrive.evaluation import score
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.boards.rounding import Rounding

_TOLERANCE = 1e-9
_LIMIT_BYTES = 2**26
ROOT = Path(__file__).parents[2]


class Rescorer:
    """Scores every file once more, apart from any worker; remembers what it has found right."""

    def __init__(self, split: Split, protocol: ProtocolDocument) -> None:
        self.split = split
        self._protocol = protocol
        self._manifest = manifest_of(split, protocol)
        self._right: set[tuple[str, str]] = set()

    def wrong_scores(self, session: Session, files: FileStore) -> Iterator[Violation]:
        """Yield every sheet under this protocol and split that its file does not give."""
        query = (
            select(Submission, ScoreSheetRow)
            .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
            .where(
                ScoreSheetRow.protocol_digest == self._protocol.digest,
                ScoreSheetRow.split_revision == self.split.revision,
            )
        )
        for submission, row in session.execute(query):
            key = (submission.id, row.sheet.model_dump_json())
            if key in self._right:
                continue
            data = files.read(submission.file_digest, limit_bytes=_LIMIT_BYTES)
            wrong = differences(row.sheet, self.sheet_of(data))
            if wrong:
                yield Violation("not the score of its file", submission.id, ", ".join(wrong[:5]))
            else:
                self._right.add(key)

    def sheet_of(self, data: bytes) -> ScoreSheet:
        """Return what a file's published sheet has to say."""
        checked = check(data, protocol=self._protocol, manifest=self._manifest)
        assert checked.document is not None, "a file that is no submission was scored"
        exact = score(checked.document, self.split, self._protocol)
        challenge = CHALLENGES[exact.challenge]
        drives = self._manifest.recorded is not None
        publication = self._protocol.publication
        return Rounding(challenge, publication, has_public_drives=drives).sheet(exact)


def differences(published: ScoreSheet, due: ScoreSheet) -> list[str]:
    """Return the names of all numbers that differ by more than 1e-9."""
    here, there = (_numbers(sheet.model_dump(mode="json")) for sheet in (published, due))
    return [
        name
        for name in sorted(here.keys() | there.keys())
        if not _is_same(here.get(name), there.get(name))
    ]


def _is_same(here: object, there: object) -> bool:
    if isinstance(here, float | int) and isinstance(there, float | int):
        return math.isclose(here, there, rel_tol=0, abs_tol=_TOLERANCE)
    return here == there


def _numbers(value: Any, name: str = "") -> dict[str, object]:
    """Every leaf of a document under its path."""
    if isinstance(value, dict):
        parts = [_numbers(part, f"{name}.{key}") for key, part in value.items()]
        return {path: leaf for part in parts for path, leaf in part.items()}
    return {name: value}


class LeakSearch:
    """Looks for the canary in whatever services leave in a folder, but for what workers keep."""

    def __init__(self, *folders: Path) -> None:
        self._folders = folders
        self._looked_at: dict[Path, tuple[int, int]] = {}

    def leaks(self) -> Iterator[Violation]:
        """Yield every file with the canary in it; what has not changed is not read again."""
        changed = {}
        for path in chain.from_iterable(map(files_outside_workers, self._folders)):
            with suppress(FileNotFoundError):
                stat = path.stat()
                now = (stat.st_mtime_ns, stat.st_size)
                if self._looked_at.get(path) != now:
                    changed[path] = now
        # another process: this one has the database open, and must not close its file
        command = [sys.executable, "-m", "tests.canary", *map(str, changed)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr
        for name in done.stdout.split():
            yield Violation("withheld coordinate got out", Path(name).name, "the canary is in it")
        self._looked_at |= {path: now for path, now in changed.items() if not done.returncode}


def leaks_in_postgres(server: Postgres) -> Iterator[Violation]:
    """Yield where in the records the canary is."""
    watch = Watch()
    with server.connect() as connection:
        look_in_postgres(connection, watch)
    if watch.found:
        yield Violation("withheld coordinate got out", "PostgreSQL", "the canary is in a row")
