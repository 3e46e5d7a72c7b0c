"""The production topology: valid by the compose specification, and with the walls of the design."""

import re
from pathlib import Path
from typing import Any

import compose_spec
import pytest
import yaml

from exceptiondrive_records.notifications.channels import NoticeSettings
from exceptiondrive_server.web.settings import ServerSettings

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


def test_images_of_others_are_named_by_their_bytes_the_same_everywhere() -> None:
    """A tag moves: who can move it would choose what runs beside withheld regions."""
    places = ("compose.yaml", "deploy/kubernetes/exceptiondrive.yaml")
    found = [
        set(re.findall(r"image: (?!exceptiondrive-)(.+)", (ROOT / place).read_text("utf-8")))
        for place in places
    ]
    bases = re.findall(r"ARG PYTHON=(\S+)", (ROOT / "Dockerfile").read_text("utf-8"))
    assert found[0] == found[1]
    assert len(found[0]) == 3
    assert len(bases) == 1
    for image in (*found[0], *bases):
        assert re.search(r"@sha256:[0-9a-f]{64}\b", image), image


def test_it_is_valid_by_the_compose_specification(compose: dict[str, Any]) -> None:
    _validate(compose)


def test_the_validator_refuses_a_misspelt_key(compose: dict[str, Any]) -> None:
    compose["services"]["server"]["read_onli"] = True
    with pytest.raises(ValueError, match="read_onli"):
        _validate(compose)


def test_only_workers_mount_the_withheld_splits_and_read_only_but_to_add_one(
    compose: dict[str, Any],
) -> None:
    mounts = {
        name: volume
        for name, service in compose["services"].items()
        for volume in service.get("volumes", [])
        if "splits" in str(volume).lower()
    }
    assert sorted(mounts) == ["add-split", "publish-split", "worker-live", "worker-rescore"]
    assert [name for name, volume in mounts.items() if not volume["read_only"]] == ["add-split"]


def test_only_workers_mount_the_private_store(compose: dict[str, Any]) -> None:
    users = [
        name
        for name, service in compose["services"].items()
        if any("private" in str(volume) for volume in service.get("volumes", []))
    ]
    assert sorted(users) == ["worker-live", "worker-rescore"]


def test_lasting_workers_read_uploads_and_write_none(compose: dict[str, Any]) -> None:
    for name in ("worker-live", "worker-rescore"):
        assert "uploads:/srv/uploads:ro" in compose["services"][name]["volumes"]
    for name in ("publish-split", "add-split"):
        assert compose["services"][name]["profiles"] == ["tools"], "never started by `up`"


@pytest.mark.parametrize(("folder", "service"), [("uploads", "server"), ("private", "worker-live")])
def test_a_new_volume_may_be_written_by_its_service(
    compose: dict[str, Any], folder: str, service: str
) -> None:
    """Docker gives a new volume to whom the folder of the image belongs: else to root."""
    image = (ROOT / "Dockerfile").read_text("utf-8")
    (found,) = re.findall(rf"install -d -o (\d+) -g (\d+) -m \d+ /srv/{folder}\b", image)
    assert ":".join(found) == compose["services"][service]["user"]


def test_the_doctor_of_the_runbook_finds_every_folder_that_it_is_asked_about() -> None:
    """The server's container mounts none of them: the image has each, closed to the server's user."""
    text = (ROOT / "docs/operating.md").read_text("utf-8")
    asked = re.findall(r"--withheld (/\S+?)[ `]", text)
    (made,) = re.findall(r"-o 10002 -g 10001 -m 0700 (.+)", (ROOT / "Dockerfile").read_text())
    assert asked == ["/srv/splits", "/srv/private"]
    assert set(asked) <= set(made.split())


