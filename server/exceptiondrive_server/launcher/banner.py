"""What a newcomer is told once the server answers."""

import os
import shlex
import sys
from pathlib import Path

from exceptiondrive_server.launcher.plans import Address

_BANNER = """
  ExceptionDrive runs at {url}      (Ctrl-C ends it; all data stays in {data})

  To take part, in another terminal:
    export EXCEPTIONDRIVE_SERVER={url}
    export EXCEPTIONDRIVE_TOKEN=$({server} create-organizer me{data_option})
    {client} organizer teams create my-team "My team" --with-token
    export EXCEPTIONDRIVE_TOKEN=edk_...                               # the team's, as printed
    {client} submit FILE --phase sample --method "My planner" --wait
  Logs: {logs}
"""


def banner(data: Path, address: Address) -> str:
    """Return the address and the first steps."""
    is_default = data.resolve() == Path("data").resolve()
    return _BANNER.format(
        url=address.url,
        data=data,
        logs=data / "logs",
        server=_command("exceptiondrive-server"),
        client=_command("exceptiondrive"),
        data_option="" if is_default else f" --data {shlex.quote(str(data))}",
    )


def _command(name: str) -> str:
    """Return how a reader may type the command from here."""
    path = Path(sys.executable).parent / name
    if not path.is_file():
        return name
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
