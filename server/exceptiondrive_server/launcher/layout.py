"""The embedded default: its folders, its processes, and the instructions that it prints."""

import fcntl
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_records.db.settings import PREFIX, folder_settings
from exceptiondrive_server.launcher.broker import broker_url, is_short_enough
from exceptiondrive_server.launcher.child import ChildPlan, LaunchError

_PRIVATE_DIR = f"{PREFIX}PRIVATE_DIR"


@dataclass(frozen=True)
class Layout:
    """The folders under DATA."""

    data: Path

    @property
    def logs(self) -> Path:
        """One log per process."""
        return self.data / "logs"

    @property
    def private(self) -> Path:
        """What only the worker may read."""
        return Path(self._settings["private_dir"])

    @property
    def _settings(self) -> dict[str, str]:
        return folder_settings(self.data)

    @property
    def planners(self) -> Path:
        """Files of the synthetic planners."""
        return self.data / "sample" / "planners"

    def create(self) -> None:
        """Make the folders; none of them is for others to read."""
        try:
            self.data.mkdir(parents=True, exist_ok=True, mode=0o700)
            self.logs.mkdir(exist_ok=True, mode=0o700)
            (self.data / "uploads").mkdir(exist_ok=True, mode=0o700)
            self.private.mkdir(exist_ok=True, mode=0o700)
        except OSError as error:
            raise LaunchError(f"cannot use {self.data} as data folder: {error.strerror}") from None

    def environment(self, given: Mapping[str, str]) -> dict[str, str]:
        """Return the settings that follow from the layout; those given already go first."""
        names = {PREFIX + name.upper(): value for name, value in self._settings.items()}
        return {
            name: given.get(name, value) for name, value in names.items() if name != _PRIVATE_DIR
        }


@contextmanager
def data_lock(layout: Layout) -> Iterator[None]:
    """Hold DATA for one launcher; the kernel lets go of it, however the launcher ends.

    Raises:
        LaunchError: Another launcher has it.
    """
    with (layout.data / "launcher.lock").open("a+") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held.seek(0)
            owner = held.read().strip()
            by = f" (process {owner})" if owner else ""
            raise LaunchError(
                f"{layout.data} is in use by another `exceptiondrive-server run`{by}. "
                "Stop that one, or choose another folder with --data."
            ) from None
        held.truncate(0)
        held.write(str(os.getpid()))
        held.flush()
        yield


class BrokerFolder:
    """The 0700 folder of the private broker's socket: under DATA, or somewhere shorter."""

    def __init__(self, layout: Layout) -> None:
        wanted = layout.data.resolve() / "broker"
        self._is_temporary = not is_short_enough(wanted)
        self.path = Path(tempfile.mkdtemp(prefix="ed-")) if self._is_temporary else wanted
        with self._open_folder() as folder:
            os.fchmod(folder, 0o700)
        self.url = broker_url(self.path)

    def give_to(self, user: int) -> None:
        """Let another user run the broker; root reaches it all the same."""
        with self._open_folder() as folder:
            os.fchown(folder, user, user)

    @contextmanager
    def _open_folder(self) -> Iterator[int]:
        """The folder itself, made if need be: root gives nobody what a link in its place leads to."""
        try:
            self.path.mkdir(exist_ok=True)
            folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:
            raise LaunchError(
                f"{self.path} has to be a folder, and no link: look who made it, and remove it"
            ) from None
        try:
            yield folder
        finally:
            os.close(folder)

    def remove(self) -> None:
        """Remove a temporary folder."""
        if self._is_temporary:
            shutil.rmtree(self.path, ignore_errors=True)


