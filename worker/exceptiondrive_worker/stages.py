"""Stages from an upload to a score sheet; all but the sheet is cached by the hash of its inputs.

    upload --read--> answers --measure--> measurements --settle--> settled --grade--> exact sheet

A stage runs only if its result is not in the private store: new d_safe values need neither geometry
nor anything that does not depend on them, and a new geometry reads no upload.
"""

import hmac
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from pydantic import ValidationError

from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES, check
from exceptiondrive_schemas.faults import CheckReport, Fault, FaultCode, FaultGroup
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_scoring.aliases import Columns, IntArray
from exceptiondrive_scoring.bootstrap import SceneSums, scene_sums
from exceptiondrive_scoring.challenge import (
    ChallengeScoring,
    Settled,
    graded_sheet,
    scoring_of,
    settle,
)
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_worker.splits.private_store import PrivateStore, Shelf, content_key
from exceptiondrive_worker.splits.store import LoadedSplit

LoadUpload = Callable[[str], bytes]
"""File digest -> the bytes, verified against it."""
ReadAnswers = Callable[[bytes, Challenge, Manifest, ProtocolDocument], Columns | CheckReport]
"""Upload -> answers as columns in the split's order, or the report of all faults."""


@dataclass(frozen=True)
class Target:
    """A file to score, and the challenge, split and protocol to score it against."""

    file_digest: str
    challenge: Challenge
    split: LoadedSplit
    protocol: ProtocolDocument
    read_under: ProtocolDocument | None = None
    """The protocol whose bounds the upload passed; by default `protocol`."""
    made: Columns | None = None
    """Answers to all samples, if in memory: just read, or made here (`file_digest` is theirs)."""

    @property
    def scoring(self) -> ChallengeScoring:
        """The scoring of its challenge."""
        return scoring_of(self.challenge.id)


@dataclass(frozen=True)
class Scored:
    """An exact score sheet, which stays with the worker, and the key of its measurements."""

    sheet: ScoreSheet
    measurement_key: str
    regions_digest: str
    """Digest of all regions of the split: withheld."""

    @property
    def digest(self) -> str:
        """Digest of the exact sheet, which a rescoring must reproduce.

        It leaves the worker, so it is keyed with the regions (HMAC-SHA256). Without a key, whoever
        sees the digest of an upload that answers a single sample could try every clearance that
        this sample may have, which the rounding of published values would not limit.
        """
        key = self.regions_digest.encode("ascii")
        return f"sha256:{hmac.digest(key, canonical_json(self.sheet), 'sha256').hex()}"


class RejectedUpload(Exception):  # noqa: N818 - the file is wrong, not the program
    """The upload has faults; the report lists them all."""

    def __init__(self, report: CheckReport) -> None:
        super().__init__("the upload is not valid")
        self.report = report


def too_large_to_read(digest: str, size_bytes: int) -> CheckReport:
    """Return the report of a file that does not fit into a worker's memory when read."""
    fault = Fault(path="$", expected="a file that a worker can read", got="out of memory")
    group = FaultGroup(
        code=FaultCode.INFLATES_TOO_LARGE,
        message="The file needs more memory to read than a worker may take.",
        count=1,
        examples=(fault,),
    )
    return CheckReport(
        challenge=None,
        split=None,
        n_predictions=None,
        digest=digest,
        size_bytes=size_bytes,
        faults=(group,),
    )


