"""Take one protection away and run its test, in a process of its own."""

import os
import re
import subprocess
import sys
from pathlib import Path

from tests.protections.plugin_name import NAME
from tests.protections.protection import Protection

ROOT = Path(__file__).parents[2]


def outcome_without(protection: Protection) -> tuple[bool, str]:
    """Return whether the test noticed, and the line of pytest that says so.

    Only a failed test counts: one that breaks while it is set up, or that is not there, does not.
    """
    command = [sys.executable, "-m", "pytest", "-p", "tests.protections.plugin", "-x", "--tb=line"]
    done = subprocess.run(
        [*command, "-p", "no:cacheprovider", protection.test],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), NAME: protection.name},
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stdout.strip().splitlines()[-1:] or [done.stderr.strip()[-200:]]
    was_done = f"taken away: {protection.name}" in done.stdout
    has_failed = re.search(r"\b[1-9]\d* failed\b", last[0]) is not None and "error" not in last[0]
    return was_done and done.returncode == 1 and has_failed, last[0].strip("= ")
