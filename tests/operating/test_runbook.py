"""The runbook names only what is there: commands, options, settings and metrics."""

import re
from pathlib import Path
from typing import Any

import pytest
import typer

from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.notifications.channels import NoticeSettings
from exceptiondrive_records.work.jobs import EXHAUSTED_CODE
from exceptiondrive_server.operations.cli import app as server_app
from exceptiondrive_server.web.metrics import RecordsCollector, RequestMetrics
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.failures import FailureCode
from exceptiondrive_worker.operator_cli import app as worker_app
from exceptiondrive_worker.settings import WorkerSettings

ROOT = Path(__file__).parents[2]
DOCUMENTS = ("docs/operating.md", "docs/operating-bare.md", "docs/scaling.md", "compose.yaml")
NOT_SETTINGS = {"EXCEPTIONDRIVE_SECRETS_DIR"}


@pytest.fixture(params=DOCUMENTS)
def document(request: pytest.FixtureRequest) -> str:
    return (ROOT / str(request.param)).read_text("utf-8")


def commands_of(app: typer.Typer) -> dict[str, Any]:
    group: Any = typer.main.get_command(app)
    return dict(group.commands)


COMMANDS = {
    "exceptiondrive-server": commands_of(server_app),
    "exceptiondrive-worker": commands_of(worker_app),
}
CALL = re.compile(
    r'(exceptiondrive-(?:server|worker))"?,? "?([a-z][a-z|-]*)((?:,? "?[^`,\n.;)\]]+)?)'
)


ENTRYPOINT = re.compile(r"--entrypoint (\S+) \S+")
"""`docker compose run --entrypoint PROGRAM SERVICE COMMAND`: the service is no command."""


def calls(text: str) -> list[tuple[str, str, str]]:
    text = ENTRYPOINT.sub(r"\1", text)
    return [
        (program, command, rest)
        for program, commands, rest in CALL.findall(text)
        for command in commands.split("|")
    ]


def test_every_command_and_option_that_is_named_is_there(document: str) -> None:
    for program, command, rest in calls(document):
        known = COMMANDS[program]
        assert command in known, f"{program} {command}"
        options = {name for param in known[command].params for name in param.opts}
        assert set(re.findall(r"--[a-z-]+", rest)) <= options, f"{program} {command} {rest}"


def test_the_runbook_is_read_at_all() -> None:
    text = (ROOT / "docs/operating.md").read_text("utf-8")
    named = {command for _, command, _ in calls(text)}
    assert {
        "backup",
        "restore",
        "verify",
        "doctor",
        "migrate",
        "sweep",
        "create-organizer",
    } <= named


def test_every_setting_that_is_named_is_there(document: str) -> None:
    kinds = (ServerSettings, NoticeSettings, WorkerSettings)
    fields = {name for kind in kinds for name in kind.model_fields}
    known = {f"EXCEPTIONDRIVE_{name.upper()}" for name in fields} | NOT_SETTINGS
    assert set(re.findall(r"EXCEPTIONDRIVE_[A-Z_]+[A-Z]", document)) <= known


def test_the_table_of_settings_has_each_with_its_default() -> None:
    sections = (ROOT / "docs/operating.md").read_text("utf-8").split("\n## ")
    (table,) = (section for section in sections if section.startswith("Settings\n"))
    told = {
        name: words.strip("`")
        for names, defaults in re.findall(r"^\| (`.+?`) \| (.+?) \|", table, re.MULTILINE)
        for name, words in zip(re.findall(r"\w+", names), defaults.split(", "), strict=True)
    }
    kinds = (NoticeSettings, ServerSettings, WorkerSettings)
    fields = {name.upper(): field for kind in kinds for name, field in kind.model_fields.items()}
    assert fields.keys() - told.keys() == {
        name for name in fields if name.startswith(("SMTP_", "OIDC_"))
    } | {"MAIL_FROM"}
    defaults = {name: in_words(fields[name].default) for name in told}
    assert told == {**defaults, "FILE_STORE_URL": told["FILE_STORE_URL"]}


def in_words(default: object) -> str:
    """A default as the table says it: bytes in larger units, nothing as none."""
    if isinstance(default, int) and default >= 2**20:
        return f"{default >> 30} GiB" if default >= 2**30 else f"{default >> 20} MiB"
    return f"{default:g}" if isinstance(default, int | float) else str(default or "none")


def test_every_code_of_a_failure_is_told() -> None:
    text = (ROOT / "docs/operating.md").read_text("utf-8")
    assert [code for code in (*FailureCode, EXHAUSTED_CODE) if f"`{code}`" not in text] == []


def test_every_metric_that_is_named_is_there(migrated_sqlite: Path) -> None:
    from exceptiondrive_records.db.database import Database

    database = Database(f"sqlite:///{migrated_sqlite}")
    requests = RequestMetrics()
    requests.watch(lambda: 0, lambda: None)
    collectors = (RecordsCollector(database), requests.registry)
    known = {metric.name for collector in collectors for metric in collector.collect()}
    database.dispose()
    text = (ROOT / "docs/operating.md").read_text("utf-8")
    named = set(re.findall(r"`(exceptiondrive_[a-z_]+)", text)) - {*Role, "exceptiondrive_owner"}
    assert named <= known
    assert len(named) >= 5
