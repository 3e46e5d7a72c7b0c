"""The list of the heaviest files names files."""

from pathlib import Path

from tests.heaviest_first import HEAVIEST

ROOT = Path(__file__).parents[1]


def test_every_file_that_is_to_come_first_is_there() -> None:
    assert [path for path in HEAVIEST if not (ROOT / path).is_file()] == []
