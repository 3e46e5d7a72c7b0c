"""The manifests are valid by the published schemas of Kubernetes, and say what compose.yaml says."""

from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

ROOT = Path(__file__).parents[2]
VERSION = "1.30.0"
"""The oldest that the manifests are held to; the newest that the validator knows is tried, too."""
TOOLS = {"add-split", "publish-split"}
"""Services of compose that run by hand alone."""
Document = dict[str, Any]
DOCUMENTS: list[Document] = list(
    yaml.safe_load_all((ROOT / "deploy/kubernetes/exceptiondrive.yaml").read_text("utf-8"))
)
COMPOSE: Document = yaml.safe_load((ROOT / "compose.yaml").read_text("utf-8"))
SERVICES = {name: said for name, said in COMPOSE["services"].items() if name not in TOOLS}
POD_TEMPLATES: dict[str, Document] = {
    document["metadata"]["name"]: document["spec"]["template"]
    for document in DOCUMENTS
    if document["kind"] in {"Deployment", "StatefulSet", "Job"}
}
POLICIES: dict[str, Document] = {
    document["metadata"]["name"]: document["spec"]
    for document in DOCUMENTS
    if document["kind"] == "NetworkPolicy"
}


@pytest.mark.parametrize("version", [VERSION, kubernetes_validate.latest_version()])
def test_every_manifest_is_valid(version: str) -> None:
    for document in DOCUMENTS:
        kubernetes_validate.validate(document, version, strict=True)


def test_the_validator_refuses_a_misspelt_key() -> None:
    spoilt = {**DOCUMENTS[0], "metdata": {}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(spoilt, VERSION, strict=True)


def container(name: str) -> Document:
    (found,) = POD_TEMPLATES[name]["spec"]["containers"]
    assert isinstance(found, dict)
    return found


def test_both_have_the_same_services_and_as_many() -> None:
    assert set(POD_TEMPLATES) == set(SERVICES)
    for document in DOCUMENTS:
        if document["kind"] == "Deployment":
            said = SERVICES[document["metadata"]["name"]]["deploy"]
            assert document["spec"]["replicas"] == said.get("replicas", 1)


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_the_same_user_command_and_image(name: str) -> None:
    said, found, pod = SERVICES[name], container(name), POD_TEMPLATES[name]["spec"]
    user = pod["securityContext"]
    assert f"{user['runAsUser']}:{user['runAsGroup']}" == said["user"]
    assert found["image"] == said["image"]
    assert found.get("command", found.get("args")) == said.get("command")
    names = {variable["name"] for variable in found.get("env", ())}
    assert names - {"PGDATA"} == set(said.get("environment", {}))
    grace_s = said.get("stop_grace_period", "30s").rstrip("s")
    assert pod.get("terminationGracePeriodSeconds", 30) == int(grace_s)
    limits = said["deploy"]["resources"]["limits"]
    assert found["resources"]["limits"] == {"cpu": limits["cpus"], "memory": f"{limits['memory']}i"}


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_confined(name: str) -> None:
    pod = POD_TEMPLATES[name]["spec"]
    assert pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert container(name)["securityContext"] == {
        "readOnlyRootFilesystem": True,
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
    }


def _mounts_of_compose(said: Document) -> dict[str, bool]:
    """Return target to whether it is read-only."""
    found = {}
    for volume in said.get("volumes", ()):
        if isinstance(volume, str):
            _, target, *mode = volume.split(":")
            found[target] = mode == ["ro"]
        else:
            found[volume["target"]] = volume["read_only"]
    return found


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_sees_the_same_folders_and_secrets(name: str) -> None:
    """So regions and the private store are the workers' alone, as in compose."""
    said, found, pod = SERVICES[name], container(name), POD_TEMPLATES[name]["spec"]
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    lasting = {
        mount["mountPath"]: mount.get("readOnly", False)
        for mount in found["volumeMounts"]
        if not {"emptyDir", "secret"} & set(volumes[mount["name"]])
    }
    assert lasting == _mounts_of_compose(said)
    assert ("/srv/splits" in lasting) is name.startswith("worker-")
    items = volumes.get("secrets", {"secret": {"items": []}})["secret"]["items"]
    files = {key: Path(each["file"]).name for key, each in COMPOSE["secrets"].items()}
    assert {item["path"]: item["key"] for item in items} == {
        secret if isinstance(secret, str) else secret["target"]: files[
            secret if isinstance(secret, str) else secret["source"]
        ]
        for secret in said.get("secrets", ())
    }


@pytest.mark.parametrize("name", SERVICES)
def test_a_check_of_health_ends_nothing(name: str) -> None:
    """As in compose. That of a worker asks the database: all would be killed over and over while it is away."""
    assert "livenessProbe" not in container(name)
    assert ("readinessProbe" in container(name)) is ("healthcheck" in SERVICES[name])


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_in_the_same_networks(name: str) -> None:
    labels = POD_TEMPLATES[name]["metadata"]["labels"]
    joined = {label.removeprefix("network-") for label in labels if label.startswith("network-")}
    assert joined == set(SERVICES[name]["networks"])


def test_networks_reach_what_those_of_compose_reach() -> None:
    """An internal network is closed in itself; nothing is open that no policy opens."""
    assert POLICIES["nothing-else"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    for network, said in COMPOSE["networks"].items():
        policy = POLICIES[network]
        own = {"podSelector": {"matchLabels": {f"network-{network}": "true"}}}
        assert policy["podSelector"] == own["podSelector"]
        if said.get("internal"):
            assert policy["ingress"] == [{"from": [own]}]
            assert policy["egress"] == [{"to": [own]}]
    assert "ingress" not in POLICIES["outside"], "nothing listens there"
    assert "egress" not in POLICIES["edge"]
    (way_out,) = POLICIES["outside"]["egress"]
    assert "10.0.0.0/8" in way_out["to"][0]["ipBlock"]["except"]
    assert set(POLICIES) == {*COMPOSE["networks"], "nothing-else", "names"}
