"""docs/operating-bare.md, carried out: PostgreSQL, broker, nginx, servers and workers as their own users."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from tests.chaos.users import can_change_user, showing_python
from tests.deploy.nginx import find_nginx
from tests.support.distributions import build

ROOT = Path(__file__).parents[2]
_NET = ["unshare", "--net"]


@pytest.mark.slow
@pytest.mark.postgres
@pytest.mark.timeout(3000)
def test_the_page_is_walked_as_written() -> None:
    """Install, first entry, walls, one server stopped, upgrade, roll back, back up, restore."""
    find_nginx()
    may = can_change_user() and shutil.which("unshare") and shutil.which("ip")
    if not may or subprocess.run([*_NET, "true"], check=False, capture_output=True).returncode:
        pytest.skip("only root with networks of its own can walk it")
    client = Path(sys.prefix, "client")  # as the page's first block has it beside the programs
    client.mkdir(exist_ok=True)
    if not any(client.glob("*.whl")):
        build("client", client, "wheel")
    folder = Path(tempfile.mkdtemp(prefix="ed-bare-"))
    folder.chmod(0o755)
    command = showing_python(
        [*_NET, sys.executable, "-m", "tests.operating.bare_walk", str(folder)]
    )
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-6000:]
    finally:
        shutil.rmtree(folder)
