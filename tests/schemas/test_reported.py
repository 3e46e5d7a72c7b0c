import re
from pathlib import Path

import pytest

from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.reported import reported_entries, reported_paper

PAPER = Path(__file__).parents[2].parent / "shared" / "paper" / "exceptiondrive.tex"

TABLE_1 = """
Impromptu VLA 19.64 78.92 18.87 2.20 1.86 0.70
OmniDrive 9.52 83.36 9.84 1.40 1.34 0.22
AutoVLA 10.37 81.93 11.26 1.97 1.67 0.64
DrivoR 4.86 92.13 5.42 1.25 1.19 0.22
LightEMMA 18.66 79.51 18.04 1.68 1.61 0.23
ST-P3 21.03 78.11 18.59 1.57 1.55 0.24
VAD 13.89 80.26 13.47 1.68 1.47 0.51
"""
TABLE_2 = """
AutoVLA 9.90 12.86 10.22 9.78 9.92 9.56
Impromptu VLA 19.63 20.28 19.98 20.14 17.86 19.95
DrivoR 4.31 4.59 2.61 5.49 3.94 8.27
ST-P3 20.02 19.86 17.48 22.92 24.75 21.17
"""
TABLE_3 = """
Qwen2.5VL-7B 51.86 45.53
Qwen2.5VL-7B + Reminder 70.71 29.18
"""


def table(text: str) -> dict[str, list[str]]:
    rows = {}
    for line in text.strip().splitlines():
        found = re.fullmatch(r"(.+?)((?: \d+\.\d+)+)", line)
        assert found is not None
        rows[found[1]] = found[2].split()
    return rows


@pytest.fixture(scope="module")
def planning() -> tuple[BoardEntry, ...]:
    return reported_entries(PLANNING.id, "macro_family")


def test_table_1_is_kept_digit_for_digit() -> None:
    rows = reported_paper().challenges["planning"].rows
    assert {row.method: list(row.metrics.values()) for row in rows} == table(TABLE_1)
    assert all(list(row.metrics) == ["hcc", "ur", "hpr", "cts", "cts_x", "cts_y"] for row in rows)


def test_table_2_is_kept_digit_for_digit() -> None:
    rows = [row for row in reported_paper().challenges["planning"].rows if row.families]
    assert {row.method: list(row.families.values()) for row in rows} == table(TABLE_2)
    families = [family.id for family in packaged_protocol().families]
    assert all(list(row.families) == families for row in rows)


def test_table_3_is_kept_digit_for_digit() -> None:
    rows = reported_paper().challenges["strategy"].rows
    assert {row.method: list(row.metrics.values()) for row in rows} == table(TABLE_3)


def test_the_tables_here_are_the_tables_of_the_paper() -> None:
    if not PAPER.exists():
        pytest.skip("the paper's source is not beside this repository")
    text = re.sub(r"\\textbf\{([^}]*)\}|~\\cite\{[^}]*\}", r"\1", PAPER.read_text())
    printed = {
        (cells[0].strip().lower(), *(cell.strip() for cell in cells[1:]))
        for cells in (line.rstrip("\\ ").split("&") for line in text.splitlines() if "&" in line)
    }
    for expected in (TABLE_1, TABLE_2, TABLE_3):
        for method, numbers in table(expected).items():
            assert (method.lower(), *numbers) in printed


def test_per_cent_become_fractions_and_metres_stay(planning: tuple[BoardEntry, ...]) -> None:
    first = planning[0]
    assert (
        first.metrics.items()
        >= {
            "hcc": 0.1964,
            "ur": 0.7892,
            "hpr": 0.1887,
            "cts": 2.2,
            "cts_x": 1.86,
            "cts_y": 0.7,
        }.items()
    )
    assert first.families["intersection_conflict"].metrics == {"hcc": 0.1786}
    assert first.families["intersection_conflict"].n is None


def test_reported_rows_are_marked_and_carry_no_rank(planning: tuple[BoardEntry, ...]) -> None:
    for entry in (*planning, *reported_entries(STRATEGY.id, "macro_family")):
        assert entry.source == "reported"
        assert entry.rank is None
        assert entry.rank_interval is None
        assert entry.cite is not None
        assert entry.submission_id is None


def test_another_headline_shows_no_number_of_the_printed_aggregate() -> None:
    for entry in reported_entries(PLANNING.id, "micro"):
        assert set(entry.metrics.values()) == {None}
        assert entry.families == {}
        assert entry.macro_family["hcc"] is not None


def test_strategy_rows_leave_unreported_metrics_undefined() -> None:
    entry = reported_entries(STRATEGY.id, "micro")[0]
    assert entry.metrics == {
        "accuracy": 0.5186,
        "under_warning": 0.4553,
        "over_warning": None,
        "missing": None,
    }


def test_every_row_satisfies_the_laws_of_the_metrics(planning: tuple[BoardEntry, ...]) -> None:
    for entry in planning:
        values = {key: value or 0.0 for key, value in entry.metrics.items()}
        assert values["hcc"] <= 1 - values["ur"]
        assert values["hpr"] <= (values["hcc"] + 1 - values["ur"]) / 2
        assert values["cts"] <= values["cts_x"] + values["cts_y"]
