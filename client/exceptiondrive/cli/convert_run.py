"""The convert command: read, convert, write, check the outcome's form."""

from pathlib import Path
from typing import Any, cast, get_args

from exceptiondrive.cli.protocol_choice import chosen_protocol
from exceptiondrive.conversion import ConversionPlan, FollowedPoint
from exceptiondrive.conversion import convert as convert_pairs
from exceptiondrive.conversion_files import read_pairs, write_submission
from exceptiondrive.errors import InvalidArgumentError

MAX_OFFSET_M = 20.0


def converted(
    files: list[Path],
    output: Path,
    split: str | None,
    swap_axes: bool,
    origin_offset_m: float,
    follows: str,
    truncate: bool,
    protocol: str | None,
) -> dict[str, Any]:
    """Convert files into one submission file and say what was done.

    Returns:
        `output`, `split`, `n_predictions`, `size_bytes` and `done`, a list of sentences.

    Raises:
        InvalidArgumentError: A file or an option cannot be used.
    """
    if follows not in get_args(FollowedPoint):
        raise InvalidArgumentError("wrong_option", "--follows must be sensor or rear-axle.")
    if not abs(origin_offset_m) <= MAX_OFFSET_M:
        raise InvalidArgumentError(
            "wrong_option", f"--origin-offset-m must be within {MAX_OFFSET_M:g} m."
        )
    plan = ConversionPlan(
        waypoints=chosen_protocol(protocol).geometry.waypoints,
        swap_axes=swap_axes,
        origin_offset_m=origin_offset_m,
        follows=cast(FollowedPoint, follows),
        truncate=truncate,
    )
    pairs, split_of_files = read_pairs(files)
    split = split or split_of_files
    if split is None:
        raise InvalidArgumentError(
            "wrong_split", "No file says which split it is for.", "Add --split NAME."
        )
    outcome = convert_pairs(pairs, plan)
    try:
        size_bytes = write_submission(output, split, outcome.pairs)
    except OSError as error:
        raise InvalidArgumentError(
            "unwritable_file", f"{output} cannot be written: {error.strerror}."
        ) from None
    return {
        "output": str(output),
        "split": split,
        "n_predictions": len(outcome.pairs),
        "size_bytes": size_bytes,
        "done": list(outcome.done),
    }
