"""Which processes the embedded default is made of, and what each may know."""

import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_server.launcher.child import ChildPlan
from exceptiondrive_server.launcher.errors import LaunchError
from exceptiondrive_server.launcher.layout import Layout


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
            "install everything with: pip install 'exceptiondrive[server,worker,embedded]'"
        )
    return found


def shared_environment(layout: Layout, address: Address, broker_url: str) -> dict[str, str]:
    """Return what every process is told."""
    given = os.environ
    return {
        **given,
        **layout.environment(given),
        "EXCEPTIONDRIVE_BROKER_URL": broker_url,
        "EXCEPTIONDRIVE_PUBLIC_URL": given.get("EXCEPTIONDRIVE_PUBLIC_URL", address.url),
        "PYTHONUNBUFFERED": "1",
    }


def worker_environment(layout: Layout, shared: Mapping[str, str]) -> dict[str, str]:
    """Return what the worker alone is told besides: where its private store is."""
    private = str(layout.private.resolve())
    return {"EXCEPTIONDRIVE_PRIVATE_DIR": private, **shared}


def broker_plan(layout: Layout, command: list[str]) -> ChildPlan:
    """Return the plan of the private broker; it needs none of our settings."""
    environment = {"PATH": os.environ.get("PATH", "")}
    return ChildPlan("broker", command, environment, layout.logs / "broker.log")


def service_plans(
    layout: Layout, address: Address, shared: Mapping[str, str]
) -> tuple[ChildPlan, ...]:
    """Return the plans of API, reconciler and worker."""
    server = find_command("exceptiondrive-server")
    worker = find_command("exceptiondrive-worker")
    serve = [server, "serve", "--host", address.host, "--port", str(address.port)]
    return (
        ChildPlan("server", serve, shared, layout.logs / "server.log"),
        ChildPlan("reconciler", [server, "reconcile"], shared, layout.logs / "reconciler.log"),
        ChildPlan(
            "worker",
            [worker, "run"],
            worker_environment(layout, shared),
            layout.logs / "worker.log",
        ),
    )
