"""The GitHub Action: its steps, run for real by bash as a runner does, against a real server."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.client.servers import Running
from tests.support.distributions import bare_environment, build

from exceptiondrive_schemas.api.submission import SubmissionView

ROOT = Path(__file__).parents[2]
ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))
EXPRESSION = re.compile(r"\$\{\{\s*([\w.-]+)\s*\}\}")


@dataclass
class Runner:
    """What a runner gives an action: folders, files for outputs and summary, and the ref."""

    temp: Path
    workspace: Path
    is_tag: bool = False
    outputs: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def summary(self) -> str:
        path = self.temp / "summary"
        return path.read_text("utf-8") if path.exists() else ""

    def run(self, **given: str) -> "subprocess.CompletedProcess[str] | None":
        """Run the steps in order up to the first that fails; return that, or the last one run."""
        unknown = set(given) - {name.replace("-", "_") for name in ACTION["inputs"]}
        assert unknown == set()
        values = {
            f"inputs.{name}": given.get(name.replace("-", "_"), each.get("default"))
            for name, each in ACTION["inputs"].items()
        }
        assert None not in values.values(), "an input that is required was not given"
        values["github.ref_type"] = "tag" if self.is_tag else "branch"
        done = None
        for step in ACTION["runs"]["steps"]:
            if step["name"].startswith("Install") or not is_true(step.get("if", "true"), values):
                continue
            done = self._step(step, values)
            if done.returncode != 0:
                return done
        return done

    def install(self, **given: str) -> None:
        (step,) = (s for s in ACTION["runs"]["steps"] if s["name"].startswith("Install"))
        values = {f"inputs.{name}": value for name, value in given.items()}
        done = self._step(step, values)
        if "No matching distribution" in done.stderr or "Could not find a version" in done.stderr:
            pytest.skip("no registry: pip cannot install the client's dependencies")
        assert done.returncode == 0, done.stderr

    def _step(
        self, step: Mapping[str, Any], values: Mapping[str, str]
    ) -> "subprocess.CompletedProcess[str]":
        assert step["shell"] == "bash"
        assert EXPRESSION.search(step["run"]) is None, "values reach a script by its environment"
        output = self.temp / f"output-{len(self.outputs)}"
        environment = {
            name: EXPRESSION.sub(lambda found: values[found[1]], str(value))
            for name, value in step.get("env", {}).items()
        }
        script = self.temp / "step.sh"
        script.write_text(step["run"], encoding="utf-8")
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", script],
            cwd=self.workspace,
            env={
                **{name: value for name, value in os.environ.items() if "EXCEPTION" not in name},
                "RUNNER_TEMP": str(self.temp),
                "GITHUB_ACTION_PATH": str(ROOT),
                "GITHUB_OUTPUT": str(output),
                "GITHUB_STEP_SUMMARY": str(self.temp / "summary"),
                "PIP_NO_COMPILE": "1",  # bytecode of what is never imported costs seconds
                **environment,
            },
            capture_output=True,
            text=True,
            check=False,
        )
        if "id" in step and output.exists():
            lines = output.read_text("utf-8").splitlines()
            self.outputs[step["id"]] = dict(line.split("=", 1) for line in lines)
        return done


def submissions_of(running: Running) -> list[SubmissionView]:
    with running.client() as client:
        return list(client.submissions())


def is_true(condition: str, values: Mapping[str, str]) -> bool:
    """Evaluate the little of GitHub's expressions that an `if` here uses."""
    said = re.sub(r"\b(?:inputs|github)\.[\w-]+", lambda found: repr(values[found[0]]), condition)
    said = said.replace("||", " or ").replace("&&", " and ").replace("true", "True")
    return bool(eval(said, {"__builtins__": {}}))


@pytest.fixture(scope="module")
def temp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the runner in which the client is installed, as the first step does it."""
    folder = tmp_path_factory.mktemp("runner")
    (wheel,) = build("client", folder, "wheel")
    bare_environment(folder / "exceptiondrive", Path(sys.executable), wheel)
    return folder


@pytest.fixture
def runner(temp: Path, tmp_path: Path) -> Runner:
    for name in ("summary", "output-0", "output-1"):
        (temp / name).unlink(missing_ok=True)
    return Runner(temp, tmp_path)


@pytest.fixture
def inputs(working: Running, planning_file: Any) -> dict[str, str]:
    """What a workflow gives: a sound file beside the checkout, and a phase."""
    file = planning_file("of a planner.json")
    return {"file": file.name, "server": working.url, "phase": "dev", "method": "Method $(id) 'x'"}


def test_a_push_is_checked_and_not_submitted(
    runner: Runner, inputs: dict[str, str], working: Running
) -> None:
    done = runner.run(**inputs, token=working.token)
    assert done is not None
    assert done.returncode == 0, done.stderr
    assert "is valid: planning" in done.stdout
    assert "is valid: planning" in runner.summary
    assert runner.outputs == {}
    assert submissions_of(working) == []


def test_a_tag_is_submitted_and_its_rank_is_an_output(
    runner: Runner, inputs: dict[str, str], working: Running
) -> None:
    runner.is_tag = True
    done = runner.run(**inputs, token=working.token)
    assert done is not None
    assert done.returncode == 0, done.stderr
    (submission,) = submissions_of(working)
    assert submission.method == "Method $(id) 'x'"
    named = {"submission": submission.id, "status": "scored", "rank": "1"}
    assert runner.outputs == {"submit": named}
    for output in ACTION["outputs"].values():
        (found,) = EXPRESSION.findall(output["value"])
        assert found.removeprefix("steps.submit.outputs.") in named
    assert submission.id in runner.summary


def test_a_faulty_file_ends_the_job_with_every_fault_in_its_summary(
    runner: Runner, inputs: dict[str, str], working: Running, tmp_path: Path
) -> None:
    runner.is_tag = True
    path = tmp_path / inputs["file"]
    document = json.loads(path.read_text())
    document["predictions"][0]["source"][0] = [1e9, 0.0]
    path.write_text(json.dumps(document), encoding="utf-8")
    done = runner.run(**inputs, token=working.token)
    assert done is not None
    assert done.returncode == 2
    assert "out_of_bounds" in runner.summary
    assert submissions_of(working) == []


def test_a_tag_without_a_token_ends_with_4(runner: Runner, inputs: dict[str, str]) -> None:
    runner.is_tag = True
    done = runner.run(**inputs)
    assert done is not None
    assert done.returncode == 4


@pytest.mark.slow
def test_the_first_step_installs_the_client_of_the_actions_own_version(tmp_path: Path) -> None:
    runner = Runner(tmp_path, tmp_path)
    runner.install(python=sys.executable, client="")
    said = subprocess.run(
        [tmp_path / "exceptiondrive/bin/exceptiondrive", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.startswith("exceptiondrive 0.1.0")


def test_the_workflow_of_the_docs_gives_the_action_what_it_takes() -> None:
    text = (ROOT / "docs/continuous-integration.md").read_text("utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    workflow = yaml.safe_load(block)
    (step,) = (s for s in workflow["jobs"]["submission"]["steps"] if s.get("id"))
    required = {name for name, each in ACTION["inputs"].items() if each.get("required")}
    assert required <= set(step["with"]) <= set(ACTION["inputs"])
