"""An id that people choose is never the word of a page of its own."""

import re
from collections.abc import Iterator
from itertools import permutations

import pytest

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.identifiers import checked_slug
from exceptiondrive_schemas.split import SPLIT_NAME_PATTERN
from exceptiondrive_server.routes import ROUTES

CHOSEN = {"phase": "phase", "phase_id": "phase", "team_id": "team"}
RANDOM_ID = re.compile("[0-9a-hjkmnp-tv-z]{16}|[0-9a-hjkmnp-tv-z]{8}")


def paths() -> set[str]:
    return {
        route.path
        for included in ROUTES.routes
        for route in included.effective_route_contexts()  # type: ignore[attr-defined]
    }


def words_at_parameters() -> Iterator[tuple[str, str, str]]:
    """Each path with a parameter, its name, and a word that stands in its place in another path."""
    for path, other in permutations(sorted(paths()), 2):
        parts, others = path.split("/"), other.split("/")
        pairs = list(zip(parts, others, strict=False))
        is_alike = all(a == b or "{" in a + b for a, b in pairs)
        if is_alike and len(parts) == len(others):
            for part, word in pairs:
                if "{" in part and "{" not in word:
                    yield path, part.strip("{}").partition(":")[0], word


def test_a_word_that_stands_in_the_place_of_an_id_is_no_id_of_a_phase_or_team() -> None:
    found = {(CHOSEN[name], word) for _, name, word in words_at_parameters() if name in CHOSEN}
    assert found == {("phase", "new"), ("team", "import")}
    for kind, word in found:
        with pytest.raises(InvalidRecord, match="stands for a page of its own; choose another"):
            checked_slug(kind, word)


def test_a_word_that_stands_in_the_place_of_an_id_is_no_random_id() -> None:
    found = {word for _, name, word in words_at_parameters() if name.endswith("_id")}
    assert {"new", "verifications"} <= found
    assert not [word for word in found if RANDOM_ID.fullmatch(word)]


def test_a_word_that_stands_in_the_place_of_a_split_or_protocol_is_none() -> None:
    found = {
        (name, word)
        for path, name, word in words_at_parameters()
        if name == "version" or (name == "name" and "/splits/" in path)
    }
    assert not {
        word for name, word in found if name == "name" and re.match(SPLIT_NAME_PATTERN, word)
    }
    assert not {word for name, word in found if name == "version" and word[:1].isdigit()}


def test_other_words_of_pages_stay_free() -> None:
    for kind, slug in (("phase", "import"), ("team", "new"), ("phase", "new-1")):
        assert checked_slug(kind, slug) == slug
