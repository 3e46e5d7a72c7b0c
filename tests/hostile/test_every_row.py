"""No row of the table of bad inputs is without a test."""

from pathlib import Path

from tests.hostile.rows import ROWS, rows_with_tests, table


def test_every_row_has_a_test_and_every_mark_a_row() -> None:
    found = rows_with_tests()
    assert list(ROWS) == [f"I{number:02d}" for number in range(1, 34)]
    assert [row for row in ROWS if not found[row]] == []
    assert set(found) == set(ROWS), "a test is marked with a row that the table does not have"


def test_a_row_without_a_test_is_noticed(tmp_path: Path) -> None:
    source = '@pytest.mark.row("I05")\ndef test_x():\n    pass\n'
    (tmp_path / "test_one.py").write_text("import pytest\n\n" + source)
    found = rows_with_tests(tmp_path)
    assert found["I05"] == ["test_one.py::test_x"]
    assert not found["I06"]


def test_the_table_names_a_test_for_each_row() -> None:
    text = table()
    assert all(f"| {row} | " in text for row in ROWS)
