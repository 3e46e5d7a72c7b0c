"""Lengths of time and progress in words, as pages and commands write them."""

import pytest

from exceptiondrive_schemas.api.rescoring import Progress
from exceptiondrive_schemas.printable import duration_words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "0 s"),
        (89, "89 s"),
        (90, "2 minutes"),
        (89 * 60, "89 minutes"),
        (90 * 60, "2 hours"),
        (35 * 3600, "35 hours"),
        (36 * 3600, "2 days"),
    ],
)
def test_a_length_of_time_is_written_in_its_largest_unit(seconds: float, words: str) -> None:
    assert duration_words(seconds) == words


def test_progress_names_what_failed_and_how_long_it_takes_where_that_is_known() -> None:
    started = Progress(done=1200, total=2000, failed=3, sheets_per_s=4.1, remaining_s=195.1)
    assert started.words == "1,200 of 2,000 sheets, 3 failed, 4.1 a second, about 3 minutes left"
    assert Progress(done=0, total=1, failed=0).words == "0 of 1 sheet"
