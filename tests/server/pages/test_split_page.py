"""The page of a split: made of its datasheet and of the lint, of a revision that readers know of."""

import re
from html.parser import HTMLParser

from tests.server.pages.invented_board import COUNTS, DATASHEET, MANIFEST, N
from tests.server.pages.page_site import Site

from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.splits.splits import find_split, publish_split, register_split
from exceptiondrive_schemas.datasheet import Datasheet, SplitWarning, SplitWarnings
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_server.web.numbers import short_digest


class _Text(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.feed(html)

    def handle_data(self, data: str) -> None:
        self.words += data.split()


def text_of(html: str) -> str:
    return " ".join(_Text(html).words)


async def test_the_page_says_how_the_split_was_made(lively_site: Site) -> None:
    answer = await lively_site.get("/splits/sample")
    text = text_of(answer.text)
    assert answer.status_code == 200
    for words in (
        f"Samples that count {N}",
        "on the road. Hazard regions",
        "The task suits the scene 3,446 19.31 % 17,850",
        "Accepted by review and people 3,181 92.31 % 3,446",
        "Region verified by two people 0 – 0",
        "168 were drawn at random and looked at by people; 163 passed, 97.02 %",
        "93.22 to 98.72 % (Wilson)",
        "2 more were drawn, and wait to be looked at.",
        "Licence of the pictures: CC BY-NC 4.0.",
        "People are numbered anew in each revision.",
        "Krippendorff's alpha over accepted and rejected: 0.714.",
        "is 0.912 on average (median 0.934); corners",
        f"With a recorded path {DATASHEET.n_recorded:,}",
        "Two samples failed the audit, and three regions lay a metre too far.",
        "2: The hazard stands on the pavement.",
        "4: no moving car avoids the region.",
        "CC BY-NC-SA 4.0",
    ):
        assert words in text
    assert answer.text.count("data:image/jpeg;base64,") == 6


async def test_a_revision_before_that_no_board_showed_is_said_to_be_such(lively_site: Site) -> None:
    """What it changes, a reader who saw an earlier one may never have met."""
    assert DATASHEET.changes is not None
    since = f"Since revision {short_digest(DATASHEET.changes.previous)}"
    text = text_of((await lively_site.get("/splits/sample")).text)
    assert f"{since} , which was not shown: the regions of 3 samples change; 2 samples" in text
    with lively_site.database.write() as session:
        held = find_split(session, "sample")
        assert held.changes is not None
        held.changes = held.changes.model_copy(update={"previous": held.revision})
    text = text_of((await lively_site.get("/splits/sample")).text)
    assert f"Since revision {short_digest(MANIFEST.revision)} : the regions of 3 samples" in text


async def test_doubts_are_those_of_the_lint_whatever_the_datasheet_says(lively_site: Site) -> None:
    what = "the same corners stand in several scenes"
    doubt = SplitWarning(code="one_region_in_many_samples", what=what, count=9)
    with lively_site.database.write() as session:
        found = SplitWarnings(found=(doubt,))
        register_split(session, MANIFEST, COUNTS, "test", datasheet=DATASHEET, warnings=found)
    text = text_of((await lively_site.get("/splits/sample")).text)
    assert f"9: {what}." in text
    assert "no moving car avoids" not in text


async def test_what_its_makers_write_leads_to_https_addresses_alone(lively_site: Site) -> None:
    """A link of another scheme could do anything; words in its place lead nowhere."""
    for where in ("javascript:alert(1)", "on request", "https://drives.test/all"):
        told = {"url": where, "licence": "", "licence_url": where}
        words = DATASHEET.words.model_copy(update=told)
        with lively_site.database.write() as session:
            sheet = DATASHEET.model_copy(update={"words": words})
            find_split(session, "sample").datasheet = sheet
        page = (await lively_site.get("/splits/sample")).text
        n_links = page.count(f'href="{where}"')
        assert n_links == (2 if where.startswith("https://") else 0)
        assert text_of(page).count(where) == 2


async def test_the_datasheet_is_an_answer_too(lively_site: Site) -> None:
    answer = await lively_site.get("/api/v1/splits/sample/datasheet")
    assert Datasheet.model_validate_json(answer.content) == DATASHEET


async def test_board_and_protocol_lead_to_it(lively_site: Site) -> None:
    for path in ("/", "/protocols/1.0"):
        assert 'href="/splits/sample"' in (await lively_site.get(path)).text


async def test_a_revision_that_waits_for_its_run_is_nobodys_business(lively_site: Site) -> None:
    """Registered, and no phase stands at it: the page stays, and its address is not found."""
    later = SplitRef(name="sample", revision="sha256:" + "9" * 64)
    manifest = MANIFEST.model_copy(update={"revision": later.revision, "title": "Draft-canary"})
    sheet = DATASHEET.model_copy(update={"revision": later.revision})
    with lively_site.database.write() as session:
        register_split(session, manifest, COUNTS, "test", datasheet=sheet)
    assert "canary" not in (await lively_site.get("/splits/sample")).text
    for path in ("/splits/sample", "/api/v1/splits/sample/datasheet"):
        assert (await lively_site.get(f"{path}?revision={later.revision}")).status_code == 404
        assert (await lively_site.get(f"{path}?revision={MANIFEST.revision}")).status_code == 200


async def test_a_split_without_a_datasheet_has_its_families(lively_site: Site) -> None:
    with lively_site.database.write() as session:
        register_split(session, MANIFEST, COUNTS, "test").datasheet = None
    text = text_of((await lively_site.get("/splits/sample")).text)
    assert "No datasheet lies beside this split" in text
    assert "Sudden Emergence 62 25.83 %" in text
    assert "Two samples failed the audit" in text, "what its words said of the change stays"
    assert (await lively_site.get("/api/v1/splits/sample/datasheet")).status_code == 404


async def test_the_commands_of_a_public_split_read_the_file_that_they_download(
    lively_site: Site,
) -> None:
    lively_site.publish_split()
    text = text_of((await lively_site.get("/splits/sample")).text)
    (name,) = re.findall(r"exceptiondrive split download (\S+)", text)
    assert f"--split {name}.split.json" in text, "what the client calls it where it is told no name"


async def test_the_page_of_a_revision_leads_to_the_file_of_that_revision(lively_site: Site) -> None:
    """By a button, and by a command, which needs to name none that is in force."""
    lively_site.publish_split()
    address = f"/api/v1/splits/sample?revision={MANIFEST.revision}"
    now = (await lively_site.get("/splits/sample")).text
    assert f'href="{address}"' in now
    assert "--revision" not in now
    later = MANIFEST.model_copy(update={"revision": "sha256:" + "9" * 64})
    with lively_site.database.write() as session:
        register_split(session, later, COUNTS, "test")
        publish_split(session, "sample", later.revision, "sha256:" + "6" * 64, "test")
        for phase in list_phases(session):
            phase.split_revision = later.revision
    old = text_of((await lively_site.get(f"/splits/sample?revision={MANIFEST.revision}")).text)
    assert f"split download sample \\ --revision {MANIFEST.revision}" in old


async def test_a_split_that_nobody_uses_is_not_found(lively_site: Site) -> None:
    for path in ("/splits/other", "/splits/other?revision=x", "/api/v1/splits/other/datasheet"):
        assert (await lively_site.get(path)).status_code == 404


async def test_a_phase_on_a_part_leads_to_the_whole(lively_site: Site) -> None:
    """The datasheet is of the whole; that a part of it counts is the phase's business."""
    part = MANIFEST.model_copy(update={"revision": "sha256:" + "7" * 64})
    with lively_site.database.write() as session:
        register_split(session, part, COUNTS, "test", part="public")
        whole = find_split(session, MANIFEST.name, MANIFEST.revision)
        whole.public_revision, whole.private_revision = part.revision, "sha256:" + "8" * 64
        for phase in list_phases(session):
            phase.split_revision = part.revision
    assert MANIFEST.revision in (await lively_site.get("/splits/sample")).text
    answer = await lively_site.get("/api/v1/splits/sample/datasheet")
    assert Datasheet.model_validate_json(answer.content) == DATASHEET
