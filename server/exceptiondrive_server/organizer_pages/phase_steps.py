"""Actions on a phase, as data: a further one is one line more."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from exceptiondrive_records.phase_changes import freeze_phase, reveal_board, reveal_names
from exceptiondrive_records.rescoring.reveal import reveal_split
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.phase_settings import PhaseNow
from exceptiondrive_server.organizer_pages.forms import REASON
from exceptiondrive_server.organizer_pages.steps import Step


@dataclass(frozen=True)
class PhaseStep:
    """An action on a phase."""

    key: str
    title: str
    meaning: str
    take: Callable[..., Phase]
    command: str
    is_offered: Callable[[PhaseNow], bool]
    is_grave: bool = False


PHASE_STEPS: Mapping[str, PhaseStep] = MappingProxyType(
    {
        step.key: step
        for step in (
            PhaseStep(
                "freeze",
                "Freeze the board",
                "The public board stays as it is from now on, until you reveal it. Scoring goes "
                "on behind it.",
                freeze_phase,
                'freeze {} --reason "…"',
                lambda now: now.frozen_since is None,
            ),
            PhaseStep(
                "reveal-board",
                "Reveal the board",
                "The freeze ends: readers see the newest board at once.",
                reveal_board,
                'reveal {} --what board --reason "…"',
                lambda now: now.frozen_since is not None,
                is_grave=True,
            ),
            PhaseStep(
                "reveal-names",
                "Reveal the names",
                "From the next board on teams and methods stand under their names. This cannot "
                "be taken back.",
                reveal_names,
                'reveal {} --what names --reason "…"',
                lambda now: now.is_anonymous,
                is_grave=True,
            ),
            PhaseStep(
                "reveal-split",
                "Reveal the other part",
                "Workers score the part of the split that the phase reveals; the board changes "
                "when the run that this begins is applied.",
                reveal_split,
                'reveal {} --what split --reason "…"',
                lambda now: now.part == "public",
                is_grave=True,
            ),
        )
    }
)


def page_of_phase_step(step: PhaseStep, phase_id: str, title: str) -> Step:
    """Return the page that asks for an action."""
    return Step(
        section="phases",
        title=step.title,
        meaning=step.meaning,
        button=step.title,
        back=f"/organize/phases/{phase_id}",
        back_words="The phase",
        fields=(REASON,),
        facts=(("Phase", title),),
        command=f"exceptiondrive organizer phases {step.command.format(phase_id)}",
        is_grave=step.is_grave,
    )
