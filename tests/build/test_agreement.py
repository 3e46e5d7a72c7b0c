"""Two blind readers, a third, and how well they agree."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_build.agreement import agreement, corner_distance_m, iou, outcome, readings
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.settings import VerifySection
from exceptiondrive_build.values import Corners, Verified

SQUARE: Corners = ((10.0, -1.0), (10.0, 1.0), (12.0, 1.0), (12.0, -1.0))
LIMITS = VerifySection(min_iou=0.7, max_corner_distance_m=1.0)
number = itertools.count(1)


def moved(ahead_m: float, left_m: float = 0.0) -> Corners:
    a, b, c, d = ((x + ahead_m, y + left_m) for x, y in SQUARE)
    return a, b, c, d


def word(person: str, corners: Corners | None, *, blind: bool = True) -> Record:
    value = Verified(accepted=corners is not None, corners=corners, blind=blind)
    return Record(
        kind=Kind.VERIFY,
        candidate="one",
        by=Author(person=person),
        inputs=(),
        value=value.model_dump(mode="json"),
        id=next(number),
    )


def test_one_reading_decides_nothing() -> None:
    assert outcome([], LIMITS).state == "open"
    assert outcome([word("ada", SQUARE)], LIMITS).state == "open"
    assert outcome([word("ada", SQUARE), word("ada", moved(0.1))], LIMITS).state == "open"


def test_two_that_agree_give_the_region_between_them() -> None:
    found = outcome([word("ada", SQUARE), word("grace", moved(0.2))], LIMITS)
    assert found.state == "verified"
    assert found.corners == moved(0.1)


@pytest.mark.parametrize("same", ["Anna", "ANNA", "\uff21nna", "anna"])
def test_one_who_signs_in_otherwise_spelled_is_one_reader(same: str) -> None:
    words = [word("Anna", SQUARE), word(same, SQUARE)]
    assert outcome(words, LIMITS).state == "open"
    assert [person for person, _ in readings([*words, word("Anne", SQUARE)])] == [same, "Anne"]


def test_two_that_leave_the_proposal_keep_every_digit_of_it() -> None:
    odd = moved(0.123456789)
    assert outcome([word("ada", odd), word("grace", odd)], LIMITS).corners == odd


@pytest.mark.parametrize(
    "other",
    [moved(1.1), moved(0.4), None, (SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3])],
    ids=["far", "little overlap", "rejected", "crosses itself"],
)
def test_two_that_differ_need_a_third_whose_word_is_final(other: Corners | None) -> None:
    both = [word("ada", SQUARE), word("grace", other)]
    assert outcome(both, LIMITS).state == "third"
    own = moved(0.3, 0.2)
    decided = outcome([*both, word("lin", own, blind=False)], LIMITS)
    assert (decided.state, decided.corners) == ("verified", own)
    assert outcome([*both, word("lin", None, blind=False)], LIMITS).state == "rejected"


def test_two_that_reject_need_no_third() -> None:
    assert outcome([word("ada", None), word("grace", None)], LIMITS).state == "rejected"


def test_a_third_reading_does_not_count_as_blind() -> None:
    """As after one of the blind ones is taken back."""
    left = [word("ada", SQUARE), word("lin", SQUARE, blind=False)]
    assert outcome(left, LIMITS).state == "open"


@pytest.mark.parametrize("again", ["ada", "grace"])
def test_a_third_word_is_about_the_two_that_the_third_saw(again: str) -> None:
    seen = [word("ada", SQUARE), word("grace", None), word("lin", SQUARE, blind=False)]
    left = [record for record in seen if record.by.person != again]
    changed = [*left, word(again, moved(6.0 if again == "ada" else 9.0))]
    assert outcome(changed, LIMITS).state == "third"
    decided = outcome([*changed, word("lin", moved(6.5), blind=False)], LIMITS)
    assert (decided.state, decided.corners) == ("verified", moved(6.5))


@given(st.integers(0, 3), st.booleans(), st.floats(-3, 3), st.floats(-3, 3))
def test_where_a_list_begins_and_turns_is_nothing(
    shift: int, turned: bool, ahead_m: float, left_m: float
) -> None:
    other = moved(ahead_m, left_m)
    listed = (*other[shift:], *other[:shift])[:: -1 if turned else 1]
    a, b, c, d = listed
    again: Corners = (a, b, c, d)
    assert iou(SQUARE, again) == pytest.approx(iou(SQUARE, other))
    assert corner_distance_m(SQUARE, again) == pytest.approx(corner_distance_m(SQUARE, other))
    assert iou(SQUARE, again) == pytest.approx(iou(again, SQUARE))
    assert iou(SQUARE, SQUARE) == 1


@given(st.integers(0, 3), st.booleans(), st.booleans(), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_verified_region_is_one_list_whoever_was_first_and_wherever_theirs_began(
    shift: int, turned: bool, grace_first: bool, ahead_m: float, left_m: float
) -> None:
    other = moved(ahead_m, left_m)
    a, b, c, d = (*other[shift:], *other[:shift])[:: -1 if turned else 1]
    usual = [("ada", SQUARE), ("grace", other)]
    again: list[tuple[str, Corners]] = [("ada", SQUARE), ("grace", (a, b, c, d))]
    found, same = (
        [word(*reading) for reading in readings_]
        for readings_ in (usual, again[:: -1 if grace_first else 1])
    )
    assert outcome(same, LIMITS) == outcome(found, LIMITS)
    assert agreement({"one": same}, LIMITS) == agreement({"one": found}, LIMITS)
    third = [
        [word("ada", SQUARE), word("grace", None), word("lin", corners, blind=False)]
        for corners in (other, (a, b, c, d))
    ]
    assert outcome(third[0], LIMITS) == outcome(third[1], LIMITS)


def test_iou_and_distance_of_a_known_shift() -> None:
    assert iou(SQUARE, moved(0.5)) == pytest.approx(1.5 / 2.5)
    assert corner_distance_m(SQUARE, moved(0.3, 0.4)) == pytest.approx(0.5)


def test_alpha_is_that_of_the_textbook_formula() -> None:
    """Nominal data, two readers, no gaps: 1 - (n - 1) mixed pairs / (2 n_accepted n_rejected)."""
    words = [(SQUARE, SQUARE)] * 6 + [(None, None)] * 2 + [(SQUARE, None)] * 2
    given_ = {f"c{place}": [word("ada", a), word("grace", b)] for place, (a, b) in enumerate(words)}
    found = agreement(given_, LIMITS)
    # 20 words: 14 accepted, 6 rejected; 2 of 10 pairs differ: 1 - (2 * 2) * 19 / (2 * 14 * 6)
    assert found.alpha == pytest.approx(1 - 4 * 19 / (2 * 14 * 6))
    assert (found.n, found.both_accepted, found.same_word, found.beyond) == (10, 6, 8, 2)
    assert (found.iou_mean, found.iou_median, found.corner_m_max) == (1.0, 1.0, 0.0)


def test_agreement_without_a_pair_or_without_a_rejection_says_none() -> None:
    nothing = agreement({"one": [word("ada", SQUARE)]}, LIMITS)
    assert (nothing.n, nothing.iou_mean, nothing.alpha) == (0, None, None)
    alike = agreement({"one": [word("ada", SQUARE), word("grace", moved(1.5))]}, LIMITS)
    assert (alike.n, alike.alpha, alike.beyond) == (1, None, 1)
    assert alike.corner_m_max == pytest.approx(1.5)
