"""`remind` and `decide` as functions: settings and paths in, files and a report out.

Every unfinished sample is asked once, several at a time, and each outcome is journalled.
"""

import asyncio
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exceptiondrive.checking import write_file
from exceptiondrive.cli.output import say
from exceptiondrive.inputs import given_manifest, require_name
from exceptiondrive_agent.errors import AgentError, as_client_errors
from exceptiondrive_agent.journal import MAX_RAW_CHARACTERS, Journal, JournalLine, read_journal
from exceptiondrive_agent.questions import Question, decide_question, messages, remind_question
from exceptiondrive_agent.report import Prices, RunReport, run_report
from exceptiondrive_endpoints.asking import ask_all, progress_bar
from exceptiondrive_endpoints.endpoint import Endpoint, EndpointSettings, Message, ModelSettings
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_endpoints.images import load_images
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission_files import (
    ReminderRecord,
    StrategyPrediction,
    StrategySubmission,
)
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy

_SUFFIXES = frozenset({".jpg", ".jpeg", ".png"})
ImagePaths = Mapping[str, tuple[Path, ...]]


def strategy_submission(
    manifest: Manifest,
    strategies: Mapping[str, Strategy],
    reminders: Mapping[str, ReminderRecord],
) -> StrategySubmission:
    """Build the submission in the manifest's order; samples without a strategy become null."""
    return StrategySubmission(
        schema_="exceptiondrive.strategy/1",
        split=manifest.name,
        predictions=tuple(
            _prediction(sample_id, strategies.get(sample_id), reminders.get(sample_id))
            for sample_id in manifest.sample_ids
        ),
    )


def _prediction(
    sample_id: str, strategy: Strategy | None, reminder: ReminderRecord | None
) -> StrategyPrediction:
    if reminder is None:
        return StrategyPrediction(sample_id=sample_id, strategy=strategy)
    return StrategyPrediction(sample_id=sample_id, strategy=strategy, reminder=reminder)


def write_submission(submission: StrategySubmission, path: Path) -> None:
    """Write the file in one step: a reader sees the old file or the new one.

    Raises:
        InvalidArgumentError: The file cannot be written.
    """
    with suppress(OSError):  # whatever is wrong, writing says it
        path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, submission.model_dump_json(by_alias=True, exclude_unset=True, indent=1) + "\n")


def find_images(source: Path) -> ImagePaths:
    """Return the image paths of every sample, in the order in which they are sent.

    Args:
        source: A folder with one folder per sample, named by the sample id (images in order of
            file name), or a JSON file `{sample_id: [path, ...]}` with paths relative to itself.

    Raises:
        AgentError: There is no such folder or file, it holds no sample, or it is not that JSON.
    """
    if os.path.isdir(source):
        found = {
            sample.name: tuple(
                path for path in _visible_files(sample) if path.suffix.lower() in _SUFFIXES
            )
            for sample in _visible_files(source)
            if sample.is_dir()
        }
    elif os.path.isfile(source):
        found = _images_of_json(source)
    else:
        raise AgentError(f"{source}: no such folder or file")
    if not found:
        raise AgentError(f"{source}: no sample in it; expected {source}/<sample_id>/*.jpg or *.png")
    return found


def _visible_files(folder: Path) -> list[Path]:
    """What a folder holds, by name, but the files that systems hide there, such as `._1.jpg`."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _images_of_json(file: Path) -> dict[str, tuple[Path, ...]]:
    wanted = f"{file}: expected JSON of the form {{sample_id: [path, ...]}}"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AgentError(f"{wanted}: {error}") from None
    if not isinstance(document, dict):
        raise AgentError(wanted)
    for sample_id, paths in document.items():
        if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
            raise AgentError(f"{wanted}; sample {sample_id!r} has no list of paths")
    return {
        sample_id: tuple(file.parent / path for path in paths)
        for sample_id, paths in document.items()
    }


async def ask_sample(
    sample_id: str, question: Question, images: ImagePaths, endpoint: Endpoint
) -> JournalLine:
    """Ask one sample; whatever keeps it from an answer becomes the line's reason."""
    known: dict[str, Any] = {
        "sample_id": sample_id,
        "given_reminder_digest": question.given_reminder_digest(sample_id),
    }
    try:
        request = await asyncio.to_thread(_request, sample_id, question, images)
        completion, dialect = await endpoint.complete(request, question.name, question.schema)
        known |= {"model": completion.model, "form": dialect.form.value}
        if completion.usage is not None:
            known |= completion.usage.model_dump()
        return JournalLine(**known, **question.read(completion.text))
    except NoAnswerError as error:
        raw = None if error.raw is None else error.raw[:MAX_RAW_CHARACTERS]
        return JournalLine(**known, reason=error.reason, detail=error.detail, raw=raw)


def _request(sample_id: str, question: Question, images: ImagePaths) -> list[Message]:
    loaded = load_images(images.get(sample_id, ()))
    if question.views and len(question.views) != len(loaded):
        named, there = counted(len(question.views), "view"), counted(len(loaded), "image")
        detail = f"--views names {named}, the sample has {there}"
        raise NoAnswerError(Reason.WRONG_IMAGE_COUNT, detail)
    reminder = question.reminders.get(sample_id)
    return messages(question.instructions, loaded, question.views, reminder)


@dataclass(frozen=True)
class RunSettings:
    """What both questions share."""

    protocol: ProtocolDocument
    endpoint: EndpointSettings
    model: ModelSettings
    concurrency: int = 4
    views: tuple[str, ...] = ()
    limit: int | None = None
    prices: Prices | None = None


