"""Write the strategy submission: every sample of the manifest, null where there is no answer."""

import os
from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive.agent.errors import AgentError
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.strategy import ReminderRecord, StrategyPrediction, StrategySubmission
from exceptiondrive_schemas.taxonomy import Strategy


def read_manifest(path: Path) -> Manifest:
    """Read a split's public manifest.

    Raises:
        AgentError: There is no such file, or it is no manifest.
    """
    try:
        return Manifest.read(path.read_bytes())
    except OSError as error:
        raise AgentError(f"{path}: {error.strerror}") from None
    except ValidationError:
        raise AgentError(
            f"{path}: not a manifest; download it from /api/v1/phases/<phase>/manifest"
        ) from None


def strategy_submission(
    manifest: Manifest,
    strategies: Mapping[str, Strategy],
    reminders: Mapping[str, ReminderRecord],
) -> StrategySubmission:
    """Build the submission in the manifest's order.

    Args:
        manifest: Names the split and its samples.
        strategies: Answers by sample; samples that are not in it become null.
        reminders: Records to attach; empty attaches none.
    """
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
        AgentError: The file cannot be written.
    """
    text = submission.model_dump_json(by_alias=True, exclude_unset=True, indent=1)
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise AgentError(f"{path}: {error.strerror}") from None
