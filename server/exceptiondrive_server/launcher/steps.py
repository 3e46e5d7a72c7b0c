"""A step of the start that is a command of ours: what it prints, or why it failed."""

import subprocess
from collections.abc import Callable, Mapping

from exceptiondrive_server.launcher.child import LaunchError

Say = Callable[[str], None]


def run_step(command: list[str], environment: Mapping[str, str]) -> str:
    """Run a command to its end and return what it printed.

    Raises:
        LaunchError: It failed; its own words are part of the text.
    """
    done = subprocess.run(
        command, env=dict(environment), capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise LaunchError(f"`{' '.join(command[1:])}` failed:\n{done.stderr or done.stdout}")
    return done.stdout
