import stat
from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from exceptiondrive_worker.splits.private_store import (
    PrivateStore,
    Shelf,
    array_digest,
    content_key,
    pack_columns,
)

COLUMNS = {
    "clearance_m": np.array([0.0, 1.25, np.nan]),
    "intrusion": np.array([True, False, True]),
    "edited": np.arange(12, dtype=np.float64).reshape(3, 2, 2),
}


@pytest.fixture
def store(tmp_path: Path) -> PrivateStore:
    return PrivateStore(tmp_path / "private")


def test_columns_come_back_bit_for_bit(store: PrivateStore) -> None:
    store.write_columns(Shelf.MEASUREMENTS, "k", COLUMNS)
    found = store.read_columns(Shelf.MEASUREMENTS, "k")
    assert found is not None
    assert pack_columns(found) == pack_columns(COLUMNS)
    assert found["edited"].shape == (3, 2, 2)
    assert found["intrusion"].dtype == np.bool_


def test_what_cannot_be_kept_is_told_and_keeps_nothing_from_being_scored(
    store: PrivateStore,
) -> None:
    """As on a full or read-only disk: whoever asks for it makes it again."""
    folder = store.root / Shelf.MEASUREMENTS
    folder.rmdir()
    with capture_logs() as lines:
        store.write_columns(Shelf.MEASUREMENTS, "k", COLUMNS)
    assert [line["shelf"] for line in lines] == ["measurements"]
    assert store.read_columns(Shelf.MEASUREMENTS, "k") is None


def test_what_cannot_be_read_is_told_and_absent(store: PrivateStore) -> None:
    folder = store.root / Shelf.MEASUREMENTS
    folder.rmdir()
    folder.touch()
    with capture_logs() as lines:
        assert store.read_columns(Shelf.MEASUREMENTS, "k") is None
    assert [(line["shelf"], line["why"]) for line in lines] == [("measurements", "Not a directory")]


def test_a_plain_number_keeps_having_no_axes(store: PrivateStore) -> None:
    store.write_columns(Shelf.INTERVALS, "k", {"n": np.asarray(7), "none": np.empty((0, 2))})
    found = store.read_columns(Shelf.INTERVALS, "k")
    assert found is not None
    assert found["n"].shape == ()
    assert found["n"].item() == 7
    assert found["none"].shape == (0, 2)


def test_columns_of_any_layout_come_back(store: PrivateStore) -> None:
    turned = np.arange(6.0).reshape(2, 3).T
    store.write_columns(Shelf.INTERVALS, "k", {"turned": turned})
    found = store.read_columns(Shelf.INTERVALS, "k")
    assert found is not None
    assert found["turned"].tolist() == turned.tolist()


def test_columns_lie_where_numbers_may_lie_in_memory(store: PrivateStore) -> None:
    flags = {f"a{n}": np.ones(n, dtype=np.bool_) for n in range(1, 9)}
    numbers = {f"b{n}": np.arange(n, dtype=np.float64) for n in range(1, 9)}
    store.write_columns(Shelf.MEASUREMENTS, "k", flags | numbers | {"text": np.array(b"odd")})
    found = store.read_columns(Shelf.MEASUREMENTS, "k")
    assert found is not None
    assert all(column.flags.aligned for column in found.values())
    assert [found[f"b{n}"].tolist() for n in range(1, 9)] == [
        each.tolist() for each in numbers.values()
    ]


def test_an_unknown_key_is_absent(store: PrivateStore) -> None:
    assert store.read_columns(Shelf.MEASUREMENTS, "k") is None


def test_a_file_cut_short_is_absent_and_can_be_written_again(store: PrivateStore) -> None:
    store.write_columns(Shelf.MEASUREMENTS, "k", COLUMNS)
    path = store.root / Shelf.MEASUREMENTS / "k"
    path.write_bytes(path.read_bytes()[:-3])
    assert store.read_columns(Shelf.MEASUREMENTS, "k") is None
    store.write_columns(Shelf.MEASUREMENTS, "k", COLUMNS)
    assert store.read_columns(Shelf.MEASUREMENTS, "k") is not None


@pytest.mark.parametrize("place", [0, 40, -1], ids=["checksum", "head", "body"])
def test_one_flipped_bit_makes_a_file_absent(store: PrivateStore, place: int) -> None:
    store.write_columns(Shelf.SETTLED, "k", COLUMNS)
    path = store.root / Shelf.SETTLED / "k"
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert store.read_columns(Shelf.SETTLED, "k") is None


@pytest.mark.parametrize("n_zeros", [0, 1, 4, 5, 4096])
def test_a_file_of_which_a_power_cut_left_zeros_is_absent(
    store: PrivateStore, n_zeros: int
) -> None:
    (store.root / Shelf.COMPARISONS / "k").write_bytes(bytes(n_zeros))
    assert store.read(Shelf.COMPARISONS, "k") is None


def test_only_the_owner_may_enter_or_read(store: PrivateStore) -> None:
    store.write(Shelf.COMPARISONS, "k", b"{}")
    for folder in (store.root, store.root / Shelf.COMPARISONS):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE((store.root / Shelf.COMPARISONS / "k").stat().st_mode) == 0o600


def test_a_folder_that_stood_open_is_closed(tmp_path: Path) -> None:
    root = tmp_path / "private"
    root.mkdir(mode=0o755)
    PrivateStore(root)
    assert stat.S_IMODE(root.stat().st_mode) == 0o700


def test_a_writer_that_is_killed_on_its_way_leaves_nothing_that_is_read(
    store: PrivateStore,
) -> None:
    data = pack_columns(COLUMNS)
    store.write(Shelf.SETTLED, "k", data)
    path = store.root / Shelf.SETTLED / "k"
    whole = path.read_bytes()
    for n_written in range(len(whole)):  # over what another one wrote whole, or half
        path.write_bytes(whole[:n_written])
        assert store.read(Shelf.SETTLED, "k") is None
        path.write_bytes(bytes(n_written) + whole[n_written:])
        assert n_written == 0 or store.read(Shelf.SETTLED, "k") is None
    path.write_bytes(whole)
    assert store.read(Shelf.SETTLED, "k") == data


def test_keys_tell_apart_what_joining_would_confuse() -> None:
    assert content_key("ab", "c") != content_key("a", "bc")


def test_array_digests_see_type_shape_and_bits() -> None:
    zeros = np.zeros((2, 3))
    digests = {
        array_digest(zeros),
        array_digest(zeros.T),
        array_digest(zeros.astype(np.float32)),
        array_digest(-zeros),
        array_digest(zeros, zeros),
    }
    assert len(digests) == 5


def test_the_order_of_columns_does_not_matter() -> None:
    assert pack_columns(dict(reversed(COLUMNS.items()))) == pack_columns(COLUMNS)
