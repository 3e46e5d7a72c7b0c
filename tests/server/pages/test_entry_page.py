"""The page of an entry."""

import html
import re
from itertools import accumulate
from typing import Any
from xml.etree import ElementTree as Xml

from tests.server.pages.invented_board import PROTOCOL
from tests.server.pages.page_site import publish_late_view, sheet_of
from tests.server.pages.reading import read

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.score_sheet import Flag, Plausibility, ProtocolRef
from exceptiondrive_server.boards.exports import entry_bibtex
from exceptiondrive_server.boards.table import RowBuilder
from exceptiondrive_server.entries.view import plausibility_lines, position_of
from exceptiondrive_server.web.numbers import Digits


async def test_an_entry_shows_all_tasks_both_averages_and_its_receipt(lively_site: Any) -> None:
    text = (await lively_site.get("/entries/s0000000kq")).text
    for task in ("SE1", "LB4", "BG4", "SR3", "IC3", "RS3"):
        assert f"<code>{task}</code>" in text
    assert "57.30 to 65.50" in text
    assert "<small>61.27 to 68.89</small>" in text
    assert "60.70" in text
    assert "sha256:" + "ab12" * 16 in text
    assert "41.2 kB" in text
    assert "flag above 95\u202f%" in text


async def test_a_flag_is_explained_in_words(lively_site: Any) -> None:
    text = (await lively_site.get("/entries/s0000005kq")).text
    assert "97% of the pairs differ by less than 0.05 m." in text


async def test_what_the_paper_reports_has_a_page_of_its_own_and_no_other(
    lively_site: Any,
) -> None:
    text = (await lively_site.get("/reported/planning")).text
    assert "<dt>N</dt><dd>3,181</dd>" in text
    assert "<dt>Protocol</dt><dd>the paper&#39;s own" in text
    printed = re.findall(r'<th scope="row">ST-P3</th>(.*?)</tr>', text)
    assert re.findall(r"<td>(.*?)</td>", printed[0])[:3] == ["21.03", "78.11", "18.59"]
    assert (await lively_site.get("/reported/unknown")).status_code == 400
    for path in ("/entries/reported-st-p3", "/badges/reported-st-p3.svg"):
        assert (await lively_site.get(f"{path}?phase=sample")).status_code == 404
    board = (await lively_site.get("/")).text
    assert 'href="/reported/planning"' in board
    assert "ST-P3" not in board


async def test_whether_it_is_plausible_is_said_of_paths_or_of_answers(
    lively_site: Any, lively_board: Board, strategy_board: Board
) -> None:
    agent = strategy_board.entries[0]
    lively_site.create_phase("strategy", "strategy")
    lively_site.publish(strategy_board)
    shares = Plausibility(shares={"same_answer": 0.4})
    sheet = sheet_of(lively_board.entries[0]).model_copy(
        update={"challenge": "strategy", "tasks": {}, "plausibility": shares}
    )
    lively_site.keep_submission(agent, "strategy", sheet)
    for path, said in (
        ("s0000000kq", "what the paths look like in the original scene and in the scene with"),
        (f"{agent.submission_id}?phase=strategy", "what the answers look like in the scene with"),
    ):
        text = read((await lively_site.get(f"/entries/{path}")).text).one("main").text
        assert said in " ".join(text.split())


async def test_the_strip_of_entries_explains_its_grey_ticks(
    lively_site: Any, lively_board: Board
) -> None:
    assert "</svg>a reference" in (await lively_site.get("/entries/s0000000kq")).text
    ranked = tuple(entry for entry in lively_board.entries if entry.rank is not None)
    lively_site.publish(lively_board.model_copy(update={"entries": ranked}))
    assert "</svg>a reference" not in (await lively_site.get("/entries/s0000000kq")).text


async def test_an_entry_stands_beside_nobody_where_nobody_else_is_ranked(
    lively_site: Any, lively_board: Board
) -> None:
    assert "Beside the best" in (await lively_site.get("/entries/s0000000kq")).text
    alone = lively_board.model_copy(update={"entries": lively_board.entries[:1]})
    lively_site.publish(alone)
    text = (await lively_site.get("/entries/s0000000kq")).text
    assert "Kestrel-2" in text
    assert "Beside the best" not in text


async def test_families_of_few_samples_are_set_apart(lively_site: Any) -> None:
    text = (await lively_site.get("/entries/s0000000kq")).text
    assert "In italics: fewer than 30 samples." in text
    assert len(re.findall(r'class="fam few"', text)) == 2
    assert len(re.findall(r'class="fam"', text)) == 4


async def test_a_reference_has_a_page_and_is_compared_though_nobody_submitted_it(
    lively_site: Any,
) -> None:
    key = "reference-freeze"
    assert f'href="/entries/{key}?phase=sample"' in (await lively_site.get("/?phase=sample")).text
    page = await lively_site.get(f"/entries/{key}?phase=sample")
    assert page.status_code == 200
    assert "97.20" in page.text
    assert "Stands still" in page.text
    compared = await lively_site.get(f"/compare?phase=sample&a=s0000000kq&b={key}")
    assert compared.status_code == 200
    assert "FREEZE" in compared.text


