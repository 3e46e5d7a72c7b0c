"""Who is drawn for inspection, and how many of which stratum."""

from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_build.candidates import shares

SIZES = st.dictionaries(st.text("abc", min_size=1), st.integers(0, 400), max_size=6)


@given(SIZES, st.integers(0, 500))
def test_parts_are_by_size_and_never_more_than_there_are(sizes: dict[str, int], count: int) -> None:
    found = shares(sizes, count)
    whole = sum(sizes.values())
    assert sum(found.values()) == min(count, whole)
    for key, part in found.items():
        assert part <= sizes[key]
        assert abs(part - min(count, whole) * sizes[key] / max(whole, 1)) < 1


def test_the_rest_goes_to_the_largest_remainders() -> None:
    assert shares({"a": 2, "b": 1, "c": 1}, 3) == {"a": 1, "b": 1, "c": 1}
    assert shares({"a": 2000, "b": 1181}, 168) == {"a": 106, "b": 62}
