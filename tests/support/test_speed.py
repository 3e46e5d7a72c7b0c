"""The list of the heaviest files names files."""

from pathlib import Path

from tests.support.speed import HEAVIEST

ROOT = Path(__file__).parents[2]


def test_every_file_that_is_to_come_first_is_there() -> None:
    assert [path for path in HEAVIEST if not (ROOT / path).is_file()] == []