class Stages:
    """Runs the stages of a scoring run, but only those whose result is not cached."""

    def __init__(
        self, private: PrivateStore, load_upload: LoadUpload, read_answers: ReadAnswers
    ) -> None:
        self.private = private
        self._load_upload = load_upload
        self._read_answers = read_answers

    def score(self, target: Target) -> Scored:
        """Return the exact score sheet of an upload.

        Raises:
            RejectedUpload: The upload has faults.
        """
        settled, split = self.settled(target), target.split
        sheet = graded_sheet(
            target.scoring, settled, split.arrays, split.manifest.ref, target.protocol
        )
        return Scored(sheet, _measurement_key(target), split.regions_digest)

    def settled(self, target: Target) -> Settled:
        """Return the part of a sheet without required clearances; cached if the challenge regrades.

        Raises:
            RejectedUpload: The upload has faults.
        """
        measurement_key = _measurement_key(target)
        split, scoring = target.split, target.scoring
        is_kept, key = scoring.regrading is not None, _settled_key(measurement_key, target)
        kept = self.private.read_columns(Shelf.SETTLED, key) if is_kept else None
        if kept is not None:
            with suppress(ValidationError):  # written by another version
                return Settled.from_columns(kept)
        of_controls = None
        if len(split.control_rows):
            answers = self.answers(target)
            target = replace(target, made=answers)
            of_controls = scoring.of_controls(_rows(answers, split.control_rows), target.protocol)
        measured, ref = self._measurements_of(target, measurement_key), split.manifest.ref
        settled = settle(scoring, measured, split.arrays, ref, target.protocol, of_controls)
        if is_kept:
            self.private.write_columns(Shelf.SETTLED, key, settled.columns())
        return settled

    def measurements(self, target: Target) -> Columns:
        """Return the measurements of an upload.

        Raises:
            RejectedUpload: The upload has faults.
        """
        return self._measurements_of(target, _measurement_key(target))

    def _measurements_of(self, target: Target, key: str) -> Columns:
        kept = self.private.read_columns(Shelf.MEASUREMENTS, key)
        if kept is not None:
            return kept
        measured = target.scoring.measure(
            self.counted_answers(target), target.split.arrays, target.protocol.geometry
        )
        self.private.write_columns(Shelf.MEASUREMENTS, key, measured)
        return measured

    def report(self, target: Target) -> CheckReport:
        """Return the precise checker's report on an upload, word for word as its team's `check`."""
        return check(
            self._load_upload(target.file_digest),
            protocol=target.read_under or target.protocol,
            manifest=target.split.manifest,
            challenge=target.challenge.id,
            max_upload_bytes=MAX_INFLATED_BYTES,
        ).report

    def answers(self, target: Target) -> Columns:
        """Return the answers in an upload, in the split's order.

        Raises:
            RejectedUpload: The upload has faults.
        """
        if target.made is not None:
            return target.made
        key = content_key("answers", *_read_as(target))
        kept = self.private.read_columns(Shelf.ANSWERS, key)
        if kept is not None:
            return kept
        answers = self._read(target)
        self.private.write_columns(Shelf.ANSWERS, key, answers)
        return answers

    def counted_answers(self, target: Target) -> Columns:
        """Return the answers that count, in the order of `measurements`.

        Raises:
            RejectedUpload: The upload has faults.
        """
        return _rows(self.answers(target), target.split.rows)

    def scene_sums_key(self, target: Target, measurement_key: str) -> str:
        """Return the key of results that are derived from the scene sums of these measurements."""
        return content_key(
            "sums",
            SCORER_VERSION,
            target.challenge.id,
            measurement_key,
            target.protocol.grading_digest,
            target.split.grading_digest,
            target.split.scenes_digest,
        )

    def scene_sums(self, target: Target, measurement_key: str) -> SceneSums:
        """Return the sums per scene of an entry, for the bootstrap.

        Raises:
            RejectedUpload: The measurements are no longer cached, and the upload now has faults.
        """
        scores = self.sample_scores(target, measurement_key)
        scores = scores.only(target.challenge.interval_metrics)
        return scene_sums(scores, target.split.arrays, target.protocol.taxonomy)

    def sample_scores(self, target: Target, measurement_key: str) -> SampleScores:
        """Return the metric values of each sample: withheld, never to leave the worker.

        Raises:
            RejectedUpload: The measurements are no longer cached, and the upload now has faults.
        """
        kept = self.private.read_columns(Shelf.MEASUREMENTS, measurement_key)
        measured = kept or self.measurements(target)
        return target.scoring.grade(measured, target.split.arrays, target.protocol)

    def _read(self, target: Target) -> Columns:
        data = self._load_upload(target.file_digest)
        protocol, manifest = target.read_under or target.protocol, target.split.manifest
        try:
            answers = self._read_answers(data, target.challenge, manifest, protocol)
        except MemoryError:
            raise RejectedUpload(too_large_to_read(target.file_digest, len(data))) from None
        if isinstance(answers, CheckReport):
            raise RejectedUpload(answers)
        return answers


def _rows(answers: Columns, rows: IntArray | None) -> Columns:
    """Return the answers about some samples; a file always answers the whole split."""
    return answers if rows is None else {name: column[rows] for name, column in answers.items()}


def _measurement_key(target: Target) -> str:
    rows_digest = target.split.rows_digest
    return content_key(
        "measurement",
        *_read_as(target),
        target.split.regions_digest,
        target.protocol.geometry_digest,
        *([] if rows_digest is None else [rows_digest]),
    )


def _read_as(target: Target) -> tuple[str, ...]:
    """Return what the answers depend on besides the upload's bytes: ids, their order, waypoints.

    The bounds that an upload is checked against are not part of it: once accepted, it stays
    accepted.
    """
    manifest = target.split.manifest
    return (
        SCORER_VERSION,
        target.file_digest,
        target.challenge.file_schema,
        manifest.name,
        str(target.protocol.geometry.waypoints),
        target.split.samples_digest,
    )


def _settled_key(measurement_key: str, target: Target) -> str:
    return content_key(
        "settled, task by task",
        SCORER_VERSION,
        target.challenge.id,
        measurement_key,
        target.protocol.plausibility_digest,
        target.split.groups_digest,
    )
