"""The short form: without a few protections their tests fail; `make protections` tries all."""

import importlib
import operator
import re
from pathlib import Path

import pytest
from tests.protections.protection import Protection
from tests.protections.run import outcome_without
from tests.protections.table import PROTECTIONS

from exceptiondrive_records.operations import invariants

ROOT = Path(__file__).parents[2]
SHORT = [each for each in PROTECTIONS if each.is_short]


@pytest.mark.slow
@pytest.mark.parametrize("protection", SHORT, ids=[each.name for each in SHORT])
def test_without_it_a_test_fails(protection: Protection) -> None:
    is_noticed, line = outcome_without(protection)
    assert is_noticed, line


def test_a_test_that_does_not_notice_is_told() -> None:
    """The runner is able to say no: this test has nothing to do with the canary."""
    canary = next(each for each in PROTECTIONS if each.name == "canary")
    elsewhere = "tests/schemas/test_check_rules.py"
    other = Protection(canary.name, canary.target, canary.instead, elsewhere)
    is_noticed, line = outcome_without(other)
    assert not is_noticed, line


def test_every_protection_names_a_test_that_is_there() -> None:
    assert len({each.name for each in PROTECTIONS}) == len(PROTECTIONS)
    for each in PROTECTIONS:
        path, _, name = each.test.partition("::")
        text = (ROOT / path).read_text(encoding="utf-8")
        assert f"def {name}(" in text if name else text, each.name


@pytest.mark.parametrize("target", sorted({each.target for each in PROTECTIONS}))
def test_what_a_protection_replaces_is_there(target: str) -> None:
    module, _, path = target.partition(":")
    operator.attrgetter(path)(importlib.import_module(module))


def test_each_check_of_what_the_audit_log_must_tell_is_taken_away_by_one() -> None:
    checks = {name for name in vars(invariants) if name.startswith("unlogged_")}
    targets = {each.target.rpartition(":")[2] for each in PROTECTIONS}
    assert checks
    assert checks <= targets


def test_the_documentation_has_a_row_for_every_protection_with_its_test() -> None:
    pages = (ROOT / "docs" / name for name in ("trust.md", "rescoring.md"))
    rows = {
        name: test
        for page in pages
        for name, test in re.findall(
            r"^\| `([\w-]+)` \| [^|]+ \| ([^|]+) \|", page.read_text(encoding="utf-8"), re.MULTILINE
        )
    }
    names = [each.test.rpartition("::")[2].removeprefix("test_") for each in PROTECTIONS]
    assert rows.keys() == {each.name for each in PROTECTIONS}
    missing = [
        each.name
        for each, name in zip(PROTECTIONS, names, strict=True)
        if name not in rows[each.name] and rows[each.name] != "the same"
    ]
    assert missing == []
