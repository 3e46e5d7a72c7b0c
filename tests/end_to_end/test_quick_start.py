"""A newcomer pastes the quick start of a phase into a shell, block by block, against a real system.

The client is the wheel that the server itself hands out, in an environment of its own, which all phases
install alike. The machine's registry gives the dependencies; where it cannot be reached, the tests skip
and say so.
"""

import hashlib
import html
import json
import re
import shutil
import subprocess
import sys
import urllib.request
import venv
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support import extract
from tests.support.distributions import ROOT, build
from tests.support.floors import leave_open
from tests.support.processes import wait_until
from tests.support.system import System, running_system

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]  # pip installs
ENVIRONMENT = "exceptiondrive-client"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """A system with the sample, whose regions are public, a withheld phase, and the client."""
    base = tmp_path_factory.mktemp("quick")
    made = extract.make_extract()
    made.write(base / "files")
    shutil.copytree(ROOT / "hidden_splits", base / "splits")
    leave_open(base / "splits" / extract.NAME)
    shutil.copy(base / "files" / "split.json.gz", base / "splits" / extract.NAME / "split.json.gz")
    (base / "client").mkdir()
    build("client", base / "client", "wheel")
    more = {"EXCEPTIONDRIVE_CLIENT_DIR": str(base / "client")}
    with running_system(base / "data", base / "splits", "--sample", **more) as running:
        wait_until(lambda: "sample" in running.read("/api/v1/phases"), "the sample", 240)
        running.work("register-splits")
        running.open_phase("withheld", extract.NAME)
        yield running


def blocks(system: System, phase: str) -> list[str]:
    """The commands of the page, as a reader copies them."""
    page = system.read(f"/submit?phase={phase}")
    steps = page.split('<ol class="start">')[1].split("</ol>")[0]
    found = re.findall(r"<pre[^>]*>(.*?)</pre>", steps, re.DOTALL)
    assert found
    return [html.unescape(re.sub("<[^>]+>", "", block)) for block in found]


def installs(system: System, phase: str) -> list[str]:
    """The lines of the page that make and fill an environment."""
    lines = "\n".join(blocks(system, phase)).splitlines()
    return [line for line in lines if "venv" in line or "pip" in line]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the first phase installs; what the next ones install is there already."""
    return tmp_path_factory.mktemp("installed")


@pytest.fixture
def folder(installed: Path) -> Iterator[Path]:
    """Where a newcomer works: nothing is there but what an earlier phase has installed."""
    yield installed
    for path in installed.iterdir():
        if path.is_file():
            path.unlink()
        elif path.name != ENVIRONMENT:
            shutil.rmtree(path)


def paste(block: str, system: System, folder: Path, token: str) -> str:
    """Run a block in a shell that is in the environment which the first block makes."""
    activate = folder / ENVIRONMENT / "bin/activate"
    ready = f". {activate}\n" if activate.exists() else ""
    # bytecode of what is never imported would be half of an installation
    pip = {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_COMPILE": "1"}
    environment = {**system.environment(), **pip}
    environment.pop("EXCEPTIONDRIVE_SERVER")  # the commands name it
    done = subprocess.run(
        ["bash", "-c", f"set -e\n{ready}{block}"],
        cwd=folder,
        env=environment,
        input=f"{token}\n",
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    if done.returncode and "pip install" in block and "No matching distribution" in done.stderr:
        pytest.skip(f"no packages at hand: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


@pytest.mark.parametrize("phase", ["withheld", "sample", "sample-strategy"])
def test_the_quick_start_runs_as_pasted(system: System, folder: Path, phase: str) -> None:
    token = system.make_team(f"new-{phase}")
    assert len(installs(system, phase)) == 3
    assert installs(system, phase) == installs(system, "withheld"), "they share an environment"
    assert re.findall("--allow[a-z-]*|--replace|--force", "".join(blocks(system, phase))) == [
        "--allow-unranked"
    ], "for the stand-in, which takes no rank; the page says to leave it out"
    told = [paste(block, system, folder, token) for block in blocks(system, phase)]
    assert len(told) == 5
    mine = system.submissions(token)
    assert [(one["phase"], one["status"]) for one in mine] == [(phase, "scored")]
    assert "HCC" in told[3] or phase == "sample-strategy"
    assert (folder / ENVIRONMENT / "bin/exceptiondrive").exists()


def test_the_quick_start_of_a_withheld_phase_scores_a_public_split(system: System) -> None:
    text = "".join(blocks(system, "withheld"))
    assert f"split download {extract.NAME}" not in text
    assert "split download sample" in text
    assert "--phase withheld" in text


def test_recorder_and_wheel_come_with_their_digests(system: System) -> None:
    page = system.read("/client/")
    own = (ROOT / "client/exceptiondrive/recorder.py").read_bytes()
    for address in ("/recorder.py", "/client/recorder.py"):
        with urllib.request.urlopen(system.url + address) as answer:
            given = answer.read()
        assert given == own
    assert hashlib.sha256(given).hexdigest() in page
    found = re.search(r'href="(/client/exceptiondrive-[^"]*\.whl)#sha256=([0-9a-f]{64})"', page)
    assert found is not None
    with urllib.request.urlopen(system.url + found[1]) as answer:
        assert hashlib.sha256(answer.read()).hexdigest() == found[2]


def test_pip_installs_the_client_from_the_server_alone(system: System, tmp_path: Path) -> None:
    """As on a closed network: nothing but the server is asked, here without the dependencies."""
    venv.create(tmp_path / "bare")
    pip = [sys.executable, "-m", "pip", "--python", str(tmp_path / "bare/bin/python")]
    options = ["--no-index", f"--find-links={system.url}/client/"]
    command = [*pip, "install", "--no-deps", "--isolated", *options, "exceptiondrive"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    listed = subprocess.run(
        [*pip, "list", "--format", "json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "exceptiondrive" in {one["name"] for one in json.loads(listed.stdout)}


def test_pip_refuses_a_wheel_that_is_not_the_one_of_the_page(
    system: System, tmp_path: Path
) -> None:
    page = system.read("/client/")
    found = re.search(r"(/client/exceptiondrive-[^\"]*\.whl#sha256=)([0-9a-f]{64})", page)
    assert found is not None
    wrong = f"exceptiondrive @ {system.url}{found[1]}{'0' * 64}"
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "-d", str(tmp_path), wrong]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "hash" in done.stderr.lower()
