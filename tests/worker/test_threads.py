"""A slot is one thread: the other cores belong to other slots."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import os, sys
from exceptiondrive_worker.__main__ import main
sys.argv = ["exceptiondrive-worker", "--help"]
try:
    main()
except SystemExit:
    pass
import numpy as np
np.ones((200, 200)) @ np.ones((200, 200))
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="this system tells no threads")
@pytest.mark.parametrize("wanted", [None, "2"])
def test_a_worker_multiplies_on_one_thread_unless_told_otherwise(wanted: str | None) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    if wanted is not None:
        environment["OPENBLAS_NUM_THREADS"] = wanted
    done = subprocess.run(
        [sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True
    )
    n_cores = len(os.sched_getaffinity(0))
    assert int(done.stdout.split()[-1]) == min(int(wanted or 1), n_cores)
