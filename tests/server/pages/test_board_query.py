"""The state of the board page in its address."""

from datetime import UTC, date, datetime
from urllib.parse import parse_qsl, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_server.boards.query import BoardQuery

queries = st.builds(
    BoardQuery,
    phase=st.sampled_from([None, "sample", "test-2026"]),
    as_of=st.sampled_from([None, date(2026, 11, 21), datetime(2026, 11, 21, 9, 5, tzinfo=UTC)]),
    source=st.sampled_from([None, "scored", "reported"]),
    average=st.sampled_from([None, "micro"]),
    search=st.sampled_from(["", "lane keeper", "a&b=c"]),
    sort=st.sampled_from(["rank", "-ur", "family.lane_blockage"]),
    page=st.integers(1, 4),
    hidden=st.frozensets(st.sampled_from(["hpr", "cts", "date"])),
)


@given(queries)
def test_the_address_holds_the_whole_view(query: BoardQuery) -> None:
    pairs = parse_qsl(urlsplit(query.url()).query)
    assert BoardQuery.parse(pairs) == query


def test_a_plain_view_has_a_plain_address() -> None:
    assert BoardQuery().url() == "/#board"


def test_a_change_goes_back_to_the_first_page() -> None:
    assert BoardQuery(page=3).url(sort="ur") == "/?sort=ur#board"


@pytest.mark.parametrize(
    "address",
    [
        "source=hacked", "page=-1", "page=", "board=x", "sort=ur;drop", "sort=", "phase=", "view=x",
        "sort=ur&order=up", "average=mean", "challenge=chess", "as_of=yesterday", "board=0",
        "as_of=2026-13-01", "as_of=2026-11-21;", "as_of=1", "as_of=9999-12-31T23:00:00-09:00",
    ],
)  # fmt: skip
def test_what_is_not_understood_is_refused_by_name_and_never_repeated(address: str) -> None:
    with pytest.raises(InvalidRecord) as refused:
        BoardQuery.parse(parse_qsl(address, keep_blank_values=True))
    name, value = address.split("&")[0].split("=")
    assert list(refused.value.fields) == [name]
    assert name in str(refused.value)
    if len(value) > 2:
        assert value not in str(refused.value) + str(refused.value.fields)


@pytest.mark.parametrize(
    ("address", "words"),  # of the first in the address
    [
        ("as_of=2026-11-21&protocol=1.0", "for a date or for a protocol"),
        ("board=3&protocol=1.0", "the number of a board alone"),
        ("as_of=2026-11-21&board=3", "the number of a board alone"),
        ("as_of=2026-11-21&view=late", "The late view is the present one"),
        ("board=3&view=late", "The late view is the present one"),
    ],
)
def test_what_contradicts_itself_is_refused(address: str, words: str) -> None:
    with pytest.raises(InvalidRecord) as refused:
        BoardQuery.parse(parse_qsl(address))
    ((name, said),) = refused.value.fields.items()
    assert (name, words in said) == (address.split("=")[0], True)


def test_what_others_put_into_an_address_is_let_be() -> None:
    assert BoardQuery.parse([("utm_source", "mail")]) == BoardQuery()


def test_an_order_in_words_is_understood_as_a_sign() -> None:
    parsed = BoardQuery.parse([("sort", "hcc"), ("order", "descending")])
    assert parsed.sort == "-hcc"
    assert BoardQuery.parse([("sort", "hcc"), ("order", "ascending")]).sort == "hcc"


def test_a_form_sends_its_empty_fields_too() -> None:
    pairs = [("apply", "1"), ("protocol", ""), ("as_of", ""), ("q", "")]
    assert BoardQuery.parse(pairs) == BoardQuery()


def test_unticked_columns_are_the_hidden_ones() -> None:
    pairs = [("offered", "hpr,cts,date"), ("show", "cts")]
    assert BoardQuery.parse(pairs).hidden == {"hpr", "date"}


def test_a_long_search_is_cut() -> None:
    assert len(BoardQuery.parse([("q", "x" * 500)]).search) == 80


def test_chosen_entries_stand_in_the_address_once_each_and_not_too_many() -> None:
    asked = BoardQuery.parse([("phase", "dev"), *(("more", key) for key in "aabcdefg")])
    assert asked.chosen == tuple("abcde")
    assert BoardQuery.parse(asked.pairs()) == asked
    assert asked.url().count("more=") == 5
