"""The private store stays within its bounds, and whoever misses a file makes it anew."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.private_store import (
    KeptFile,
    PrivateStore,
    Shelf,
    files_to_prune,
    prune,
)

DAY_S = 86_400
World = Any


@pytest.fixture
def store(tmp_path: Path) -> PrivateStore:
    return PrivateStore(tmp_path / "private")


def kept(name: str, size_bytes: int, used_at: float) -> KeptFile:
    return KeptFile(Path(name), size_bytes, used_at)


def names(files: list[KeptFile]) -> list[str]:
    return [file.path.name for file in files]


def test_what_fits_and_is_used_stays() -> None:
    assert files_to_prune([kept("a", 50, 10), kept("b", 50, 20)], 100, unused_since=10) == []


def test_beyond_the_room_the_longest_unused_goes() -> None:
    files = [kept("old", 30, 1), kept("new", 60, 3), kept("middle", 40, 2)]
    assert names(files_to_prune(files, 100, unused_since=0)) == ["old"]
    assert names(files_to_prune(files, 99, unused_since=0)) == ["middle", "old"]


def test_what_was_not_used_for_long_goes_though_there_is_room() -> None:
    assert names(files_to_prune([kept("a", 1, 5), kept("b", 1, 9)], 100, unused_since=6)) == ["a"]


def age(path: Path, days: float) -> None:
    then = time.time() - days * DAY_S
    os.utime(path, (then, then))


def test_reading_a_file_keeps_it(store: PrivateStore) -> None:
    for key in ("read", "forgotten"):
        store.write(Shelf.COMPARISONS, key, b"{}")
        age(store.root / Shelf.COMPARISONS / key, days=40)
    assert store.read(Shelf.COMPARISONS, "read") == b"{}"
    assert prune(store, max_bytes=10**6, max_age_days=30) == 1
    assert store.read(Shelf.COMPARISONS, "read") == b"{}"
    assert store.read(Shelf.COMPARISONS, "forgotten") is None


def test_dead_verifications_go(store: PrivateStore) -> None:
    dead, alive = store.root / "verify-dead", store.root / "verify-alive"
    for folder in (dead, alive):
        PrivateStore(folder).write(Shelf.COMPARISONS, "k", b"{}")
    age(dead, days=1)
    prune(store, max_bytes=0, max_age_days=30)
    assert (dead.exists(), alive.exists()) == (False, True)


def test_what_was_pruned_is_made_again_bit_for_bit(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    world.add_phase(tiny)
    data = planning_file(tiny)
    world.score(data, method="one")
    before = shelves(world.context.private)
    assert prune(world.context.private, max_bytes=0, max_age_days=30) == len(before) > 0
    assert shelves(world.context.private) == {}
    world.score(data, method="one", team="beta")
    assert shelves(world.context.private) == before


def shelves(store: PrivateStore) -> dict[str, bytes]:
    return {
        f"{shelf}/{path.name}": path.read_bytes()
        for shelf in Shelf
        for path in (store.root / shelf).iterdir()
    }
