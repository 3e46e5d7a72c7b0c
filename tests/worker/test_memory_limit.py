import subprocess
import sys

import pytest

from exceptiondrive_worker.process import address_space_bytes

CODE = """
from exceptiondrive_worker.process import limit_memory
limit_memory(200 * 2**20)
kept = bytearray(100 * 2**20)
try:
    bytearray(400 * 2**20)
except MemoryError:
    print("refused")
"""


def test_a_process_cannot_take_more_than_its_headroom() -> None:
    if address_space_bytes() is None:
        pytest.skip("this system does not say how much address space a process has")
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout == "refused\n"
