"""The quick start: commands that work, the file format with its example, the open phases."""

from dataclasses import dataclass

from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text
from exceptiondrive_server.web.page_parts import PhaseLink


@dataclass(frozen=True)
class FileFormat:
    """A submission file: its challenge, schema name and example."""

    name: str
    title: str
    file_schema: str
    example: str


@dataclass(frozen=True)
class ChallengeLink:
    """The quick start of another challenge, for the first of its phases that is open."""

    title: str
    url: str
    is_current: bool


@dataclass(frozen=True)
class SubmitPage:
    """Everything that `submit.html` needs."""

    phases: tuple[PhaseLink, ...]
    phase: PhaseLink | None
    asked: PhaseLink | None
    """The phase that the address names, where nothing can be submitted to it now."""
    challenge: Challenge
    challenges: tuple[ChallengeLink, ...]
    protocol: Protocol
    file_note: str
    formats: tuple[FileFormat, ...]
    recorder: str
    server: str
    development: PhaseLink | None


def submit_page(
    phases: tuple[PhaseLink, ...], protocol: Protocol, server: str, wanted: str | None = None
) -> SubmitPage:
    """Set the quick start for a phase: the one named, if it takes files, else the first open one."""
    phase = _chosen(phases, wanted)
    challenge = phase.challenge if phase else next(iter(CHALLENGES.values()))
    words = challenge.words
    return SubmitPage(
        phases=phases,
        phase=phase,
        asked=next((each for each in phases if each.id == wanted and each is not phase), None),
        challenge=challenge,
        challenges=_challenge_links(phases, challenge),
        protocol=protocol,
        file_note=words.file_note.format(waypoints=protocol.geometry.waypoints),
        formats=tuple(
            FileFormat(key, c.title, c.file_schema, example_text(key))
            for key, c in CHALLENGES.items()
            if key in DOCUMENT_NAMES
        ),
        recorder=words.code.loop.format(
            file=words.code.file, split=phase.split if phase else "sample"
        ),
        server=server,
        development=_development(phases, phase),
    )


def _chosen(phases: tuple[PhaseLink, ...], wanted: str | None) -> PhaseLink | None:
    is_open = [phase for phase in phases if phase.is_open]
    takes_files = [phase for phase in phases if phase.is_open or phase.takes_late]
    named = [phase for phase in takes_files if phase.id == wanted]
    return next(iter(named + is_open), None)


def _development(phases: tuple[PhaseLink, ...], chosen: PhaseLink | None) -> PhaseLink | None:
    """A phase with a public split; of the chosen phase's challenge where there is one."""
    public = [phase for phase in phases if phase.split_is_public]
    same = [phase for phase in public if chosen and phase.challenge == chosen.challenge]
    return next(iter(same + public), None)


def _challenge_links(
    phases: tuple[PhaseLink, ...], current: Challenge
) -> tuple[ChallengeLink, ...]:
    """One link per challenge that has an open phase; none where there is no choice."""
    first = {phase.challenge.id: phase for phase in reversed(phases) if phase.is_open}
    if len(first) < 2:
        return ()
    return tuple(
        ChallengeLink(challenge.title, f"/submit?phase={first[key].id}", key == current.id)
        for key, challenge in CHALLENGES.items()
        if key in first
    )
