from pathlib import Path
from typing import Any

import pytest

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_agent.settings import run_settings
from exceptiondrive_schemas.protocol import packaged_protocol_toml

GIVEN: dict[str, Any] = {
    "base_url": "http://127.0.0.1:1/v1",
    "model": "m",
    "protocol": None,
    "views": None,
    "limit": None,
    "concurrency": 4,
    "requests_per_minute": None,
    "timeout_s": 1.0,
    "max_retries": 0,
    "temperature": 0.0,
    "max_tokens": 10,
    "extra_body": None,
    "price_in": None,
    "price_out": None,
}


def test_the_key_comes_from_the_environment_and_ours_goes_first() -> None:
    both = {"EXCEPTIONDRIVE_AGENT_KEY": "ours", "OPENAI_API_KEY": "theirs"}
    assert run_settings(GIVEN, both).endpoint.key == "ours"
    assert run_settings(GIVEN, {"OPENAI_API_KEY": "theirs"}).endpoint.key == "theirs"
    assert run_settings(GIVEN, {}).endpoint.key is None


def test_views_are_split_at_commas() -> None:
    given = GIVEN | {"views": "front left, front ,front right"}
    assert run_settings(given, {}).views == ("front left", "front", "front right")


def test_another_protocol_brings_its_own_taxonomy(tmp_path: Path) -> None:
    toml = packaged_protocol_toml().replace('id = "LB1"', 'id = "XX1"')
    (tmp_path / "p.toml").write_text(toml)
    settings = run_settings(GIVEN | {"protocol": tmp_path / "p.toml"}, {})
    assert settings.protocol.taxonomy.task("XX1").name == "stalled_vehicle"


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("base_url", "localhost:8000", "--base-url: expected http"),
        ("base_url", "https://me:secret@host/v1", "no user or password"),
        ("base_url", "https://me@host/v1", "no user or password"),
        ("base_url", "http://[bad/v1", "--base-url: expected http"),
        ("base_url", "http://localhost:99999/v1", "--base-url: expected http"),
        ("base_url", "http://local host/v1", "--base-url: expected http"),
        ("extra_body", "{", "--extra-body: not JSON"),
        ("extra_body", "[" * 5000, "--extra-body: not JSON"),
        ("extra_body", "[1]", "--extra-body: expected a JSON object"),
        ("extra_body", '{"messages": []}', "the agent sets messages itself"),
        ("extra_body", '{"seed": NaN}', "--extra-body: JSON cannot hold it"),
        ("extra_body", '{"top_p": 1e999}', "--extra-body: JSON cannot hold it"),
        ("price_in", 1.0, "give both"),
        ("protocol", Path("nowhere.toml"), r"nowhere\.toml"),
    ],
)
def test_options_that_make_no_sense_are_refused(option: str, value: object, said: str) -> None:
    with pytest.raises(InvalidArgumentError, match=said) as caught:
        run_settings(GIVEN | {option: value}, {})
    assert "secret" not in str(caught.value)
