"""docs/protocol.md: its example gives what it says, and its names exist."""

import doctest
import importlib
import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "protocol.md"


def test_the_worked_example_gives_what_the_page_says() -> None:
    found = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert found.attempted > 15
    assert found.failed == 0


def test_every_function_that_the_page_names_exists() -> None:
    names = re.findall(r"`(exceptiondrive_\w+(?:\.\w+)+)`", PAGE.read_text("utf-8"))
    assert len(names) > 15
    for name in names:
        module, attribute = name.rsplit(".", 1)
        assert hasattr(importlib.import_module(module), attribute), name
