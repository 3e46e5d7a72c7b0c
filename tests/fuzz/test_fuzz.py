"""A few seconds of coverage-guided inputs; `make fuzz` runs them for as long as you like."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.fuzz.verdicts import assert_one_verdict, seeds

N_RUNS = 3000
ROOT = Path(__file__).parents[2]
needs_atheris = pytest.mark.skipif(
    importlib.util.find_spec("atheris") is None,
    reason="atheris has wheels for CPython 3.11 on Linux x86-64 alone",
)


def fuzz(folder: Path, *, plugin: str = "") -> subprocess.CompletedProcess[str]:
    """Run the harness with a bound on inputs, not on time, and one seed."""
    begin = f"import {plugin}; " if plugin else ""
    code = f"{begin}import sys; from tests.fuzz.harness import main; main(sys.argv)"
    options = [f"-runs={N_RUNS}", "-seed=7", f"-artifact_prefix={folder}/", "-print_final_stats=1"]
    return subprocess.run(
        [sys.executable, "-c", code, *options],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_some_first_inputs_are_sound() -> None:
    """Else the fuzzer would only ever look at the first check."""
    sound = [
        (name, is_planning)
        for name, data in seeds().items()
        for is_planning in (True, False)
        if assert_one_verdict(data, is_planning=is_planning)
    ]
    assert len(sound) == 4


@needs_atheris
def test_no_input_parts_the_two_readers(tmp_path: Path) -> None:
    done = fuzz(tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]
    ran = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    assert ran is not None
    assert int(ran[1]) >= N_RUNS
    assert list(tmp_path.iterdir()) == []


@needs_atheris
def test_the_fuzzer_would_find_a_difference(tmp_path: Path) -> None:
    """A fast reader that looks at no sample id is found out."""
    done = fuzz(tmp_path, plugin="tests.fuzz.gullible")
    assert done.returncode != 0
    assert "the fast reader took what the checker refuses" in done.stdout + done.stderr
    assert [path.name.partition("-")[0] for path in tmp_path.iterdir()] == ["crash"]
