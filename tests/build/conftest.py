"""A workshop with generated scenes, and a server that stands in for its models."""

import os
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import pytest
from tests.support.stand_in import StandIn

from exceptiondrive_build.scenes.generated import make_scenes
from exceptiondrive_build.scenes.read_in import read_in
from exceptiondrive_build.workshop import Workshop, new_workshop

KEY = "0123456789abcdef" * 4


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A made-up set of three scenes, a folder in nuScenes form."""
    folder = tmp_path_factory.mktemp("scenes")
    make_scenes(folder, n_scenes=3, n_samples=7, seed=3, width_px=320)
    return folder


@pytest.fixture(scope="session")
def read_shop(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workshop folder with the scenes read in, to copy."""
    folder = tmp_path_factory.mktemp("shops") / "shop"
    new_workshop(folder, "made-2027", KEY)
    with Workshop(folder) as workshop:
        read_in(workshop, scenes)
    return folder


@pytest.fixture
def stand_in(read_shop: Path) -> Iterator[StandIn]:
    with Workshop(read_shop) as workshop:
        server = StandIn.of(workshop)
    yield server
    server.close()


@pytest.fixture
def shop(read_shop: Path, stand_in: StandIn, tmp_path: Path) -> Path:
    """A workshop of three keyframes whose endpoints are the stand-in; six tasks are in use."""
    folder = Path(copytree(read_shop, tmp_path / "shop"))
    path = folder / "workshop.toml"
    text = path.read_text()
    for port in (8000, 8001):
        text = text.replace(f"http://127.0.0.1:{port}/v1", stand_in.base_url)
    tasks = '"SE1", "LB1", "LB3", "BG1", "SR1", "RS1"'
    path.write_text(text.replace("tasks = []", f"tasks = [{tasks}]"))
    return folder


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The key of the tests, and no proxy between us and the loopback."""
    for name in list(os.environ):
        if name.startswith("OPENAI_") or name.upper().endswith("_PROXY"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("EXCEPTIONDRIVE_BUILD_KEY", "key-of-the-tests-0123456789")