def remind(images: Path, out: Path, settings: RunSettings, manifest: Path | None) -> RunReport:
    """Write one reminder record per sample to the journal `out`, where it has none yet.

    With a manifest these samples alone are asked for, else all that have images.

    Raises:
        AgentError: A file is not what it must be, or the endpoint refuses the run.
    """
    require_name(out)
    found = find_images(images)
    sample_ids = given_manifest(manifest).sample_ids if manifest else tuple(found)
    _check_that_any_has_images(sample_ids, found)
    question = remind_question(settings.protocol.taxonomy, settings.views)
    header = question.header(settings.model)
    with Journal(out, header) as journal:
        return _run(question, sample_ids, found, journal, settings, out)


def decide(
    images: Path,
    manifest_path: Path,
    out: Path,
    settings: RunSettings,
    *,
    journal_path: Path | None = None,
    reminders_path: Path | None = None,
    attach_reminders: bool = False,
) -> RunReport:
    """Write a strategy submission for every sample of the manifest.

    Args:
        images: Folder or JSON file of `find_images`.
        manifest_path: The split's public manifest.
        out: The submission file.
        settings: Endpoint, model, protocol and limits.
        journal_path: Journal of the decisions; by default next to `out`.
        reminders_path: Journal of `remind`; without it the baseline is asked.
        attach_reminders: Put the reminder records into the submission.

    Raises:
        AgentError: A file is not what it must be, or the endpoint refuses the run.
    """
    if attach_reminders and reminders_path is None:
        raise AgentError("--attach-reminders needs --reminders")
    require_name(out)
    manifest = given_manifest(manifest_path)
    found = find_images(images)
    _check_that_any_has_images(manifest.sample_ids, found)
    taxonomy = settings.protocol.taxonomy
    reminders = read_reminders(reminders_path, manifest, taxonomy) if reminders_path else {}
    question = decide_question(reminders, taxonomy, settings.views)
    header = question.header(settings.model, with_reminders=reminders_path is not None)
    with Journal(journal_path or out.with_name(f"{out.name}.journal.jsonl"), header) as journal:
        try:
            return _run(question, manifest.sample_ids, found, journal, settings, out)
        finally:  # a run that stops early has paid for what there is
            if journal.lines:
                strategies = {
                    key: line.strategy
                    for key, line in answers(journal.lines, question).items()
                    if line.strategy is not None
                }
                attached = reminders if attach_reminders else {}
                write_submission(strategy_submission(manifest, strategies, attached), out)


def read_reminders(path: Path, manifest: Manifest, taxonomy: Taxonomy) -> dict[str, ReminderRecord]:
    """Return the reminder records in a journal of `remind`, for samples of the manifest.

    Raises:
        AgentError: The file is no such journal, none of its records is of these samples, or one
            names a hazard type that this taxonomy does not know.
    """
    header, lines = read_journal(path)
    if header.question != "remind":
        raise AgentError(f"{path}: holds decisions; --reminders takes the file of `remind`")
    records = {line.sample_id: line.reminder for line in lines if line.reminder is not None}
    wanted = {key: records[key] for key in manifest.sample_ids if key in records}
    if not wanted:
        raise AgentError(f"{path}: no reminder record for any sample of the manifest")
    named = {record.hazard_type for record in wanted.values()} - {None}
    unknown = sorted(str(key) for key in named - {task.id for task in taxonomy.tasks})
    if unknown:
        raise AgentError(
            f"{path}: hazard types that this protocol does not know: {', '.join(unknown)}; "
            "use the --protocol with which the reminders were made"
        )
    return wanted


def answers(lines: Sequence[JournalLine], question: Question) -> dict[str, JournalLine]:
    """The lines that answer the question as it would be asked now, the last of every sample."""
    return {line.sample_id: line for line in lines if question.is_finished(line)}


def _run(
    question: Question,
    sample_ids: Sequence[str],
    images: ImagePaths,
    journal: Journal,
    settings: RunSettings,
    out: Path,
) -> RunReport:
    finished = answers(journal.lines, question)
    asked = {line.sample_id for line in journal.lines}
    open_ids = sorted((key for key in sample_ids if key not in finished), key=asked.__contains__)
    n_before = len(journal.lines)
    with as_client_errors():
        endpoint = Endpoint(settings.endpoint, settings.model)

    def report() -> RunReport:
        return run_report(
            journal.lines[n_before:],
            samples=len(sample_ids),
            answered=len(answers(journal.lines, question).keys() & set(sample_ids)),
            requests=endpoint.n_requests,
            model=settings.model.model,
            prices=settings.prices,
            out=str(out),
        )

    asking = _ask(question, open_ids[: settings.limit], images, journal, settings, endpoint)
    try:
        with as_client_errors():
            asyncio.run(asking)
    except BaseException:
        if journal.lines:
            say(report().text)
        raise
    return report()


async def _ask(
    question: Question,
    sample_ids: Sequence[str],
    images: ImagePaths,
    journal: Journal,
    settings: RunSettings,
    endpoint: Endpoint,
) -> None:
    async with endpoint:

        async def ask(sample_id: str) -> JournalLine:
            return await ask_sample(sample_id, question, images, endpoint)

        with progress_bar(question.name, len(sample_ids)) as advance:

            def take(line: JournalLine) -> None:
                journal.append(line)
                advance(line)

            has_answered = any(line.is_done for line in journal.lines)
            await ask_all(sample_ids, ask, take, settings.concurrency, has_answered=has_answered)


def _check_that_any_has_images(sample_ids: Sequence[str], found: ImagePaths) -> None:
    if not any(found.get(sample_id) for sample_id in sample_ids):
        raise AgentError(
            "no sample has images: the folder names (or the keys of the JSON file) must be the "
            "sample ids of the manifest"
        )