@dataclass(frozen=True)
class Address:
    """Where the server listens."""

    host: str
    port: int

    @property
    def url(self) -> str:
        """What a reader types."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"


def find_command(name: str) -> str:
    """Return the path of one of our commands: beside this Python, else on PATH.

    Raises:
        LaunchError: It is not installed.
    """
    beside = Path(sys.executable).parent / name
    found = str(beside) if beside.is_file() else shutil.which(name)
    if found is None:
        raise LaunchError(
            f"the command {name} is not installed; "
            "install everything with: "
            "pip install 'exceptiondrive-server[server,embedded]' exceptiondrive-worker"
        )
    return found


def shared_environment(layout: Layout, address: Address, broker_url: str) -> dict[str, str]:
    """Return the environment of every process."""
    given = os.environ
    return {
        **given,
        **layout.environment(given),
        "EXCEPTIONDRIVE_BROKER_URL": broker_url,
        "EXCEPTIONDRIVE_PUBLIC_URL": given.get("EXCEPTIONDRIVE_PUBLIC_URL", address.url),
        "PYTHONUNBUFFERED": "1",
    }


def worker_environment(layout: Layout, shared: Mapping[str, str]) -> dict[str, str]:
    """Return the additional environment of the worker: where its private store is."""
    return {_PRIVATE_DIR: str(layout.private), **shared}


def broker_plan(layout: Layout, command: list[str], user: int | None) -> ChildPlan:
    """Return the plan of the private broker; it needs none of our settings."""
    environment = {"PATH": os.environ.get("PATH", "")}
    return ChildPlan("broker", command, environment, layout.logs / "broker.log", user)


def service_plans(
    layout: Layout, address: Address, shared: Mapping[str, str], server_user: int | None
) -> tuple[ChildPlan, ...]:
    """Return the plans of API, reconciler and worker; the first two may have a user of their own."""
    server = find_command("exceptiondrive-server")
    worker = find_command("exceptiondrive-worker")
    serve = [server, "serve", "--host", address.host, "--port", str(address.port)]
    return (
        ChildPlan("server", serve, shared, layout.logs / "server.log", server_user),
        ChildPlan(
            "reconciler", [server, "reconcile"], shared, layout.logs / "reconciler.log", server_user
        ),
        ChildPlan(
            "worker",
            [worker, "run"],
            worker_environment(layout, shared),
            layout.logs / "worker.log",
        ),
    )


_BANNER = """
  ExceptionDrive runs at {url}      (Ctrl-C ends it; all data stays in {data})

  To take part, in another terminal:
    export EXCEPTIONDRIVE_SERVER={url}
    export EXCEPTIONDRIVE_TOKEN=$({server} create-organizer me{data_option}){phase_steps}
    {client} organizer teams create my-team "My team" --with-token
    export EXCEPTIONDRIVE_TOKEN=edk_...                               # the team's, as printed
    {client} submit FILE --phase {phase} --method "My planner" --wait
  Logs: {logs}
"""
_PHASE_STEPS = """
    {splits}{worker} add-split SPLIT_FILE{data_option}               # there is no open phase yet
    {client} organizer phases create my-phase --title "My phase" --split NAME"""


def banner(data: Path, address: Address, phase: str | None) -> str:
    """Return the address and the first steps, with those to a phase where none takes files."""
    is_default = data.resolve() == Path("data").resolve()
    data_option = "" if is_default else f" --data {shlex.quote(str(data))}"
    splits_dir = os.environ.get("EXCEPTIONDRIVE_SPLITS_DIR")
    phase_steps = _PHASE_STEPS.format(
        splits=""
        if splits_dir is None
        else f"EXCEPTIONDRIVE_SPLITS_DIR={shlex.quote(splits_dir)} ",
        worker=_typed_command("exceptiondrive-worker"),
        client=_typed_command("exceptiondrive"),
        data_option=data_option,
    )
    return _BANNER.format(
        phase=phase or "my-phase",
        phase_steps="" if phase else phase_steps,
        url=address.url,
        data=data,
        logs=data / "logs",
        server=_typed_command("exceptiondrive-server"),
        client=_typed_command("exceptiondrive"),
        data_option=data_option,
    )


def _typed_command(name: str) -> str:
    """Return how a reader may type the command from here."""
    path = Path(sys.executable).parent / name
    if not path.is_file():
        return name
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
