"""The commands of the quick start for one phase, ready to be pasted into a shell in order."""

from typing import NamedTuple

from exceptiondrive_schemas.challenges import CodeWords
from exceptiondrive_server.boards.page import PhaseLink
from exceptiondrive_server.guide.client_files import Wheel

ENVIRONMENT = "exceptiondrive-client"
_RECORDER_OF_CLIENT = (
    """cp "$(python -c 'import exceptiondrive.recorder as it; print(it.__file__)')" recorder.py"""
)


class QuickStart(NamedTuple):
    """Commands of each step; an empty step is left out."""

    install: str
    run: str
    check: str
    evaluate: str
    submit: str


def quick_start(
    server: str,
    phase: PhaseLink | None,
    development: PhaseLink | None,
    code: CodeWords,
    wheel: Wheel | None,
) -> QuickStart:
    """Return the commands.

    Args:
        server: What people type before a path.
        phase: Whose samples are answered; None where no phase takes files.
        development: A phase of the same challenge whose split is public: this one, or another.
        code: The program and the names of the challenge.
        wheel: Of the client, as the server offers it; None where it offers none.
    """
    phase_id = phase.id if phase else "PHASE"
    environment = f"python3 -m venv {ENVIRONMENT}\n. {ENVIRONMENT}/bin/activate\n"
    install = "" if wheel is None else environment + _pip(server, wheel, "")
    run = (
        f"exceptiondrive manifest {phase_id} -o manifest.json\n"
        f"{_RECORDER_OF_CLIENT if wheel is None else f'curl -fsSO {server}/client/recorder.py'}\n"
        f"cat > run.py <<'END'\n{code.program}END\n"
        f"python run.py manifest.json {code.file}\n"
    )
    submit = (
        f"exceptiondrive submit {code.file} --phase {phase_id} \\\n"
        f'    --method "{code.method}" --wait --allow-unranked\n'
    )
    return QuickStart(
        install=f"{install}exceptiondrive login --server {server}\n",
        run=run,
        check=f"exceptiondrive check {code.file} --manifest manifest.json\n",
        evaluate=_evaluate(server, phase, development, code, wheel),
        submit=submit if phase and phase.takes_files else "",
    )


def _evaluate(
    server: str,
    phase: PhaseLink | None,
    development: PhaseLink | None,
    code: CodeWords,
    wheel: Wheel | None,
) -> str:
    if development is None:
        return ""
    file, answer_it = code.file, ""
    if development is not phase:
        file = f"development-{code.file}"
        answer_it = (
            f"exceptiondrive manifest {development.id} -o development.json\n"
            f"python run.py development.json {file}\n"
        )
    return (
        f"{_pip(server, wheel, '[evaluate]')}"
        f"{answer_it}"
        f"exceptiondrive split download {development.split} -o split.json\n"
        f"exceptiondrive evaluate {file} --split split.json --phase {development.id}\n"
    )


def _pip(server: str, wheel: Wheel | None, extras: str) -> str:
    """Return the line for pip; none without a wheel: an index may give anybody's package of that name."""
    return (
        "" if wheel is None else f'pip install "exceptiondrive{extras} @ {server}{wheel.address}"\n'
    )
