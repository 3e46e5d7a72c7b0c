"""A program for `test_one_model`: adds one field to the policy of phases, and prints where it stands.

The field is written into the source of the model before anything imports it, as a developer would.
"""

import json
import sys
import types
from importlib.util import find_spec
from pathlib import Path
from typing import Any

MODEL = "exceptiondrive_schemas.api.phase_settings"
END_OF_POLICY = "\n\nclass PhaseSettings(Document)"
FIELD = """    stickers_per_day: int = Field(
        default=5, ge=2, le=70, title="Stickers a day", description="Of a team, for its doors."
    )
"""


def add_the_field() -> Any:
    spec = find_spec(MODEL)
    assert spec is not None
    assert spec.origin is not None
    source = Path(spec.origin).read_text(encoding="utf-8")
    assert source.count(END_OF_POLICY) == 1
    patched = types.ModuleType(MODEL)
    sys.modules[MODEL] = patched
    text = source.replace(END_OF_POLICY, FIELD + END_OF_POLICY)
    exec(compile(text, spec.origin, "exec"), patched.__dict__)  # noqa: S102 - our own source
    return patched


def kept_value(model: Any, database_url: str) -> int:
    from tests.support.documents import make_manifest

    from exceptiondrive_records.db.database import Database
    from exceptiondrive_records.operations.setup import prepare
    from exceptiondrive_records.phases.phases import create_phase, find_phase
    from exceptiondrive_records.protocols.protocols import add_protocol
    from exceptiondrive_records.splits.splits import register_split
    from exceptiondrive_schemas.protocol import packaged_protocol_toml

    prepare(database_url)
    database = Database(database_url)
    wanted = {"id": "toy", "title": "Toy", "split": "sample", "protocol": "1.0"}
    with database.write() as session:
        add_protocol(session, packaged_protocol_toml(), "test")
        register_split(session, make_manifest(), {"sudden_emergence": 3}, "test")
        policy = {"stickers_per_day": 7}
        create_phase(
            session, model.NewPhase(challenge="planning", policy=policy, **wanted), actor="test"
        )
    with database.read() as session:
        kept: Any = find_phase(session, "toy").policy
    database.dispose()
    return int(kept.stickers_per_day)


def main() -> None:
    model = add_the_field()
    from fastapi import FastAPI
    from typer.testing import CliRunner

    from exceptiondrive.cli import app
    from exceptiondrive_schemas.publish.written_files import settings_page
    from exceptiondrive_server.phases import organizer_api as organizer_phases
    from exceptiondrive_server.phases import organizer_pages as phase_routes

    api = FastAPI()
    api.include_router(organizer_phases.router)
    help_text = CliRunner().invoke(app, ["organizer", "phases", "update", "--help"]).stdout
    told = {
        "kept": kept_value(model, sys.argv[1]),
        "openapi": api.openapi()["components"]["schemas"]["PhasePolicy"]["properties"],
        "form": [field.name for field in phase_routes.SETTINGS],
        "help": help_text,
        "table": settings_page(),
    }
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main()