async def test_a_phase_that_does_not_show_the_paper_does_not_lead_to_it(
    site: Any, lively_board: Board
) -> None:
    site.create_phase("sample")
    site.publish(lively_board)
    assert "/reported/" not in (await site.get("/")).text


async def test_an_entry_that_left_the_board_is_shown_as_it_stood(
    lively_site: Any, empty_board: Board
) -> None:
    lively_site.publish(empty_board)
    text = (await lively_site.get("/entries/s0000000kq")).text
    assert "This is how the entry stood on board 1" in text


async def test_what_no_board_shows_is_not_found(lively_site: Any) -> None:
    for path in ("/entries/unknown", "/entries/reported-unknown?phase=sample"):
        assert (await lively_site.get(path)).status_code == 404


async def test_a_submission_on_no_board_is_its_teams_alone(
    lively_site: Any, empty_board: Board
) -> None:
    lively_site.create_phase("other")
    entry = empty_board
    with lively_site.database.write() as session:
        submission = session.get_one(Submission, "s0000001kq")
        submission.status = SubmissionStatus.WITHDRAWN
    lively_site.publish(entry)
    assert (await lively_site.get("/entries/s0000001kq")).status_code == 404


async def test_names_are_escaped(site: Any, lively_board: Board) -> None:
    nasty = lively_board.entries[0].model_copy(
        update={"method": "<script>x</script>", "team": '"><img src=x>'}
    )
    site.create_phase("sample")
    site.publish(lively_board.model_copy(update={"entries": (nasty,)}))
    site.keep_submission(nasty)
    for path in ("/", f"/entries/{nasty.submission_id}"):
        text = (await site.get(path)).text
        assert "<script>x" not in text
        assert "<img src=x" not in text
        assert "&lt;script&gt;x" in text


async def test_the_badge_says_rank_and_score_and_follows_the_board(lively_site: Any) -> None:
    answer = await lively_site.get("/badges/s0000000kq.svg")
    assert answer.headers["content-type"] == "image/svg+xml"
    assert answer.headers["cache-control"] == "public, max-age=300"
    told = list(answer.headers)
    assert answer.headers["x-accel-expires"] == "5", "a proxy shows no longer what is taken back"
    assert told.index("x-accel-expires") < told.index("cache-control")
    assert "rank 1, HCC 61.40 %" in Xml.fromstring(answer.text).itertext().__next__()
    flagged = await lively_site.get("/badges/s0000005kq.svg")
    assert "rank 6, HCC 22.18 %, flagged: Blind to the edit" in flagged.text
    freeze = await lively_site.get("/badges/reference-freeze.svg?phase=sample")
    assert "reference, HCC 97.20 %, flagged: Stands still" in freeze.text
    assert (await lively_site.get("/badges/unknown.svg")).status_code == 404


async def test_a_late_entry_has_the_same_page_and_claims_no_rank(
    site: Any, lively_board: Board
) -> None:
    publish_late_view(site, lively_board)
    answer = await site.get("/entries/l0000000kq")
    assert answer.status_code == 200
    assert '<span class="badge late">Late</span>' in answer.text
    assert "<dt>Rank</dt><dd>–<small>would be 1</small>" in answer.text
    assert "It came after the deadline, so it holds no rank and moves none." in answer.text
    assert 'href="/?phase=late&amp;view=late#board">Late, late view</a>' in answer.text
    assert "late, HCC 61.40 %" in (await site.get("/badges/l0000000kq.svg")).text
    assert 'href="/entries/l0000000kq"' in (await site.get("/?phase=late&view=late")).text


async def test_from_a_late_entry_every_address_leads_somewhere(
    site: Any, lively_board: Board
) -> None:
    publish_late_view(site, lively_board)
    text = (await site.get("/entries/l0000000kq")).text
    addresses = {html.unescape(it) for it in re.findall(r'="(?:http://site.test)?(/[^"]*)"', text)}
    assert any(it.startswith("/compare?phase=late&view=late&a=l0000000kq") for it in addresses)
    for address in sorted(it for it in addresses if "late" in it or "l0000000kq" in it):
        if not address.startswith("/api/"):  # read in tests/phases
            assert (await site.get(address)).status_code == 200, address


async def test_a_comparison_on_the_late_view_stays_there(site: Any, lively_board: Board) -> None:
    publish_late_view(site, lively_board)
    text = (await site.get("/compare?phase=late&view=late&a=l0000000kq&b=s0000001kq")).text
    assert text.count('<input type="hidden" name="view" value="late">') == 1
    assert "/compare?phase=late&amp;view=late&amp;a=s0000001kq&amp;b=l0000000kq" in text  # swapped
    board = (await site.get("/?phase=late&view=late")).text
    assert board.count('<input type="hidden" name="view" value="late">') == 2  # search, chosen


