"""The application over a stage of a protocol update."""

from typing import Any

from starlette.testclient import TestClient
from tests.rescoring.stage import Stage
from tests.support.databases import as_role

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.roles import Role
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings


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


def application_over(stage: Stage) -> Any:
    return create_app(
        ServerSettings(
            database_url=as_role(stage.settings.database_url, Role.API),
            broker_url="memory://",
            file_store_url=stage.settings.file_store_url,
        )
    )


def organizers_token(stage: Stage) -> str:
    with stage.database.write() as session:
        return issue_token(session, None, "me", ORGANIZER_SCOPES, actor="test")[0]
