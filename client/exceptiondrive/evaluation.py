"""Score a file on this machine, exactly as the worker does and unrounded.

Needs a split with its hazard regions, such as the development split, and numpy (the extra
`evaluate`). Nothing else in the client touches numpy or the scoring package.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import zip_longest
from typing import TYPE_CHECKING, NamedTuple

from exceptiondrive.checking import manifest_of
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError, extra_missing
from exceptiondrive.inputs import (
    ProtocolLike,
    SplitLike,
    SubmissionLike,
    given_protocol,
    given_split,
    given_submission,
)
from exceptiondrive_schemas.challenges import PLANNING, ChallengeId
from exceptiondrive_schemas.check import CheckedDocument, check
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.printable import counted, first_of
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split, SplitRef

if TYPE_CHECKING:
    from exceptiondrive_scoring.aliases import BoolArray
    from exceptiondrive_scoring.arrays import SplitArrays


def evaluate_file(
    file: SubmissionLike, *, split: SplitLike, protocol: ProtocolLike | None = None
) -> ScoreSheet:
    """Score a submission file against a split that is at hand.

    Args:
        file: The submission: a path, bytes, an open file, a mapping, arrays or a data frame.
        split: The split with its regions, or its file, in the same forms.
        protocol: A document, the path of its TOML file, or a version; else the one that ships.

    Returns:
        The score sheet, unrounded.

    Raises:
        InvalidFileError: The file cannot be scored; the error carries every fault.
        InvalidArgumentError: The split cannot be used, or the extra `evaluate` is missing.
    """
    sound = sound_file(file, split, protocol)
    return score(sound.document, sound.split, sound.protocol)


class SoundFile(NamedTuple):
    """A file that can be scored, with what it is scored against and under."""

    document: CheckedDocument
    split: Split
    protocol: ProtocolDocument
    report: CheckReport


def sound_file(
    file: SubmissionLike,
    split: SplitLike,
    protocol: ProtocolLike | None,
    challenge: ChallengeId | None = None,
) -> SoundFile:
    """Read a file that can be scored, the split and the protocol that it is scored under.

    `challenge` is the one that the file must be for; any, if None.

    Raises:
        InvalidFileError: The file cannot be scored; the error carries every fault.
        InvalidArgumentError: The split cannot be used, or the extra `evaluate` is missing.
    """
    require_numpy()
    known, rules = given_split(split), given_protocol(protocol)
    data = given_submission(file, known.name).data
    manifest = manifest_of(known, rules)
    checked = check(
        data, protocol=rules, manifest=manifest, challenge=challenge, foretells_rank=False
    )
    if checked.document is None:
        raise InvalidFileError(checked.report)
    return SoundFile(checked.document, known, rules, checked.report)


def score(
    document: CheckedDocument,
    split: Split,
    protocol: ProtocolDocument,
    on_step: Callable[[str], None] = lambda _: None,
    revision: str | None = None,
) -> ScoreSheet:
    """Score a sound file: measure, grade, aggregate (docs/protocol.md sections 2 and 3).

    Args:
        document: What was handed in.
        split: The split with its regions.
        protocol: Everything besides.
        on_step: Is told each step as it begins.
        revision: What the sheet says of the split; by default its digest, which takes longer than
            measuring.
    """
    from exceptiondrive_scoring.challenge import document_columns, exact_sheet, scoring_of

    on_step(f"measuring {counted(len(split.counted), 'sample')}")
    arrays = _split_arrays(split, protocol)
    scoring = scoring_of(document.challenge)
    answers = document_columns(document, [sample.sample_id for sample in split.counted])
    measured = scoring.measure(answers, arrays, protocol.geometry)
    on_step("grading")
    split_ref = SplitRef(name=split.name, revision=split.revision if revision is None else revision)
    of_controls = None
    if split.controls:
        control_ids = [sample.sample_id for sample in split.controls]
        of_controls = scoring.of_controls(document_columns(document, control_ids), protocol)
    return exact_sheet(scoring, measured, arrays, split_ref, protocol, of_controls)


def _split_arrays(split: Split, protocol: ProtocolDocument) -> "SplitArrays":
    from exceptiondrive_scoring.arrays import split_arrays
    from exceptiondrive_scoring.clearance import touches_start
    from exceptiondrive_scoring.region import crosses_itself, is_far, is_small

    geometry = protocol.geometry

    def none_may(has_it: "BoolArray", what: str) -> None:
        if has_it.any():
            names = sorted(sample.sample_id for sample in split.counted)
            named = [names[index] for index in has_it.nonzero()[0]]
            raise ValueError(f"hazard regions {what} ({len(named):,}): {first_of(named)}")

    try:
        uses = Counter(sample.sample_id for sample in split.samples)
        if repeated := sorted(name for name, count in uses.items() if count > 1):
            raise ValueError(f"samples that stand in it more than once: {first_of(repeated)}")
        arrays = split_arrays(split.counted, protocol.taxonomy)
        far = f"with a corner more than {geometry.max_region_distance_m:g} m away"
        none_may(is_far(arrays.regions_m, geometry), far)
        none_may(crosses_itself(arrays.regions_m), "that cross or touch themselves")
        small = f"smaller than {geometry.min_region_area_m2:g} m2"
        none_may(is_small(arrays.regions_m, geometry), small)
        none_may(
            touches_start(arrays.prepared_regions, geometry), "that touch the footprint at t = 0"
        )
    except ValueError as error:
        raise InvalidArgumentError("wrong_split_file", f"{error}.") from None
    return arrays


class SampleResult(NamedTuple):
    """What one sample contributes: fractions and metres, None where undefined."""

    sample_id: str
    task: str
    family: str
    ur: float
    clearance_m: float | None
    required_m: float
    depth_m: float | None
    """How deep the deepest footprint stands in the region."""
    hcc: float
    hpr: float
    cts: float | None
    progress: float | None
    source_l2_m: float | None


def evaluate_samples(
    file: SubmissionLike, *, split: SplitLike, protocol: ProtocolLike | None = None
) -> tuple[SampleResult, ...]:
    """Score every sample of a planning file by itself, against a split that is at hand.

    Args:
        file: The submission: a path, bytes, an open file, a mapping, arrays or a data frame.
        split: The split with its regions, or its file, in the same forms.
        protocol: A document, the path of its TOML file, or a version; else the one that ships.

    Returns:
        The unsafe ones first, then the others, each in turn of the families: of each family the
        deepest in the hazard first, those of depth 0 or without an answer last; of the others the
        least HCC.

    Raises:
        InvalidFileError: The file cannot be scored; the error carries every fault.
        InvalidArgumentError: No planning file, a split that cannot be used, or the extra `evaluate`
            is missing.
    """
    return sample_results(*sound_file(file, split, protocol)[:3])


def sample_results(
    document: CheckedDocument, split: Split, protocol: ProtocolDocument
) -> tuple[SampleResult, ...]:
    """Score every sample of a sound planning file, in turn of each family, the worst first."""
    from exceptiondrive_scoring.challenge import document_columns, scoring_of
    from exceptiondrive_scoring.depth import intrusion_depth_m

    if document.challenge != PLANNING.id:
        raise InvalidArgumentError(
            "wrong_challenge", "Only planning files have results of samples by depth."
        )
    arrays = _split_arrays(split, protocol)
    answers = document_columns(document, [sample.sample_id for sample in split.counted])
    scoring = scoring_of(PLANNING.id)
    measured = scoring.measure(answers, arrays, protocol.geometry)
    scores = scoring.grade(measured, arrays, protocol)
    depth_m = intrusion_depth_m(answers["edited"], arrays.regions_m, protocol.geometry)
    clearance_m = measured["clearance_m"]
    keys = ("ur", "hcc", "hpr", "cts", "progress", "source_l2_m")
    columns = {key: scores.values[:, scores.metric_keys.index(key)] for key in keys}
    results = []
    for index, sample in enumerate(split.counted):
        task = protocol.tasks[int(arrays.task_index[index])]
        results.append(
            SampleResult(
                sample_id=sample.sample_id,
                task=task.id,
                family=task.family,
                clearance_m=_none_if_nan(clearance_m[index]),
                required_m=float(arrays.d_safe_m[index]) * protocol.grading.d_safe_scale,
                depth_m=_none_if_nan(depth_m[index]),
                ur=float(columns["ur"][index]),
                hcc=float(columns["hcc"][index]),
                hpr=float(columns["hpr"][index]),
                cts=_none_if_nan(columns["cts"][index]),
                progress=_none_if_nan(columns["progress"][index]),
                source_l2_m=_none_if_nan(columns["source_l2_m"][index]),
            )
        )
    ordered = sorted(results, key=_worst_first)
    unsafe, safe = (
        [each for each in ordered if bool(each.ur) is is_hit] for is_hit in (True, False)
    )
    return (*in_turn(unsafe), *in_turn(safe))


def in_turn(results: Iterable[SampleResult]) -> tuple[SampleResult, ...]:
    """Take the first of each family, then the second of each, and so on."""
    families: dict[str, list[SampleResult]] = {}
    for result in results:
        families.setdefault(result.family, []).append(result)
    turns = zip_longest(*families.values())
    return tuple(each for turn in turns for each in turn if each is not None)


def _none_if_nan(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _worst_first(result: SampleResult) -> tuple[float, float, float, str]:
    return -result.ur, -(result.depth_m or 0.0), result.hcc, result.sample_id


def require_numpy() -> None:
    """Refuse with a hint where numpy is missing.

    Raises:
        InvalidArgumentError: It is.
    """
    try:
        import numpy as np  # noqa: F401
    except ModuleNotFoundError:
        raise extra_missing("Scoring on this machine needs numpy.", "evaluate") from None
