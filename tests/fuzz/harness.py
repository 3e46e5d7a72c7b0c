"""`python -m tests.fuzz.harness [options of libFuzzer] [folder]`: compare the two readers of an upload.

The worker's fast reader says "sound" or "not sure"; the precise checker decides. Inputs that reach
new branches of either are kept and changed further. A difference, or any exception, is a crash.
"""

import importlib
import sys
import tempfile
from pathlib import Path
from typing import Any

atheris: Any = importlib.import_module("atheris")  # on other platforms there is none

with atheris.instrument_imports(
    include=["exceptiondrive_schemas.check", "exceptiondrive_worker", "exceptiondrive_scoring"]
):
    from tests.fuzz.verdicts import assert_one_verdict, seeds

MAX_INPUT_BYTES = 4096


def look(data: bytes) -> None:
    """Judge one input."""
    for is_first in (True, False):
        assert_one_verdict(data, is_planning=is_first)


def main(arguments: list[str]) -> None:
    """Run libFuzzer, with the examples of the documentation as first inputs."""
    with tempfile.TemporaryDirectory(prefix="ed-fuzz-") as folder:
        for name, data in seeds().items():
            Path(folder, name).write_bytes(data)
        options = [f"-max_len={MAX_INPUT_BYTES}", "-timeout=10", "-rss_limit_mb=2048"]
        atheris.Setup([arguments[0], *options, *arguments[1:], folder], look)
        atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv)
