"""`exceptiondrive remind` and `exceptiondrive decide`.

Imports nothing heavy: openai and the agent itself are loaded when a command runs.
"""

import importlib
import os
from collections.abc import Callable
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show_json
from exceptiondrive.errors import NetworkError, extra_missing
from exceptiondrive.inputs import require_unread
from exceptiondrive_agent.errors import AgentError
from exceptiondrive_endpoints.errors import GO_ON
from exceptiondrive_schemas.printable import counted

if TYPE_CHECKING:
    from exceptiondrive_agent.report import RunReport
    from exceptiondrive_agent.run import RunSettings

NO_IMAGES = "no_images"
LAYOUT = "Put them under IMAGES/<sample_id>/ as .jpg or .png, or name them in the JSON file."
Images = Annotated[
    Path,
    typer.Argument(
        help="IMAGES/<sample_id>/*.jpg|png, or a JSON object from sample id to list of paths."
    ),
]
BaseUrl = Annotated[
    str,
    typer.Option(
        help="OpenAI-compatible endpoint, such as http://localhost:8000/v1. The key comes "
        "from EXCEPTIONDRIVE_AGENT_KEY or OPENAI_API_KEY."
    ),
]
Model = Annotated[str, typer.Option(help="The endpoint's name of the model.")]


def _shared_options(
    protocol: Annotated[
        Path | None,
        typer.Option(help="Protocol (TOML) with the taxonomy; by default the one that ships."),
    ] = None,
    views: Annotated[
        str | None,
        typer.Option(
            help='Names of the views in image order, such as "front left,front,front right".'
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Ask at most this many samples, to try it out.")
    ] = None,
    concurrency: Annotated[int, typer.Option(min=1, max=256, help="Samples in flight.")] = 4,
    requests_per_minute: Annotated[
        float | None, typer.Option(min=0.01, help="Upper bound, retries included.")
    ] = None,
    timeout_s: Annotated[
        float,
        typer.Option(
            min=0.1, help="Seconds without a byte; a whole answer may take ten times as long."
        ),
    ] = 120.0,
    max_retries: Annotated[
        int, typer.Option(min=0, max=100, help="After 429, 5xx and timeouts, with back-off.")
    ] = 5,
    temperature: Annotated[float, typer.Option(min=0, max=2)] = 0.0,
    max_tokens: Annotated[
        int, typer.Option(min=1, help="Longest answer; a longer one is null.")
    ] = 1000,
    extra_body: Annotated[
        str | None, typer.Option(help='More request fields as JSON, such as {"seed": 1}.')
    ] = None,
    price_in: Annotated[
        float | None, typer.Option(min=0, help="Price of a million prompt tokens.")
    ] = None,
    price_out: Annotated[
        float | None, typer.Option(min=0, help="Price of a million answer tokens.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Hold the options that both commands have after their own."""


def _run_command(ask: "Callable[..., RunReport]") -> Callable[..., None]:
    """Return a command with the options of `_shared_options` besides, that shows the report of a run.

    It fails when samples could not be asked, or none has an answer.
    """

    @wraps(ask)
    def command(json: bool, **given: Any) -> None:
        try:
            importlib.import_module("openai")
        except ImportError:
            raise extra_missing("remind and decide need openai.", "agent") from None
        try:
            report = ask(**given)
        except KeyboardInterrupt:
            say(f"\nInterrupted. {GO_ON}")
            raise
        if json:
            show_json(report)
        else:
            typer.echo(report.text)
        if report.unreachable:
            said = f"{counted(report.unreachable, 'sample')} could not be asked: {report.failure}."
            say(f"{said} If --base-url is right, run the same command again.")
            raise typer.Exit(NetworkError.exit_code)
        if (without := report.failed.get(NO_IMAGES)) is not None:
            say(f"No image was found for {without:,} of {report.samples:,} samples. {LAYOUT}")
        if report.asked and not report.answered:
            say(f"No sample has an answer: {report.failure}.")
            raise typer.Exit(AgentError.exit_code)

    *own, _ = signature(ask).parameters.values()
    return options.with_parameters(command, [*own, *signature(_shared_options).parameters.values()])


@_run_command
def remind(
    images: Images,
    out: Annotated[Path, typer.Option(help="Journal of the reminder records.")],
    base_url: BaseUrl,
    model: Model,
    manifest: Annotated[
        Path | None, typer.Option(help="Ask for the samples of this manifest only.")
    ] = None,
    **asking: Any,
) -> "RunReport":
    """Write a risk reminder per sample: images and the public taxonomy in, a record out.

    Finished samples are skipped, so the same command continues after an interruption and asks failed
    samples again. What cannot be read or validated is null, with the reason in the journal.
    """
    from exceptiondrive_agent import run

    return run.remind(images, out, _settings(base_url, model, asking), manifest)


@_run_command
def decide(
    images: Images,
    manifest: Annotated[Path, typer.Option(help="The split's public manifest.")],
    out: Annotated[Path, typer.Option(help="The submission file.")],
    base_url: BaseUrl,
    model: Model,
    reminders: Annotated[
        Path | None, typer.Option(help="Journal of `remind`; without it, the baseline runs.")
    ] = None,
    attach_reminders: Annotated[
        bool, typer.Option("--attach-reminders", help="Put the records into the file.")
    ] = False,
    journal: Annotated[
        Path | None, typer.Option(help="Journal; by default OUT.journal.jsonl.")
    ] = None,
    **asking: Any,
) -> "RunReport":
    """Choose a strategy per sample, with or without reminders, and write a strategy submission.

    Both settings send the same images and the same instructions; the reminder is one more text.
    Samples without a valid answer are null. The same command continues after an interruption.
    """
    from exceptiondrive_agent import run

    require_unread(out, images, manifest, reminders, journal, asking["protocol"])
    return run.decide(
        images,
        manifest,
        out,
        _settings(base_url, model, asking),
        journal_path=journal,
        reminders_path=reminders,
        attach_reminders=attach_reminders,
    )


def _settings(base_url: str, model: str, asking: dict[str, Any]) -> "RunSettings":
    from exceptiondrive_agent.settings import run_settings

    return run_settings({"base_url": base_url, "model": model, **asking}, os.environ)
