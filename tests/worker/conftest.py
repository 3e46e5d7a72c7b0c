"""Real databases, a real file store and real splits; nothing is mocked."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.canary.values import CANARY_M
from tests.support import documents, processes
from tests.support.documents import region_ahead, split_document
from tests.support.worker import worker_settings
from tests.worker.real_broker import QUICK
from tests.worker.world import RunningWorker, World

from exceptiondrive_records.operations.reconciler import run_reconciler as reconcile
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    packaged_protocol,
)
from exceptiondrive_schemas.split import Split


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    return packaged_protocol()


@pytest.fixture(scope="session")
def make_split() -> Callable[..., Split]:
    """Make a split of samples given as `{sample_id: changes}`; regions lie ahead by default."""

    usual = {"region": region_ahead(10.0, CANARY_M)}
    return lambda samples, name="tiny": split_document(
        {key: usual | changes for key, changes in samples.items()}, name
    )


@pytest.fixture(scope="session")
def tiny(make_split: Callable[..., Split]) -> Split:
    """Four samples in two scenes and three families, every region 10 m ahead."""
    return make_split(
        {
            "a": {},
            "b": {"task": "LB1"},
            "c": {"task": "LB1", "scene_id": "scene-2"},
            "d": {"task": "RS1", "scene_id": "scene-2"},
        }
    )


@pytest.fixture(scope="session")
def even(make_split: Callable[..., Split]) -> Split:
    """Six samples, each family in both scenes: the mean of families has an interval."""
    scene_of = dict.fromkeys(("SE1", "LB2", "RS1"), "scene-1")
    scene_of |= dict.fromkeys(("SE3", "LB1", "RS2"), "scene-2")
    return make_split({task: {"task": task, "scene_id": at} for task, at in scene_of.items()})


@pytest.fixture(scope="session")
def planning_file() -> Callable[..., bytes]:
    """Make a planning file: everybody drives straight ahead at a speed, `changes` by sample."""

    def make(
        split: Split,
        edited_mps: float = 1.0,
        source_mps: float = 4.0,
        changes: dict[str, dict[str, Any]] | None = None,
    ) -> bytes:
        speeds_mps = {sample.sample_id: edited_mps for sample in split.samples}
        return documents.planning_file(
            speeds_mps, source_mps=source_mps, changes=changes, split=split.name
        )

    return make


@pytest.fixture
def make_world(tmp_path: Path) -> Iterator[Callable[..., World]]:
    """Make a world on a database, with other settings where given."""
    worlds: list[World] = []

    def make(database_url: str, **changes: Any) -> World:
        worlds.append(World(worker_settings(tmp_path, database_url, **changes)))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def world(make_world: Callable[..., World], sqlite_url: str) -> World:
    """A world on SQLite without a broker: jobs are run in the test's own process."""
    return make_world(sqlite_url)


@pytest.fixture
def phase(world: World, tiny: Split) -> World:
    """The same, with an open phase on the tiny split."""
    world.add_phase(tiny)
    return world


@pytest.fixture
def run_worker(tmp_path: Path) -> Iterator[Callable[..., RunningWorker]]:
    """Start real workers; whatever still runs is killed at the end."""
    workers: list[RunningWorker] = []

    def run(world: World, *arguments: str) -> RunningWorker:
        workers.append(RunningWorker(world.settings, tmp_path / "worker.log", *arguments))
        return workers[-1]

    yield run
    for worker in workers:
        worker.kill_all()


@pytest.fixture
def run_reconciler() -> Iterator[Callable[[World], None]]:
    """Reconcile in a thread until the end of the test."""
    stop, threads = threading.Event(), []

    def run(world: World) -> None:
        dispatcher = Dispatcher(world.settings.broker_url)
        arguments = (world.database, dispatcher, world.settings, stop)
        threads.append(threading.Thread(target=reconcile, args=arguments))
        threads[-1].start()

    yield run
    stop.set()
    for thread in threads:
        thread.join()


@pytest.fixture(scope="session")
def wait_until() -> Callable[..., float]:
    """Wait until a question is answered with yes; fail after a minute."""
    return processes.wait_until


@pytest.fixture
def embedded(make_world: Callable[..., World], sqlite_url: str, broker_url: str) -> World:
    """SQLite and a private broker, as `make run` has them."""
    return make_world(sqlite_url, broker_url=broker_url, **QUICK)
