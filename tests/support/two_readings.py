"""A file checked as it always is, and place by place: one report and one content."""

from typing import Any
from unittest.mock import patch

from exceptiondrive_schemas.check import Checked, PlanningDocument, check, checker


def check_both_ways(data: bytes, **options: Any) -> Checked:
    """Check a file, and once more without the fast decoding of planning files.

    Args:
        data: The file.
        options: Those of `check`.

    Returns:
        What reading place by place says.

    Raises:
        AssertionError: The other reading says anything else.
    """
    at_once = check(data, **options)
    with patch.object(checker, "planning_columns", return_value=None):
        precise = check(data, **options)
    assert at_once == precise
    if isinstance(precise.document, PlanningDocument):
        assert isinstance(at_once.document, PlanningDocument)
        sample_ids = list(precise.document.answers)
        assert list(at_once.document.answers) == sample_ids
        for names in (sample_ids, sample_ids[::-1]):  # in the order of the file, and in another
            both = (each.columns(names) for each in (at_once.document, precise.document))
            for one, other in zip(*(columns.values() for columns in both), strict=True):
                assert one.tobytes() == other.tobytes()  # equal to the sign of a zero
    return precise
