"""Alerts and dashboard ask for metrics and labels that a running server has, in PromQL that parses."""

import json
import re
from pathlib import Path

import httpx
import promql_parser
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from tests.chaos.clients import planning_file
from tests.chaos.topology import PHASE, Topology

from exceptiondrive import Client
from exceptiondrive_server.operations.organizer_pages import LASTING

ROOT = Path(__file__).parents[2]
OF_PROMETHEUS = {"up": {"job", "instance"}}
"""What Prometheus itself says of each server that it scrapes."""
ALERTS = [
    rule
    for group in yaml.safe_load((ROOT / "deploy/prometheus/alerts.yaml").read_text())["groups"]
    for rule in group["rules"]
]
DASHBOARD = json.loads((ROOT / "deploy/grafana/dashboard.json").read_text())
ASKED = {rule["alert"]: str(rule["expr"]) for rule in ALERTS} | {
    panel["title"]: target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]
}


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Name of each metric of a server, with its labels: while its workers stand, and afterwards."""
    topology = Topology(is_forked=True)
    (worker,) = topology.workers
    try:
        file = tmp_path_factory.mktemp("upload") / "planner.json"
        file.write_bytes(planning_file(topology.sample_ids, 5.0))
        topology.freeze_between_writes()
        with Client(topology.url, topology.tokens["beta"]) as client:
            waiting = client.submit(file, phase=PHASE, method="watched")
            topology.wait_until(lambda: "exceptiondrive_troubles{" in scraped(topology), "trouble")
            text = scraped(topology)
            worker.thaw()
            waiting.wait(timeout_s=120)
        text += scraped(topology)
    finally:
        worker.thaw()
        topology.close()
    found: dict[str, set[str]] = dict(OF_PROMETHEUS)
    for family in text_string_to_metric_families(text):
        found.setdefault(family.name, set())
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def scraped(topology: Topology) -> str:
    return httpx.get(f"{topology.url}/metrics", timeout=30).text


class _Reader:
    """Collects the metrics of an expression with the labels that it matches, and those it groups by."""

    def __init__(self, expression: str) -> None:
        self.matched: dict[str, set[str]] = {}
        self.grouped: set[str] = set()
        self._read(promql_parser.parse(expression))

    def _read(self, node: object) -> None:
        if isinstance(node, promql_parser.VectorSelector):
            assert node.name is not None
            labels = {matcher.name for matcher in node.matchers.matchers}
            self.matched.setdefault(node.name, set()).update(labels)
        if isinstance(node, promql_parser.AggregateExpr) and node.modifier is not None:
            self.grouped |= set(node.modifier.labels)
        parts = [getattr(node, name, None) for name in ("lhs", "rhs", "expr", "vector_selector")]
        for part in (*parts, *getattr(node, "args", ())):
            if part is not None:
                self._read(part)


@pytest.mark.parametrize("title", sorted(ASKED))
def test_it_asks_for_what_is_there(title: str, known: dict[str, set[str]]) -> None:
    read = _Reader(ASKED[title])
    assert read.matched
    assert set(read.matched) <= set(known)
    labels = set[str]()
    for name, matched in read.matched.items():
        assert matched <= known[name], name
        labels |= known[name]
    assert read.grouped <= labels


def test_every_alarm_of_the_runbook_has_an_alert() -> None:
    """And each alert names a section of the runbook."""
    text = (ROOT / "docs/operating.md").read_text("utf-8")
    table = text.split("## Every day")[1].split("\nMetrics are")[0]
    rows = [row for row in table.splitlines() if row.startswith("| ")][1:]
    named = set(re.findall(r"`(exceptiondrive_[a-z_]+)", table))
    assert [row for row in rows[:-2] if "`exceptiondrive_" not in row.split(" | ")[0]] == []
    asked = {name for rule in ALERTS for name in _Reader(str(rule["expr"])).matched}
    assert len(named) >= 7
    assert named <= {name.removesuffix("_count") for name in asked}
    sections = set(re.findall(r"^## (.+)$", text, re.MULTILINE))
    assert {rule["annotations"]["runbook"] for rule in ALERTS} <= sections


def test_troubles_that_may_stand_for_a_season_wake_nobody() -> None:
    asked = {rule["alert"]: rule for rule in ALERTS if "troubles" in str(rule["expr"])}
    lasting = f'"{"|".join(LASTING)}"'
    assert {name: rule["labels"]["severity"] for name, rule in asked.items()} == {
        "UrgentTrouble": "page",
        "LastingTrouble": "ticket",
    }
    assert f"trouble!~{lasting}" in asked["UrgentTrouble"]["expr"]
    assert f"trouble=~{lasting}" in asked["LastingTrouble"]["expr"]


def test_every_metric_of_ours_is_on_the_dashboard(known: dict[str, set[str]]) -> None:
    panels = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
    shown = {name for expression in panels for name in _Reader(expression).matched}
    ours = {name for name in known if name.startswith("exceptiondrive_")}
    families = {re.sub(r"_(bucket|count|sum|created)$", "", name) for name in ours}
    assert families <= {re.sub(r"_(bucket|count)$", "", name) for name in shown}


def test_a_misspelt_metric_would_be_seen(known: dict[str, set[str]]) -> None:
    read = _Reader("max by (lane) (exceptiondrive_live_worker{lan='live'}) > 0")
    assert set(read.matched) == {"exceptiondrive_live_worker"}
    assert (read.matched["exceptiondrive_live_worker"], read.grouped) == ({"lan"}, {"lane"})
    assert "exceptiondrive_live_worker" not in known
