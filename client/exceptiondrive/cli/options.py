"""Options that several commands share."""

import shlex
import sys
from collections.abc import Callable, Iterable
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any

import typer

from exceptiondrive.cli import completion
from exceptiondrive.cli.output import remember_json
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.inputs import STDIN, GivenFile, given_bytes


def option(
    name: str, metavar: str, words: str, offer: Callable[..., Any] | None = None, **bounds: Any
) -> Any:
    """Return an option with a value.

    Args:
        name: With its dashes.
        metavar: What stands for the value in `--help`.
        words: What `--help` says of it.
        offer: What the shell offers at a press of Tab.
        **bounds: `min` and `max` of a number.
    """
    return typer.Option(name, metavar=metavar, help=words, autocompletion=offer, **bounds)


def one_of(name: str, values: Iterable[object], words: str, metavar: str = "") -> Any:
    """Return an option that takes one of some values; its metavar shows them, unless one is given."""
    known = [*map(str, values)]
    return option(name, metavar or "|".join(known), words, offer=completion.choices(*known))


def text(name: str, words: str) -> Any:
    """Return an option whose text may stand in a file."""
    hint = f"{words} `@FILE` reads it from a file."
    return typer.Option(name, metavar="TEXT", help=hint, callback=from_file)


def from_file(said: str | None) -> str | None:
    """Return a text that was said, or what the file holds that it names as `@FILE`."""
    if said is None or not said.startswith("@") or "{" in said:  # BibTeX: `@misc{`
        return said
    return given_bytes(said[1:]).text()


def flag(name: str, words: str) -> Any:
    """Return an option that is said or not."""
    return typer.Option(name, help=words)


def output(words: str, metavar: str = "FILE") -> Any:
    """Return the option that says where to write."""
    return typer.Option("--output", "-o", metavar=metavar, help=words)


def argument(
    metavar: str, words: str, offer: Callable[..., Any] | None = None, **bounds: Any
) -> Any:
    """Return an argument; its parts are those of an `option`."""
    return typer.Argument(metavar=metavar, help=words, autocompletion=offer, **bounds)


def phase(words: str, metavar: str = "PHASE") -> Any:
    """Return the option that names a phase."""
    return option("--phase", metavar, words, offer=completion.phases)


def require_one_of(name: str, said: object, values: Iterable[object]) -> None:
    """Refuse what an option does not take; None: it was not given.

    Raises:
        InvalidArgumentError: It is none of the values; the sentence names them.
    """
    *first, last = known = [*map(str, values)]
    if said is not None and str(said) not in known:
        raise InvalidArgumentError(
            "wrong_option", f"{name} is {', '.join(first)} or {last}, not {said!r}."
        )


def with_parameters(
    command: Callable[..., None], parameters: Iterable[Parameter]
) -> Callable[..., None]:
    """Return a command that takes these parameters, whatever it takes by itself."""
    taken = Signature([*parameters])
    command.__signature__ = taken  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in taken.parameters.values()}
    return command


_USUAL_PHASE = "Id of the phase; else EXCEPTIONDRIVE_PHASE, else the one in `config`."
Json = Annotated[
    bool, typer.Option("--json", callback=remember_json, help="One JSON document on stdout.")
]
Yes = Annotated[bool, flag("--yes", "Do not ask.")]
Server = Annotated[
    str | None,
    option(
        "--server",
        "URL",
        "Server address; else EXCEPTIONDRIVE_SERVER, `config` or the last login.",
    ),
]
Output = Annotated[Path | None, output("Output file; else named after its content.")]


def given_file(file: Path, context: typer.Context | None = None) -> GivenFile:
    """Return what a file holds that was named, or stdin where it is `-`.

    Raises:
        InvalidArgumentError: It cannot be read, or is not the only one.
    """
    if context is not None and context.args:
        names = shlex.join([str(file), *context.args])
        raise InvalidArgumentError(
            "too_many_files",
            f"One file is one submission, and {len(context.args) + 1} were named.",
            f"Shards of one run become one: exceptiondrive convert {names} -o planning.json.gz",
        )
    if file == STDIN:
        return GivenFile("stdin", sys.stdin.buffer.read())
    return given_bytes(file)


File = Annotated[Path, argument("FILE", "Submission file, JSON or gzip of JSON; - is stdin.")]
ProtocolOption = Annotated[
    str | None, option("--protocol", "P", "Version that ships with the client, or a TOML file.")
]
Phase = Annotated[str | None, phase("Only of this phase.")]
DefaultPhase = Annotated[str | None, phase(_USUAL_PHASE)]
PhaseArgument = Annotated[str | None, argument("[PHASE]", _USUAL_PHASE, offer=completion.phases)]
SubmissionId = Annotated[
    str,
    argument(
        "ID", "Id of the submission, or the address of its page.", offer=completion.submission_ids
    ),
]
TeamId = Annotated[str, argument("TEAM", "Id of the team.", offer=completion.teams)]
PhaseId = Annotated[str, phase("Id of the phase.")]
Reason = Annotated[str, option("--reason", "TEXT", "Why; stays in the audit log.")]
ExpiresAt = Annotated[str | None, option("--expires-at", "TIME", "2027-01-31T00:00:00Z")]
FactsFile = Annotated[Path | None, option("--facts", "FILE", "JSON file of the method's facts.")]
Fact = Annotated[
    list[str] | None,
    option("--fact", "KEY=VALUE", "One fact, such as sensors=lidar,radar; may be repeated."),
]
