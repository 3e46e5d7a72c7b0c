"""Faults of an uploaded file: the codes, a sentence for each, and the report of all."""

from collections.abc import Mapping

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.python310 import Self, StrEnum

MAX_EXAMPLES = 20
"""Maximum of examples of one code in a report, each of another sample; the counts are complete."""


class FaultCode(StrEnum):
    """One kind of fault in a submission file. Codes are stable: scripts may rely on them."""

    FILE_TOO_LARGE = "file_too_large"
    EMPTY_FILE = "empty_file"
    WRONG_FILE_KIND = "wrong_file_kind"
    DAMAGED_GZIP = "damaged_gzip"
    INFLATES_TOO_LARGE = "inflates_too_large"
    BYTE_ORDER_MARK = "byte_order_mark"
    NOT_UTF8 = "not_utf8"
    NOT_JSON = "not_json"
    NESTED_TOO_DEEPLY = "nested_too_deeply"
    VALUE_TOO_LONG = "value_too_long"
    TRAILING_DATA = "trailing_data"
    DUPLICATE_KEY = "duplicate_key"
    UNKNOWN_KEY = "unknown_key"
    MISSING_KEY = "missing_key"
    WRONG_TYPE = "wrong_type"
    WRONG_SCHEMA = "wrong_schema"
    WRONG_SPLIT = "wrong_split"
    UNKNOWN_SAMPLE = "unknown_sample"
    MISSING_SAMPLE = "missing_sample"
    DUPLICATE_SAMPLE = "duplicate_sample"
    WRONG_WAYPOINT_COUNT = "wrong_waypoint_count"
    WRONG_WAYPOINT_SHAPE = "wrong_waypoint_shape"
    NON_FINITE = "non_finite"
    OUT_OF_BOUNDS = "out_of_bounds"
    STEP_TOO_LONG = "step_too_long"
    WRONG_FRAME = "wrong_frame"
    UNKNOWN_STRATEGY = "unknown_strategy"
    UNKNOWN_HAZARD_TYPE = "unknown_hazard_type"
    UNKNOWN_RISK_LEVEL = "unknown_risk_level"
    TEXT_TOO_LONG = "text_too_long"
    INVALID_TEXT = "invalid_text"


NOUNS: Mapping[FaultCode, str] = {
    FaultCode.DUPLICATE_KEY: "key",
    FaultCode.UNKNOWN_KEY: "key",
    FaultCode.MISSING_KEY: "key",
    FaultCode.WRONG_TYPE: "value",
    FaultCode.UNKNOWN_SAMPLE: "sample",
    FaultCode.MISSING_SAMPLE: "sample",
    FaultCode.DUPLICATE_SAMPLE: "prediction",
    FaultCode.WRONG_WAYPOINT_COUNT: "trajectory",
    FaultCode.WRONG_WAYPOINT_SHAPE: "waypoint",
    FaultCode.NON_FINITE: "number",
    FaultCode.OUT_OF_BOUNDS: "number",
    FaultCode.STEP_TOO_LONG: "step",
}
"""The noun that is counted; by default it is fault."""
PLURALS: Mapping[str, str] = {"trajectory": "trajectories"}


class Fault(Document):
    """One fault at one place."""

    path: str
    sample_id: str | None = None
    expected: str
    got: str
    hint: str | None = None


class FaultGroup(Document):
    """All faults of one code: a sentence, how many there are, where, and the first examples."""

    code: FaultCode
    message: str
    count: int
    n_samples: int = 0
    """In how many samples they are; 0 where they are in none."""
    sample_ids: tuple[str, ...] = ()
    """These samples: all of them where a file is checked, the first where a report is kept."""
    examples: tuple[Fault, ...]
    """At most one of a sample."""

    def extent(self, n_predictions: int | None = None) -> str:
        """Return the extent in words: "120 numbers in 10 of 3,181 samples", "1 fault"."""
        noun = NOUNS.get(self.code, "fault")
        words = counted(self.count, noun, PLURALS.get(noun))
        if not self.n_samples or noun == "sample":
            return words
        if n_predictions is None or n_predictions < self.n_samples:
            return f"{words} in {counted(self.n_samples, 'sample')}"
        return f"{words} in {self.n_samples:,} of {counted(n_predictions, 'sample')}"


