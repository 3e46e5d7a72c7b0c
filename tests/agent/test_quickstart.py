"""The commands of docs/strategy-quickstart.md, run by a shell as they stand there."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.agent.bench import Bench
    from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen

PAGE = Path(__file__).parents[2] / "docs" / "strategy-quickstart.md"
LOCAL = ("remind", "decide", "check")
PROGRAM = """#!/bin/sh
exec {python} -m exceptiondrive "$@"
"""


def local_blocks() -> list[str]:
    """Shell blocks of the page that need no leaderboard."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [block for block in blocks if block.split()[0:2][-1] in LOCAL]


@pytest.fixture
def shell(bench: "Bench", endpoint: "ChatEndpoint", tmp_path: Path) -> dict[str, str]:
    """An environment in which `exceptiondrive` is this checkout's."""
    program = tmp_path / "bin" / "exceptiondrive"
    program.parent.mkdir()
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o755)
    path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
    return os.environ | {"PATH": path, "MODEL_URL": endpoint.base_url, "MODEL": "tested-model"}


def test_the_page_leads_to_two_submissions_that_the_checker_accepts(
    bench: "Bench", endpoint: "ChatEndpoint", shell: dict[str, str], record: dict[str, Any]
) -> None:
    def answer(seen: "Seen") -> "Reply":
        is_reminder = "risk reminder" in seen.texts[0]
        return endpoint.says(json.dumps(record if is_reminder else {"strategy": "C"}))

    endpoint.answer = answer
    bench.add_samples(3)
    assert len(local_blocks()) == 3
    for block in local_blocks():
        result = subprocess.run(
            ["sh", "-e", "-c", block],
            cwd=bench.folder,
            env=shell,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert result.returncode == 0, f"{block}\n{result.stdout}\n{result.stderr}"
    baseline, reminded = (
        json.loads((bench.folder / name).read_text()) for name in ("baseline.json", "reminded.json")
    )
    assert [p["strategy"] for p in baseline["predictions"]] == ["C"] * 3
    assert [p["reminder"] for p in reminded["predictions"]] == [record] * 3
    assert len(endpoint.seen) == 9
