"""`exceptiondrive remind` and `exceptiondrive decide`.

Imports nothing heavy: openai and the agent itself are loaded when a command runs.
"""

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show_json
from exceptiondrive.errors import NetworkError
from exceptiondrive_agent.errors import AgentError
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
ManifestFile = Annotated[Path, typer.Option("--manifest", help="The split's public manifest.")]
OptionalManifest = Annotated[
    Path | None, typer.Option("--manifest", help="Ask for the samples of this manifest only.")
]
ProtocolFile = Annotated[
    Path | None,
    typer.Option(
        "--protocol", help="Protocol (TOML) with the taxonomy; by default the one that ships."
    ),
]
Views = Annotated[
    str | None,
    typer.Option(help='Names of the views in image order, such as "front left,front,front right".'),
]
Limit = Annotated[
    int | None, typer.Option(min=1, help="Ask at most so many samples, to try it out.")
]
Concurrency = Annotated[int, typer.Option(min=1, max=256, help="Samples in flight.")]
RequestsPerMinute = Annotated[
    float | None, typer.Option(min=0.01, help="Upper bound, retries included.")
]
TimeoutS = Annotated[
    float,
    typer.Option(
        min=0.1, help="Seconds without a byte; a whole answer may take ten times as long."
    ),
]
MaxRetries = Annotated[
    int, typer.Option(min=0, max=100, help="After 429, 5xx and timeouts, with back-off.")
]
Temperature = Annotated[float, typer.Option(min=0, max=2)]
MaxTokens = Annotated[int, typer.Option(min=1, help="Longest answer; a longer one is null.")]
ExtraBody = Annotated[
    str | None, typer.Option(help='More request fields as JSON, such as {"seed": 1}.')
]
PriceIn = Annotated[float | None, typer.Option(min=0, help="Price of a million prompt tokens.")]
PriceOut = Annotated[float | None, typer.Option(min=0, help="Price of a million answer tokens.")]


def remind(
    images: Images,
    out: Annotated[Path, typer.Option(help="Journal of the reminder records.")],
    base_url: BaseUrl,
    model: Model,
    manifest: OptionalManifest = None,
    protocol: ProtocolFile = None,
    views: Views = None,
    limit: Limit = None,
    concurrency: Concurrency = 4,
    requests_per_minute: RequestsPerMinute = None,
    timeout_s: TimeoutS = 120.0,
    max_retries: MaxRetries = 5,
    temperature: Temperature = 0.0,
    max_tokens: MaxTokens = 1000,
    extra_body: ExtraBody = None,
    price_in: PriceIn = None,
    price_out: PriceOut = None,
    json: options.Json = False,
) -> None:
    """Write a risk reminder per sample: images and the public taxonomy in, a record out.

    Finished samples are skipped, so the same command goes on after an interruption and asks failed
    samples again. What cannot be read or validated is null, with the reason in the journal.
    """
    given = dict(locals())

    def work() -> "RunReport":
        from exceptiondrive_agent import run

        return run.remind(images, out, _settings(given), manifest)

    _command(work, json)


def decide(
    images: Images,
    manifest: ManifestFile,
    out: Annotated[Path, typer.Option(help="The submission file.")],
    base_url: BaseUrl,
    model: Model,
    reminders: Annotated[
        Path | None,
        typer.Option(help="Journal of `remind`; without it the baseline is asked."),
    ] = None,
    attach_reminders: Annotated[
        bool,
        typer.Option("--attach-reminders", help="Put the records into the file."),
    ] = False,
    journal: Annotated[
        Path | None,
        typer.Option(help="Journal; by default OUT.journal.jsonl."),
    ] = None,
    protocol: ProtocolFile = None,
    views: Views = None,
    limit: Limit = None,
    concurrency: Concurrency = 4,
    requests_per_minute: RequestsPerMinute = None,
    timeout_s: TimeoutS = 120.0,
    max_retries: MaxRetries = 5,
    temperature: Temperature = 0.0,
    max_tokens: MaxTokens = 1000,
    extra_body: ExtraBody = None,
    price_in: PriceIn = None,
    price_out: PriceOut = None,
    json: options.Json = False,
) -> None:
    """Choose a strategy per sample, with or without reminders, and write a strategy submission.

    Both settings send the same images and the same instructions; the reminder is one more text.
    Samples without a valid answer are null. The same command goes on after an interruption.
    """
    given = dict(locals())

    def work() -> "RunReport":
        from exceptiondrive_agent import run

        return run.decide(
            images,
            manifest,
            out,
            _settings(given),
            journal_path=journal,
            reminders_path=reminders,
            attach_reminders=attach_reminders,
        )

    _command(work, json)


def _command(work: "Callable[[], RunReport]", as_json: bool) -> None:
    """Run and print the report; fail when samples could not be asked, or none has an answer."""
    try:
        importlib.import_module("openai")
    except ImportError:
        advice = 'Install it: pip install "exceptiondrive[agent]"'
        raise AgentError("remind and decide need the extra `agent`.", advice) from None
    try:
        report = work()
    except KeyboardInterrupt:
        say("\nInterrupted. Answers so far are kept; run the same command to go on.")
        raise
    if as_json:
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


def _settings(given: dict[str, Any]) -> "RunSettings":
    from exceptiondrive_agent.settings import run_settings

    return run_settings(given, os.environ)