class CheckReport(Document):
    """The outcome of checking a file: accepted when there are no faults."""

    challenge: ChallengeId | None
    split: str | None
    n_predictions: int | None
    digest: str
    size_bytes: int
    faults: tuple[FaultGroup, ...] = ()
    notes: tuple[str, ...] = ()
    profile: FileProfile | None = None
    """What a planning file looks like."""
    unranked_because: str | None = None
    """Why a sound file would be scored but not ranked, as far as it tells itself."""
    to_confirm: tuple[str, ...] = ()
    """What its team is asked before a sound file counts; empty where nothing has to be asked."""

    @property
    def is_valid(self) -> bool:
        """Whether the file can be scored."""
        return not self.faults

    @property
    def n_faults(self) -> int:
        """Number of faults, of all kinds."""
        return sum(group.count for group in self.faults)

    def to_keep(self) -> Self:
        """Return the report with only as many sample ids as examples, to bound the stored size."""
        groups = tuple(
            group.model_copy(update={"sample_ids": group.sample_ids[: len(group.examples)]})
            for group in self.faults
        )
        return self.model_copy(update={"faults": groups})


MESSAGES: Mapping[FaultCode, str] = {
    FaultCode.FILE_TOO_LARGE: "The file is larger than the upload limit: compress it with gzip "
    "and write no more than four decimals.",
    FaultCode.EMPTY_FILE: "The file is empty: check that your program finished writing it.",
    FaultCode.WRONG_FILE_KIND: "The file is of the wrong kind: send JSON, plain or gzip-compressed.",
    FaultCode.DAMAGED_GZIP: "The gzip data is damaged: compress the JSON file again, as one gzip "
    "stream with nothing after it.",
    FaultCode.INFLATES_TOO_LARGE: "The file inflates to more than the limit: write only the "
    "samples of the split, with no more than four decimals.",
    FaultCode.BYTE_ORDER_MARK: "The file begins with a byte order mark: save it as UTF-8 without "
    "one.",
    FaultCode.NOT_UTF8: "The file is not UTF-8 text: save it as UTF-8.",
    FaultCode.NOT_JSON: "The file is not a JSON object, or not valid JSON: write it with a "
    "JSON library.",
    FaultCode.NESTED_TOO_DEEPLY: "Lists or objects are nested too deeply: write the values as "
    "the format shows them.",
    FaultCode.VALUE_TOO_LONG: "One value or prediction is longer than any legal one: write one "
    "short object per sample into the list `predictions`.",
    FaultCode.TRAILING_DATA: "Something follows the end of the JSON document: write exactly one "
    "JSON object into the file.",
    FaultCode.DUPLICATE_KEY: "A key occurs twice in one object: write every key once.",
    FaultCode.UNKNOWN_KEY: "A key does not belong to the format: remove it; method, team and "
    "links travel with the upload, not in the file.",
    FaultCode.MISSING_KEY: "A key is missing: write every key; where there is no answer, its "
    "value is null.",
    FaultCode.WRONG_TYPE: "A value has the wrong type: write strings in quotes, numbers without, "
    "and lists as lists.",
    FaultCode.WRONG_SCHEMA: "The file does not name the schema that is expected here: set "
    "`schema`, or choose a phase of the right challenge.",
    FaultCode.WRONG_SPLIT: "The file is not for this split: set `split` to the split's name, or "
    "choose the phase that the file was made for.",
    FaultCode.UNKNOWN_SAMPLE: "A sample id does not belong to the split: take the ids from the "
    "split's manifest.",
    FaultCode.MISSING_SAMPLE: "A sample of the split has no prediction: write one for every "
    "sample; where there is no answer, its values are null.",
    FaultCode.DUPLICATE_SAMPLE: "A sample occurs twice: write one prediction per sample.",
    FaultCode.WRONG_WAYPOINT_COUNT: "A trajectory has the wrong number of waypoints: write "
    "exactly those that the protocol asks for, without t = 0; nothing is padded or cut.",
    FaultCode.WRONG_WAYPOINT_SHAPE: "A waypoint is not a pair of numbers: write [x, y].",
    FaultCode.NON_FINITE: "A coordinate is not a finite number: where the planner gave no "
    "trajectory, write null in place of the whole trajectory.",
    FaultCode.OUT_OF_BOUNDS: "A coordinate is out of bounds: write metres in the ego frame at "
    "t = 0, not global or pixel coordinates.",
    FaultCode.STEP_TOO_LONG: "Two waypoints in a row are further apart than any car drives: "
    "write metres, in order of time, the first step from (0, 0).",
    FaultCode.WRONG_FRAME: "The trajectories are not in the ego frame, x forward and y left.",
    FaultCode.UNKNOWN_STRATEGY: "A strategy is not one of the five: write A, B, C, D, E or null.",
    FaultCode.UNKNOWN_HAZARD_TYPE: "A hazard type is not a task of the protocol: write a task id "
    "such as SE1, or null.",
    FaultCode.UNKNOWN_RISK_LEVEL: "A risk level is not one of the four: write none, low, medium, "
    "high or null.",
    FaultCode.TEXT_TOO_LONG: "A text is too long: shorten it.",
    FaultCode.INVALID_TEXT: "A text holds characters that cannot be kept: remove control "
    "characters, and escape surrogates in pairs only.",
}
