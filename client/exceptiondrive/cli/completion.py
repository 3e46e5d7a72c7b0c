"""Shell completion: phases, ids of submissions, teams and runs, choices.

Never an error and never a wait: whatever the server does not answer at once is not offered.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive.organizer import Organizer

LONGEST_WAIT_S = 1.0
Completion = tuple[str, str]
"""A word and what the shell says beside it."""
Offer = Callable[[typer.Context, str], list[Completion]]


def _completion_of(words: "Callable[[Client, Organizer], Iterable[Completion]]") -> Offer:
    """Return what offers words that a server says."""

    def offer(context: typer.Context, incomplete: str) -> list[Completion]:
        with suppress(Exception):  # whatever it is, it must not stand in somebody's command line
            from exceptiondrive.client import Client
            from exceptiondrive.organizer import Organizer

            server: Any = context.params.get("server")
            shortly: Any = {"attempts": 1, "timeout_s": LONGEST_WAIT_S}
            with Client(server, **shortly) as client, Organizer(server, **shortly) as organizer:
                return [word for word in words(client, organizer) if word[0].startswith(incomplete)]
        return []

    return offer


phases = _completion_of(lambda client, _: ((p.id, p.title) for p in client.phases()))
public_splits = _completion_of(
    lambda client, _: {p.split: p.split for p in client.phases() if p.split_is_public}.items()
)
submission_ids = _completion_of(
    lambda client, _: ((v.id, f"{v.method}, {v.status}") for v in client.submissions(limit=30))
)
teams = _completion_of(lambda _, own: ((team["id"], team["name"]) for team in own.teams()))
runs = _completion_of(
    lambda _, own: ((run.id, f"{run.phase}, {run.state}") for run in own.rescoring.runs())
)
"""Teams and runs, newest first, are offered to organizers."""


def choices(*words: str) -> Callable[[str], list[str]]:
    """Return what offers these words."""

    def offer(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return offer
