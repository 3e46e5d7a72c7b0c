"""The life of a phase from the command line: show, change, freeze, reveal."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import show, show_json
from exceptiondrive.errors import InvalidArgumentError

if TYPE_CHECKING:
    from exceptiondrive.organizer import Organizer

LIFE = (
    "live_part",
    "revealed_part",
    "late_entries",
    "freezes_at",
    "frozen_scores",
    "families_from",
    "entries_shown",
    "anonymous",
    "entries_private",
)
"""The fields of `PhasePolicy`, named here so that `--help` needs no models; a test compares."""
PhaseArgument = Annotated[str, typer.Argument(metavar="ID", help="Id of the phase.")]
ReasonOption = Annotated[
    str, typer.Option("--reason", metavar="TEXT", help="Why; stays in the audit log.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A setting, any number of times; times as 2027-01-31T00:00:00Z, `none` takes one "
        "away. Settings of docs/phases.md: " + ", ".join(LIFE) + ".",
    ),
]
_NUMBERS = ("quota_per_day", "quota_total", "quota_concurrent", "rejected_per_day")
_FLAGS = ("shows_reported", "anonymous", "entries_private")
_TEXTS = ("title", "description", "opens_at", "closes_at")
KNOWN = (*_TEXTS, *_NUMBERS, "shows_reported", *LIFE)
WHAT = ("board", "names", "split")


def show_phase(
    phase_id: PhaseArgument, server: options.Server = None, json: options.Json = False
) -> None:
    """Show the settings of a phase and where it stands."""
    with _organizer(server) as organizer:
        phase = organizer.phase(phase_id)
    _show(phase, json)


def update(
    phase_id: PhaseArgument,
    settings: SetOption = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Change settings of a phase; what would take back a promise is refused."""
    if not settings:
        raise InvalidArgumentError("nothing_to_set", "Say what to change: --set NAME=VALUE.")
    with _organizer(server) as organizer:
        phase = organizer.change_phase(phase_id, settings_of(settings))
    _show(phase, json)


def freeze(
    phase_id: PhaseArgument,
    reason: ReasonOption,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Freeze the public board now; scoring goes on."""
    with _organizer(server) as organizer:
        phase = organizer.freeze_phase(phase_id, reason)
    _show(phase, json)


def reveal(
    phase_id: PhaseArgument,
    what: Annotated[
        str, typer.Option("--what", metavar="|".join(WHAT), help="What readers are to see.")
    ],
    reason: ReasonOption,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show the board behind a freeze, the names, or begin to score the other part of the split."""
    if what not in WHAT:
        raise InvalidArgumentError("wrong_what", f"--what is {', '.join(WHAT)}, not {what!r}.")
    with _organizer(server) as organizer:
        phase = organizer.reveal_phase(phase_id, what, reason)
    if what == "split" and not json:
        show(
            "Scoring has begun; nobody sees it. Go on with: organizer rescore status, preview "
            "and apply. The board changes when you apply."
        )
    _show(phase, json)


def settings_of(given: Sequence[str]) -> dict[str, Any]:
    """Return the document of `NAME=VALUE` settings.

    Raises:
        InvalidArgumentError: A name is unknown, or a value cannot be read.
    """
    document: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or name not in KNOWN:
            raise InvalidArgumentError(
                "unknown_setting", f"{text!r} is no setting; known: {', '.join(KNOWN)}."
            )
        target = document.setdefault("policy", {}) if name in LIFE else document
        target[name] = _value(name, value)
    return document


def _value(name: str, text: str) -> Any:
    if text == "none" and name not in (*_FLAGS, "title", "description"):
        return None
    if name in _FLAGS:
        if text not in ("true", "false"):
            raise InvalidArgumentError("wrong_value", f"{name} is true or false, not {text!r}.")
        return text == "true"
    if name in _NUMBERS:
        if not text.isdecimal():
            raise InvalidArgumentError("wrong_value", f"{name} is a number, not {text!r}.")
        return int(text)
    return text


def _organizer(server: str | None) -> "Organizer":
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.organizer import Organizer

    return Organizer(prepare(server))


def _show(phase: dict[str, Any], json: bool) -> None:
    if json:
        show_json(phase)
        return
    lines = {key: phase[key] for key in ("id", "title", *KNOWN) if key in phase}
    lines |= {**phase["policy"], **{f"now: {key}": value for key, value in phase["now"].items()}}
    width = max(len(key) for key in lines)
    show(*(f"{key:<{width}}  {_words(value)}" for key, value in lines.items()))


def _words(value: Any) -> str:
    return "-" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


COMMANDS: dict[str, Callable[..., None]] = {
    "show": show_phase,
    "update": update,
    "freeze": freeze,
    "reveal": reveal,
}
