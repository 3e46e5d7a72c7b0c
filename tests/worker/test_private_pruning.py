"""The private store stays within its bounds, and whoever misses a file makes it anew."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.private_store import (
    PrivateStore,
    Shelf,
    prune,
)

DAY_S = 86_400
World = Any


@pytest.fixture
def store(tmp_path: Path) -> PrivateStore:
    return PrivateStore(tmp_path / "private")


def age(path: Path, days: float) -> None:
    then = time.time() - days * DAY_S
    os.utime(path, (then, then))


def keep(store: PrivateStore, key: str, size_bytes: int, days: float) -> None:
    path = store.root / Shelf.COMPARISONS / key
    path.write_bytes(bytes(size_bytes))
    age(path, days)


@pytest.mark.parametrize(
    ("max_bytes", "max_age_days", "left"),
    [
        (100, 30, ["middle", "new"]),
        (99, 30, ["new"]),
        (130, 30, ["middle", "new", "old"]),
        (130, 2.5, ["middle", "new"]),
    ],
    ids=["the longest unused goes", "and the next", "what fits stays", "unused for long"],
)
def test_beyond_the_room_and_the_age_the_longest_unused_goes(
    store: PrivateStore, max_bytes: int, max_age_days: float, left: list[str]
) -> None:
    keep(store, "old", 30, days=3)
    keep(store, "new", 60, days=1)
    keep(store, "middle", 40, days=2)
    assert prune(store, max_bytes=max_bytes, max_age_days=max_age_days) == 3 - len(left)
    assert sorted(path.name for path in (store.root / Shelf.COMPARISONS).iterdir()) == left


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