def test_every_service_is_confined(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert "no-new-privileges:true" in service["security_opt"], name
        assert service["user"].split(":")[0] not in {"0", "root"}, name
        assert service["deploy"]["resources"]["limits"]["memory"], name


def test_no_log_grows_for_ever(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        assert service["logging"]["driver"] == "local", name
        assert service["logging"]["options"].keys() == {"max-size", "max-file"}, name


def test_what_stands_for_a_variable_that_is_not_set_is_the_default_of_the_setting() -> None:
    text = (ROOT / "compose.yaml").read_text("utf-8")
    defaults = re.findall(r"EXCEPTIONDRIVE_(\w+): \$\{\w+:-([^}]*)\}", text)
    fields = ServerSettings.model_fields | NoticeSettings.model_fields
    assert len(defaults) >= 8
    assert {name: str(fields[name.lower()].default or "") for name, _ in defaults} == dict(defaults)


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


def test_who_needs_a_way_out_has_one(compose: dict[str, Any]) -> None:
    """Reconcilers send webhooks and mail; a server asks the provider, where there is one."""
    services = compose["services"]
    assert [n for n, s in services.items() if "outside" in s["networks"]] == ["reconciler"]
    added = yaml.safe_load((ROOT / "compose.provider.yaml").read_text("utf-8"))
    assert added == {"services": {"server": {"networks": ["outside"]}}}
    services["server"]["networks"] += added["services"]["server"]["networks"]
    _validate(compose)


def test_the_reconciler_is_given_all_that_mail_takes(compose: dict[str, Any]) -> None:
    service = compose["services"]["reconciler"]
    given = set(service["environment"]) | {
        secret["target"].upper() for secret in service["secrets"] if isinstance(secret, dict)
    }
    names = [name for name in NoticeSettings.model_fields if name.startswith(("smtp_", "mail_"))]
    assert len(names) == 6
    assert {f"EXCEPTIONDRIVE_{name.upper()}" for name in [*names, "public_url"]} <= given


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
    common, *servers = nginx.split("  server {")
    assert "proxy_set_header X-Forwarded-For $remote_addr;" in common
    assert not any("proxy_set_header" in server for server in servers), "it would replace them all"
    assert "$proxy_add_x_forwarded_for" not in nginx, "a sender could name another sender"


def _number(pattern: str, text: str) -> int:
    (found,) = re.findall(pattern, text)
    return int(found)


def test_what_waits_in_the_proxy_fits_into_its_memory(compose: dict[str, Any]) -> None:
    """A file in a container's /tmp is memory: too many of them would end the proxy."""
    proxy = compose["services"]["proxy"]
    nginx = (ROOT / "deploy/nginx.conf").read_text("utf-8")
    bodies_mb = _number(r"limit_conn per_address (\d+);", nginx) * _number(
        r"\n  client_max_body_size (\d+)m;", nginx
    )
    kept_mb = _number(r"max_size=(\d+)m", nginx)
    room_mb = _number(r"^/tmp:size=(\d+)m", proxy["tmpfs"][0])
    memory_mb = _number(r"(\d+)M", proxy["deploy"]["resources"]["limits"]["memory"])
    assert 4 * bodies_mb + kept_mb <= room_mb <= memory_mb - 128


def test_uploads_that_come_slowly_fit_into_the_memory_of_a_server(compose: dict[str, Any]) -> None:
    server = compose["services"]["server"]
    nginx = (ROOT / "deploy/nginx.conf").read_text("utf-8")
    at_once = ServerSettings.model_fields["uploads_at_once"].default
    waiting_mb = at_once * _number(r"\n      client_max_body_size (\d+)m;", nginx)
    room_mb = _number(r"^/tmp:size=(\d+)m", server["tmpfs"][0])
    memory_mb = 1024 * _number(r"(\d+)G", server["deploy"]["resources"]["limits"]["memory"])
    assert waiting_mb <= room_mb <= memory_mb - 256


def test_one_server_may_be_stopped_without_a_gap(compose: dict[str, Any]) -> None:
    assert compose["services"]["server"]["deploy"]["replicas"] >= 2
    assert "container_name" not in compose["services"]["server"], "or it could not be scaled"


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
        "publish-split": "worker_database_url",
        "add-split": "worker_database_url",
        "migrate": "owner_database_url",
    }
    mounted = {
        f"--grant-to=/run/secrets/{secret['target']}"
        for secret in services["migrate"]["secrets"]
        if secret["source"] in set(address_of.values()) - {"owner_database_url"}
    }
    assert mounted == set(services["migrate"]["command"][2:])
