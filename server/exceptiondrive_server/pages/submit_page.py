"""The quick start: commands that work, the file format with its example, the open phases."""

from dataclasses import dataclass

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.published import example_text
from exceptiondrive_server.pages.page_parts import PhaseLink

RECORDER = """\
from recorder import Recorder  # one file, standard library only

with Recorder("planner.json.gz", split="{split}") as recorder:
    for sample_id, source, edited in samples:
        recorder.add(sample_id, source=plan(source), edited=plan(edited))
"""


@dataclass(frozen=True)
class FileFormat:
    """A submission file: its challenge, schema name and example."""

    name: str
    title: str
    file_schema: str
    example: str


@dataclass(frozen=True)
class SubmitPage:
    """Everything that `submit.html` needs."""

    phases: tuple[PhaseLink, ...]
    phase: PhaseLink | None
    protocol: Protocol
    formats: tuple[FileFormat, ...]
    recorder: str
    server: str
    development: PhaseLink | None


def submit_page(phases: tuple[PhaseLink, ...], protocol: Protocol, server: str) -> SubmitPage:
    """Set the quick start for the first phase that is open."""
    phase = next((phase for phase in phases if phase.is_open), None)
    return SubmitPage(
        phases=phases,
        phase=phase,
        protocol=protocol,
        formats=tuple(
            FileFormat(key.value, c.title, c.file_schema, example_text(key.value))
            for key, c in CHALLENGES.items()
        ),
        recorder=RECORDER.format(split=phase.split if phase else "sample"),
        server=server,
        development=next((phase for phase in phases if phase.split_is_public), None),
    )
