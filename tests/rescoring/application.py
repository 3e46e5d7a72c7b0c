"""The application over a stage of a protocol update, and who uses it: by API, commands and pages."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
from starlette.testclient import TestClient
from structlog.testing import capture_logs
from tests.rescoring.stage import Stage
from tests.support.databases import as_role
from typer.testing import CliRunner

from exceptiondrive.cli import app
from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.roles import Role
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings

Serve = Callable[[Stage], tuple[str, str]]
SITE = "https://server.test"
RUNS = "/organize/rescoring"


class Api:
    """The application over a stage, as organizer, team Alpha, or nobody."""

    def __init__(self, client: TestClient, tokens: dict[str, str]) -> None:
        self.client = client
        self.tokens = tokens

    def __call__(self, method: str, path: str, who: str = "organizer", **more: Any) -> Any:
        token = self.tokens.get(who)
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        headers |= more.pop("headers", {})
        return self.client.request(method, f"/api/v1{path}", headers=headers, **more)


class Organizer:
    """The organizer's commands against a served stage; every command must end well."""

    def __init__(self, url: str, token: str, home: Path) -> None:
        self.url = url
        self.environment = {
            "EXCEPTIONDRIVE_SERVER": url,
            "EXCEPTIONDRIVE_TOKEN": token,
            "HOME": str(home),
            "XDG_CONFIG_HOME": str(home),
            "COLUMNS": "200",
        }

    def say(self, *words: str) -> str:
        with capture_logs():  # else the server's lines would stand among the command's
            done = CliRunner().invoke(app, ["organizer", *words], env=self.environment)
        assert done.exit_code == 0, done.output
        return done.stdout

    def refuse(self, why: str, *words: str) -> None:
        with capture_logs():
            done = CliRunner().invoke(app, ["organizer", *words], env=self.environment)
        assert (done.exit_code, why in done.stderr) == (2, True)

    def rescore(self, *words: str) -> Any:
        return json.loads(self.say("rescore", *words, "--json"))

    def board(self) -> bytes:
        answer = httpx.get(f"{self.url}/api/v1/leaderboard", params={"phase": "dev"})
        return answer.raise_for_status().content


class Visitor:
    """A signed-in browser before the pages of a stage."""

    def __init__(self, client: TestClient, token: str) -> None:
        self.client = client
        client.cookies.clear()
        self.post("/sign-in", {"token": token}, page="/sign-in")

    def get(self, path: str) -> Any:
        return self.client.get(path, headers={"Accept": "text/html"})

    def post(self, path: str, data: dict[str, Any], page: str = "/my", **more: Any) -> Any:
        token = re.search(r'name="form_token" value="([0-9a-f]{64})"', self.get(page).text)
        assert token is not None, page
        form = {**data, "form_token": token[1]}
        headers = {"Accept": "text/html", "Origin": SITE}
        return self.client.post(path, data=form, headers=headers, **more)

    def step(self, run_id: str, step: str, preview: str = "", reason: str = "because") -> Any:
        """Send the form of a step to the address of its page, as browsers do."""
        address = f"{RUNS}/{run_id}/{step}" + (f"?preview={preview}" if preview else "")
        return self.post(address, {"reason": reason})

    def document(self, toml: str, do: str, **more: Any) -> Any:
        return self.post("/organize/protocols/new", {"toml": toml, "do": do}, **more)

    def draft(self, protocol: str = "1.1") -> str:
        form = {"phase": "dev", "protocol": protocol, "reason": "pedestrians need more room"}
        answer = self.post(f"{RUNS}/new", form)
        assert answer.status_code == 303, answer.text
        return str(answer.headers["location"].removeprefix(f"{RUNS}/").split("?")[0])

    def seen_digest(self, run_id: str) -> str:
        """What the link on the preview page carries."""
        found = re.search(r"apply\?preview=([^\"]+)\"", self.get(f"{RUNS}/{run_id}/preview").text)
        assert found is not None
        return found[1].replace("%3A", ":")


def application_over(stage: Stage) -> Any:
    return create_app(
        ServerSettings(
            database_url=as_role(stage.settings.database_url, Role.API),
            broker_url=stage.settings.broker_url,
            file_store_url=stage.settings.file_store_url,
        )
    )


def organizers_token(stage: Stage) -> str:
    with stage.database.write() as session:
        return issue_token(session, None, "me", ORGANIZER_SCOPES, actor="test")[0]
