"""A shell with a person before it: commands of a page, pasted on a terminal, and what is typed then."""

import os
import pty
import subprocess
from collections.abc import Mapping
from pathlib import Path

END_OF_INPUT = "\x04"


def pasted_on_a_terminal(
    commands: str, typed: str, folder: Path, environment: Mapping[str, str], timeout_s: float = 300
) -> tuple[int, str]:
    """Run commands in a shell on a pseudo-terminal that ends at the first failure.

    Args:
        commands: What is pasted.
        typed: What questions are answered with; after it nothing more comes.
        folder: Where the shell is.
        environment: What it finds in its environment.
        timeout_s: How long it may take.

    Returns:
        The exit code, and all that stood on the screen, in wide lines.
    """
    person, terminal = pty.openpty()
    process = subprocess.Popen(
        ["timeout", str(timeout_s), "bash", "-ec", commands],
        cwd=folder,
        env={**environment, "COLUMNS": "400", "TERM": "dumb"},
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
    )
    os.close(terminal)
    os.write(person, (typed + END_OF_INPUT).encode())
    screen = b""
    while True:
        try:
            seen = os.read(person, 65536)
        except OSError:  # Linux: the last process that held the terminal has ended
            break
        if not seen:
            break
        screen += seen
    os.close(person)
    return process.wait(), screen.decode().replace("\r\n", "\n")
