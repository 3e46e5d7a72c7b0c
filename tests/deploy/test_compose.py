"""The production topology: valid by the compose specification, and with the walls of the design."""

import re
from pathlib import Path
from typing import Any

import compose_spec
import pytest
import yaml

ROOT = Path(__file__).parents[2]


class _Expanded(yaml.SafeDumper):
    """Writes merged anchors out in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _set_variables(text: str) -> str:
    """Put a value where compose would interpolate one."""
    return re.sub(r"\$\{(\w+):\?[^}]*\}", r"/srv/\1", text)


@pytest.fixture
def compose() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(
        _set_variables((ROOT / "compose.yaml").read_text("utf-8"))
    )
    return document


def _validate(compose: dict[str, Any]) -> None:
    compose_spec.PyCompose.from_yaml(yaml.dump(compose, Dumper=_Expanded))


def test_it_is_valid_by_the_compose_specification(compose: dict[str, Any]) -> None:
    _validate(compose)


def test_the_validator_refuses_a_misspelt_key(compose: dict[str, Any]) -> None:
    compose["services"]["server"]["read_onli"] = True
    with pytest.raises(ValueError, match="read_onli"):
        _validate(compose)


def test_only_workers_mount_the_withheld_splits_and_read_only(compose: dict[str, Any]) -> None:
    mounts = {
        name: volume
        for name, service in compose["services"].items()
        for volume in service.get("volumes", [])
        if "splits" in str(volume).lower()
    }
    assert sorted(mounts) == ["worker-live", "worker-rescore"]
    assert all(volume["read_only"] for volume in mounts.values())


def test_only_workers_mount_the_private_store(compose: dict[str, Any]) -> None:
    users = [
        name
        for name, service in compose["services"].items()
        if any("private" in str(volume) for volume in service.get("volumes", []))
    ]
    assert sorted(users) == ["worker-live", "worker-rescore"]


def test_every_service_is_confined(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert "no-new-privileges:true" in service["security_opt"], name
        assert service["user"].split(":")[0] not in {"0", "root"}, name
        assert service["deploy"]["resources"]["limits"]["memory"], name


def test_server_and_worker_run_as_different_users(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert services["server"]["user"] != services["worker-live"]["user"]


def test_every_lasting_service_has_a_health_check(compose: dict[str, Any]) -> None:
    without = {name for name, service in compose["services"].items() if not _is_watched(service)}
    assert without == {"migrate", "reconciler"}  # one runs once; a lease watches the other


def _is_watched(service: dict[str, Any]) -> bool:
    return "healthcheck" in service


def test_no_secret_stands_in_the_file(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        for key, value in service.get("environment", {}).items():
            is_secret = any(word in key for word in ("PASSWORD", "TOKEN", "KEY", "DATABASE_URL"))
            assert not is_secret or str(value).startswith("/run/secrets/"), (name, key)
    assert all(set(secret) == {"file"} for secret in compose["secrets"].values())


def test_the_data_network_reaches_nothing_outside(compose: dict[str, Any]) -> None:
    assert compose["networks"]["data"]["internal"] is True
    outside = [n for n, s in compose["services"].items() if "edge" in s.get("networks", [])]
    assert outside == ["proxy"]


def test_people_type_a_public_address_and_stopping_is_not_hurried(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert services["server"]["environment"]["EXCEPTIONDRIVE_PUBLIC_URL"]
    assert services["server"]["stop_grace_period"] == "45s"
    assert services["worker-live"]["stop_grace_period"] == "120s"


def test_the_proxy_hands_on_the_sender_and_nobody_else_is_believed(compose: dict[str, Any]) -> None:
    """Else all the world would be one sender, and share its attempts to sign in."""
    services = compose["services"]
    (subnet,) = compose["networks"]["front"]["ipam"]["config"]
    trusted = services["server"]["environment"]["EXCEPTIONDRIVE_TRUSTED_PROXIES"]
    assert trusted == subnet["subnet"]
    in_front = [name for name, service in services.items() if "front" in service["networks"]]
    assert sorted(in_front) == ["proxy", "server"]
    assert "data" not in services["proxy"]["networks"], "the proxy has no way to the database"
    nginx = (ROOT / "deploy/nginx.conf").read_text("utf-8")
    locations = nginx.count("proxy_pass http://application")
    assert nginx.count("proxy_set_header X-Forwarded-For $remote_addr;") == locations >= 2
    assert "$proxy_add_x_forwarded_for" not in nginx, "a sender could name another sender"


def test_every_service_has_a_database_role_of_its_own(compose: dict[str, Any]) -> None:
    services = compose["services"]
    address_of = {
        name: secret["source"]
        for name, service in services.items()
        for secret in service.get("secrets", [])
        if isinstance(secret, dict) and secret["target"] == "exceptiondrive_database_url"
    }
    assert address_of == {
        "server": "database_url",
        "reconciler": "reconciler_database_url",
        "worker-live": "worker_database_url",
        "worker-rescore": "worker_database_url",
        "migrate": "owner_database_url",
    }
    mounted = {
        f"--grant-to=/run/secrets/{secret['target']}"
        for secret in services["migrate"]["secrets"]
        if secret["source"] in set(address_of.values()) - {"owner_database_url"}
    }
    assert mounted == set(services["migrate"]["command"][2:])
