"""The state of the board page in its address."""

from urllib.parse import parse_qsl, urlsplit

from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_server.pages.board_query import BoardQuery

queries = st.builds(
    BoardQuery,
    phase=st.sampled_from([None, "sample", "test-2026"]),
    protocol=st.sampled_from([None, "1.0"]),
    board=st.sampled_from([None, 3]),
    source=st.sampled_from([None, "scored", "reported"]),
    average=st.sampled_from([None, "micro"]),
    search=st.sampled_from(["", "lane keeper", "a&b=c"]),
    sort=st.sampled_from(["rank", "ur", "family.lane_blockage"]),
    order=st.sampled_from([None, "ascending"]),
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


def test_what_is_not_understood_falls_back_to_the_default() -> None:
    pairs = [("source", "hacked"), ("order", "up"), ("page", "-1"), ("board", "x"), ("zzz", "1")]
    assert BoardQuery.parse(pairs) == BoardQuery()


def test_unticked_columns_are_the_hidden_ones() -> None:
    pairs = [("offered", "hpr,cts,date"), ("show", "cts")]
    assert BoardQuery.parse(pairs).hidden == {"hpr", "date"}


def test_a_long_search_is_cut() -> None:
    assert len(BoardQuery.parse([("q", "x" * 500)]).search) == 80