async def test_an_entry_that_left_is_compared_on_the_board_that_shows_it(
    lively_site: Any, empty_board: Board
) -> None:
    lively_site.publish(empty_board)
    text = (await lively_site.get("/entries/s0000000kq")).text
    found = re.findall(r'href="(/compare[^"]*)"', text)
    assert found
    for address in found:
        assert (await lively_site.get(html.unescape(address))).status_code == 200
    given = re.findall(r"/api/v1/entries/[^\"]*", text)
    assert given  # it stands on no board now: only what that one told is given out
    assert all(address.endswith("?board=1") for address in given)


def test_a_range_of_one_rank_says_on_what_it_rests(lively_board: Board) -> None:
    first = lively_board.entries[0].model_copy(update={"rank_interval": (1, 1)})
    build = RowBuilder(lively_board, lively_board.headline, Digits())
    notes = [position_of(build.row(e), lively_board).note for e in (first, lively_board.entries[1])]
    assert notes == ["certain at 95\u202f%", "1\u20133 possible"]


def test_of_two_shares_that_raise_one_flag_the_one_above_its_threshold_is_marked() -> None:
    shares: dict[str, float | None] = {
        "impossible": 0.01,
        "first_step": 0.2,
        "edited_behind": 0.5,
        "source_behind": 0.4,
    }
    codes = ("impossible_motion", "reverses")
    flags = tuple(Flag(code=code, label=code, detail="") for code in codes)
    plausibility = Plausibility(shares=shares, flags=flags)
    lines = plausibility_lines(plausibility, PROTOCOL.plausibility)
    assert [(line.share, line.is_raised) for line in lines] == [
        (0.5, True),
        (0.4, False),
        (0.01, False),
        (0.2, True),
    ]
    assert lines[0].threshold == "more than 5 points above the share in the original scenes"
    assert "first step" in lines[2].words  # it is counted there, too: zeros accelerate nowhere


async def test_an_entry_of_a_withheld_split_says_what_is_told_and_what_is_not(
    lively_site: Any,
) -> None:
    def words(text: str) -> str:
        return " ".join(text.split())

    told = "how a single scene went is not, since that would tell where its hazard lies"
    assert told in words((await lively_site.get("/entries/s0000000kq")).text)
    lively_site.publish_split()
    assert told not in words((await lively_site.get("/entries/s0000000kq")).text)


async def test_what_a_protocol_keeps_of_few_samples_is_said_where_dashes_stand(
    lively_site: Any, lively_board: Board
) -> None:
    said = "Of fewer than 100 samples their number alone is told."
    assert said not in (await lively_site.get("/entries/s0000000kq")).text
    with lively_site.database.write() as session:
        protocol = add_protocol(session, packaged_protocol_toml("1.1-withheld"), "test")
        session.get_one(Phase, "sample").protocol_digest = protocol.digest
    ref = ProtocolRef(version="1.1-withheld", digest=protocol.digest)
    lively_site.publish(lively_board.model_copy(update={"protocol": ref}))
    page = (await lively_site.get("/entries/s0000000kq")).text
    assert f"fewer than 30 samples. {said}" in page


async def test_an_entry_is_cited_by_its_own_paper_and_by_its_board(
    lively_site: Any, lively_board: Board
) -> None:
    page = html.unescape((await lively_site.get("/entries/s0000000kq")).text)
    first = lively_board.entries[0]
    cited = page[page.index("@misc{exceptiondrive-s0000000kq") :]
    cited = cited[: cited.index("</pre>")]
    assert f"url    = {{{first.links.paper}}}" in cited
    assert f"author = {{{{{first.team}}}}}" in cited
    assert "\\url{http://site.test/?phase=sample&board=1}" in cited


def test_a_citation_cannot_be_left_by_what_a_team_writes(lively_board: Board) -> None:
    links = Links(paper="https://x.test/a}\\input{/etc/passwd} b")
    entry = lively_board.entries[0].model_copy(update={"method": "}\n@x{\\y", "links": links})
    cited = entry_bibtex(lively_board, entry, "https://site.test")
    assert cited.count("\n@") == 0
    assert "\\input" not in cited
    assert "https://x.test/a%7D%5Cinput%7B/etc/passwd%7D%20b" in cited
    unlinked = entry.model_copy(update={"links": Links()})
    own = f"url    = {{https://site.test/entries/{entry.submission_id}?phase=sample&board=7}}"
    assert own in entry_bibtex(lively_board, unlinked, "https://site.test")


def test_no_name_ends_a_field_of_a_citation(lively_board: Board) -> None:
    named = {"method": "a}}, author = nobody, note = {{b", "team": "a } b"}
    cited = entry_bibtex(
        lively_board, lively_board.entries[0].model_copy(update=named), "https://s"
    )
    depths = list(accumulate((c == "{") - (c == "}") for c in cited))  # BibTeX minds no backslash
    told = [at for at in range(len(cited)) if cited.startswith("nobody", at)]
    assert [depths[at] for at in told] == [3]
    assert depths[-1] == 0
