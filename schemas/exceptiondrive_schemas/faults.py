"""What can be wrong with an uploaded file: the codes, and the report that lists all at once."""

from enum import StrEnum

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import ChallengeId

MAX_EXAMPLES = 20
"""Examples of one code in a report; the count always tells all."""


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


class Fault(Document):
    """One fault at one place."""

    path: str
    sample_id: str | None = None
    expected: str
    got: str
    hint: str | None = None


class FaultGroup(Document):
    """All faults of one code: a sentence, how many there are, and the first examples."""

    code: FaultCode
    message: str
    count: int
    examples: tuple[Fault, ...]


class CheckReport(Document):
    """The outcome of checking a file: accepted when there are no faults."""

    challenge: ChallengeId | None
    split: str | None
    n_predictions: int | None
    digest: str
    size_bytes: int
    faults: tuple[FaultGroup, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def is_valid(self) -> bool:
        """Whether the file can be scored."""
        return not self.faults
