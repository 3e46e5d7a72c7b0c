"""`exceptiondrive tokens`: a team looks after its own tokens."""

import json
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from exceptiondrive import Client
from exceptiondrive.cli import app
from exceptiondrive.organizer import Organizer

if TYPE_CHECKING:
    from tests.client.servers import Running


@pytest.fixture
def keeper(running: "Running") -> str:
    """A token of team Alpha that may manage the team's tokens."""
    with Organizer(running.url, running.organizer_token) as organizer:
        return str(organizer.issue_token("alpha", "keeper")["token"])


def tokens(server: "Running", token: str, *words: str) -> Any:
    environment = {"EXCEPTIONDRIVE_SERVER": server.url, "EXCEPTIONDRIVE_TOKEN": token}
    return CliRunner().invoke(app, ["tokens", *words], env=environment)


def test_a_token_is_created_rotated_and_revoked(running: "Running", keeper: str) -> None:
    made = tokens(running, keeper, "create", "CI", "--scope", "submit")
    assert made.exit_code == 0, made.output
    first = made.stdout.strip()
    with Client(running.url, first) as client:
        assert client.me().scopes == ("submit",)
    rotated = tokens(running, keeper, "rotate", first.split("_")[2], "--keep-days", "0")
    second = rotated.stdout.strip()
    assert "ends now" in rotated.stderr
    assert tokens(running, first, "list").exit_code == 4
    assert tokens(running, keeper, "revoke", second.split("_")[2]).exit_code == 0
    listed = json.loads(tokens(running, keeper, "list", "--json").stdout)
    assert {token["name"] for token in listed} >= {"keeper", "CI"}
    assert first not in json.dumps(listed)
    assert tokens(running, keeper, "revoke", second.split("_")[2]).exit_code == 4


def test_a_revoked_token_leaves_behind_what_it_made(running: "Running", keeper: str) -> None:
    lost = tokens(running, keeper, "create", "lost", "--scope", "tokens").stdout.strip()
    door = tokens(running, lost, "create", "door", "--scope", "tokens").stdout.strip()
    door_id = door.split("_")[2]
    revoked = tokens(running, keeper, "revoke", lost.split("_")[2])
    assert revoked.exit_code == 0, revoked.output
    assert "revoke these too, unless they are to stay" in revoked.stderr
    assert f"{door_id}  door  (edk_s_{door_id}, made by lost (" in revoked.stderr
    environment = {
        "EXCEPTIONDRIVE_SERVER": running.url,
        "EXCEPTIONDRIVE_TOKEN": running.organizer_token,
    }
    words = ["organizer", "teams", "revoke-token", keeper.split("_")[2]]
    assert f"{door_id}  door" in CliRunner().invoke(app, words, env=environment).stderr


def test_a_token_without_the_scope_is_told_which_it_needs(running: "Running") -> None:
    done = tokens(running, running.token, "list")
    assert done.exit_code == 4
    assert "tokens" in done.stderr


def test_the_page_of_a_submission_is_its_stable_address(running: "Running") -> None:
    with Client(running.url, running.token) as client:
        assert client.page_url("abc") == f"{running.url}/submissions/abc"
