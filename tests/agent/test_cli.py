import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.agent.bench import invoke

if TYPE_CHECKING:
    from tests.agent.bench import Bench
    from tests.support.chat_endpoint import ChatEndpoint


def python(program: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )


def test_mounting_the_commands_loads_neither_openai_nor_the_agent() -> None:
    result = python(
        "import sys; from typer.main import get_command; from exceptiondrive.cli import app;"
        "made = [get_command(app).get_command(None, name).name for name in ('remind', 'decide')];"
        "print(made, [m for m in sys.modules if m in ('openai', 'exceptiondrive_agent.run')])"
    )
    assert result.stdout == "['remind', 'decide'] []\n", result.stderr


def test_without_the_extra_the_error_says_what_to_install() -> None:
    result = python(
        "import sys; sys.modules['openai'] = None;"
        "from exceptiondrive.cli import app;"
        "sys.argv = 'x remind images --out o --base-url http://127.0.0.1:1 --model m'.split();"
        "app()"
    )
    assert result.returncode == 2
    assert 'pip install "exceptiondrive[agent]"' in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("command", ["remind", "decide"])
def test_no_option_takes_a_key(command: str) -> None:
    text = invoke([command, "--help"]).stdout.lower()
    assert "--base-url" in text
    assert "--key" not in text
    assert "--api-key" not in text
    assert "--token" not in text


def test_the_report_goes_to_stdout_and_no_bar_is_drawn_without_a_terminal(
    bench: "Bench", endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(2)
    endpoint.answer = lambda seen: endpoint.says("C")
    result = bench.run("decide", "--price-in", "1", "--price-out", "2")
    assert result.stderr == ""
    assert "answer 2" in result.stdout
    assert "tokens       2000 in, 100 out" in result.stdout
    assert "cost         0.0022" in result.stdout


def test_the_key_is_sent_as_a_bearer_token_and_written_nowhere(
    bench: "Bench", endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    key = "key-of-the-tests-0123456789"
    endpoint.answer = lambda seen: endpoint.says("C")
    result = bench.run("decide")
    assert f"Bearer {key}".encode() in endpoint.seen[0].head
    written = [path.read_bytes() for path in bench.folder.rglob("*") if path.is_file()]
    assert not any(key.encode() in data for data in written)
    assert key not in result.output
