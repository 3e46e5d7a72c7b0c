"""An organizer's pages of protocols and runs, from document to rollback, with what each refuses."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sqlalchemy import select, update
from starlette.testclient import TestClient
from tests.records.statements import statements
from tests.rescoring.application import RUNS, SITE, Visitor, application_over

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work.tables import Job, WorkState

Stage = Any
Make = Callable[..., str]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


@pytest.fixture
def visit(stage: Stage) -> Iterator[Callable[[str], Visitor]]:
    """Opens a browser as organizer or as team Alpha."""
    with stage.database.write() as session:
        alpha = find_team(session, "alpha").id
        tokens = {
            "alpha": issue_token(session, alpha, "laptop", actor="test")[0],
            "organizer": issue_token(session, None, "Olga", ORGANIZER_SCOPES, actor="test")[0],
        }
    with TestClient(application_over(stage), base_url=SITE, follow_redirects=False) as client:
        yield lambda who: Visitor(client, tokens[who])


def test_an_update_goes_from_document_to_rollback_over_the_pages(
    stage: Stage, visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    organizer = visit("organizer")
    toml = make_protocol("1.1", *D_SAFE)
    checked = organizer.document(toml, "check").text
    assert "required clearance" in checked
    assert "4.5 m" in checked
    assert "regrade only, 3 sheets" in checked
    assert "`changes`" not in checked
    assert "<code>changes</code> still says what it said in 1.0" in checked
    assert organizer.document(toml, "add").headers["location"].endswith("done=protocol_added")
    run_id = organizer.draft()
    here = f"{RUNS}/{run_id}"
    assert "nothing is scored until you start it" in organizer.get(here).text
    early = organizer.get(f"{here}/preview")
    assert (early.status_code, f'href="{here}/start"' in early.text) == (409, True)
    assert "<b>Refused.</b> There is nothing to compare yet." in " ".join(early.text.split())
    assert organizer.step(run_id, "start").status_code == 303
    stage.work()
    before = stage.board()
    preview = organizer.get(f"{here}/preview").text
    assert "What readers would see change" in preview
    assert f"rescore apply {run_id} --preview sha256:" in preview
    assert '▼</span> <span class="vh">worse</span>' in " ".join(preview.split())
    csv = organizer.get(f"{here}/preview.csv")
    assert len(csv.text.splitlines()) == 4
    assert "attachment" in csv.headers["content-disposition"]
    digest = organizer.seen_digest(run_id)
    assert organizer.get(f"{here}/preview.json").json()["digest"] == digest
    wrong = organizer.step(run_id, "apply", preview="sha256:0").text
    assert "stale: submissions or boards have changed since, or it is none of this run" in wrong
    assert stage.board() == before
    assert organizer.get(f"{here}/apply").headers["location"] == f"{here}/preview"
    applied = organizer.step(run_id, "apply", preview=digest)
    assert (applied.status_code, stage.board() != before) == (303, True)
    words = "applied; close it, or, unless the board is frozen, roll it back."
    assert words in organizer.get(here).text
    again = "The run is applied already; it can be applied only while it is scoring or ready."
    page = organizer.get(f"{here}/apply?preview={digest}").text
    assert f"This would be refused now.</b> {again}" in page
    assert again in organizer.step(run_id, "apply", preview=digest).text
    (score_before, score_now) = _scores(
        organizer.get(f"/organize/submissions/{stage.submitted[0]}").text
    )
    assert score_before != score_now, "each scoring says what it came to"
    told = organizer.get(f"/organize/submissions/{stage.submitted[0]}").text
    assert re.search(r"HCC [\d.]+ %[^;]* before; rank \d", told), (
        "the numbers that its team was told"
    )
    preview = organizer.get(f"{here}/preview").text
    assert "What a rollback would change" in preview
    assert (f"rescore rollback {run_id} --reason" in preview, "rescore apply" in preview) == (
        True,
        False,
    )
    rolled = organizer.step(run_id, "rollback")
    assert (rolled.status_code, stage.board() == before) == (303, True)
    preview = organizer.get(f"{here}/preview").text
    assert not re.search("rescore (apply|rollback)", preview), (
        "what would be refused is not advised"
    )
    with stage.database.read() as session:
        query = select(AuditLine).where(AuditLine.subject == run_id).order_by(AuditLine.id)
        lines = [
            (line.action, line.detail.get("reason"), line.actor[:6])
            for line in session.scalars(query)
            if line.action != "rescoring ready"
        ]
    assert lines == [
        ("rescoring drafted", "pedestrians need more room", "token:"),
        ("rescoring started", "because", "token:"),
        ("rescoring applied", "because", "token:"),
        ("rescoring rolled back", "because", "token:"),
    ]
    assert "Olga" in organizer.get(here).text


def _scores(page: str) -> list[str]:
    """The scores of all scorings that the page of a submission names, in their order."""
    return re.findall(r'data-k="score">(HCC [^<]+)<', page)


def test_revisions_of_a_split_are_told_apart_where_one_is_chosen(
    stage: Stage, visit: Callable[[str], Visitor], make_split: Callable[..., Any]
) -> None:
    revision = stage.put_split(make_split(7.0))
    page = visit("organizer").get(f"{RUNS}/new").text
    options = re.findall(r'<option value="(sha256:\w+)"[^>]*>\s*([^<]+?)\s*<', page)
    words = dict(options)[revision]
    assert re.match(r"tiny of \d{4}-\d\d-\d\d \d\d:\d\d UTC, 4 samples", words), words
    in_force = [value for value, told in options if "now in force in " in told]
    assert len(in_force) == 1
    assert in_force[0] != revision


def test_each_step_of_a_run_is_offered_asked_for_and_refused_in_words(
    stage: Stage, visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    organizer = visit("organizer")
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = organizer.draft()
    here = f"{RUNS}/{run_id}"
    assert organizer.get(f"{here}/preview").status_code == 409
    wanted = {"phase": "dev", "protocol": "1.1", "reason": "twice"}
    again = organizer.post(f"{RUNS}/new", wanted)
    assert (again.status_code, "open run" in again.text, "twice" in again.text) == (409, True, True)
    organizer.step(run_id, "start")
    stage.work(most=1)
    page = organizer.get(here).text
    assert "1 of 3 sheets" in page
    assert "still missing" in page
    assert "data-again-s" in page
    assert 'http-equiv="refresh"' in page
    organizer.step(run_id, "pause")
    assert "The run is paused: resume it" in organizer.get(f"{here}/apply?preview=x").text
    refused = organizer.step(run_id, "apply", preview="x")
    assert (refused.status_code, "paused: resume it" in refused.text) == (409, True)
    bare = organizer.step(run_id, "resume", reason=" ")
    assert (bare.status_code, "must not be empty" in bare.text) == (400, True)
    assert "Try failed sheets again" not in organizer.get(here).text
    organizer.step(run_id, "resume")
    assert stage.view(run_id).state.value == "scoring"
    with stage.database.write() as session:
        waiting = Job.state == WorkState.QUEUED
        session.execute(update(Job).where(waiting).values(state=WorkState.FAILED))
    assert "Try failed sheets again" in organizer.get(here).text
    assert "public board never changed" in organizer.get(f"{here}/cancel").text
    organizer.step(run_id, "cancel")
    assert stage.view(run_id).state.value == "cancelled"
    assert organizer.step(run_id, "no-such-step").status_code == 404
    assert organizer.get(f"{RUNS}/no-such-run").status_code == 404


def test_a_document_that_is_refused_stays_in_the_form(
    visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    organizer = visit("organizer")
    broken = make_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = -4.25  # </textarea><b>")
    page = organizer.document(broken, "add")
    assert page.status_code == 400
    assert "tasks.0" in page.text
    assert "d_safe_m = -4.25  # &lt;/textarea&gt;&lt;b&gt;" in page.text
    taken = organizer.document(make_protocol("1.0", *D_SAFE), "check")
    assert (taken.status_code, "give the new content a new version" in taken.text) == (409, True)
    assert "There is no document" in organizer.document(" ", "check").text
    filed = organizer.document(
        "not this", "check", files={"file": ("new.toml", make_protocol("1.2", *D_SAFE).encode())}
    )
    assert "Protocol 1.2 is valid" in filed.text
    wild = organizer.document("kept", "check", files={"file": ("new.toml", b"\xff\xfe")})
    assert "not UTF-8" in wild.text
    assert ">\nkept</textarea>" in wild.text


def test_a_protocol_form_from_elsewhere_is_refused(
    visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    organizer = visit("organizer")
    form = {"toml": make_protocol("1.1", *D_SAFE), "do": "add"}
    for headers in ({"Origin": SITE}, {"Origin": "https://evil.test"}):
        answer = organizer.client.post("/organize/protocols/new", data=form, headers=headers)
        assert answer.status_code == 403
    assert "1.1" not in re.findall(
        r"/protocols/(1\.\d)\"", organizer.get("/organize/protocols").text
    )


def test_a_phase_made_like_another_has_the_split_revision_that_stands(
    stage: Stage, visit: Callable[[str], Visitor], make_split: Callable[..., Any]
) -> None:
    organizer = visit("organizer")
    later = stage.put_split(make_split(7.0))
    stage.put_split(make_split(), "split-old.json")
    form = organizer.get("/organize/phases/new?like=dev").text
    with stage.database.read() as session:
        stands = session.get_one(Phase, "dev").split_revision
    assert re.findall(r'<option value="(sha256:\w+)" selected>', form) == [stands]
    assert f'<option value="{later}">' in form
    texts = re.findall(r'<input name="(\w+)"[^>]*value="([^"]*)"', form)
    choices = re.findall(r'<select name="(\w+)"[^>]*>(?:(?!</select>).)*"([^"]*)" selected', form)
    numbers = {"quota_per_day": "3", "rejected_per_day": "9"}
    made = {**dict(texts), **dict(choices), **numbers, "id": "next"}
    page = "/organize/phases/new"
    answer = organizer.post(page, made, page=page)
    assert answer.status_code == 303, answer.text
    with stage.database.read() as session:
        assert session.get_one(Phase, "next").split_revision == stands


def test_sheets_are_verified_from_a_page(stage: Stage, visit: Callable[[str], Visitor]) -> None:
    organizer = visit("organizer")
    form = {"phase": "dev", "sample": "2", "reason": "before the deadline"}
    answer = organizer.post("/organize/verifications/new", form)
    address = answer.headers["location"]
    assert "Recomputing" in organizer.get(address).text
    stage.verify_all()
    assert "Every sheet came out the same" in organizer.get(address).text
    answer = organizer.post("/organize/verifications/new", form)
    address, _, _ = answer.headers["location"].partition("?")
    cancel = address.replace("verifications", "rescoring") + "/cancel"
    organizer.post(cancel, {"reason": "another day"})
    cancelled = organizer.get(address).text
    assert "Cancelled: 0 of 2 were compared" in cancelled
    assert "came out the same" not in cancelled
    wrong = organizer.post("/organize/verifications/new", {**form, "sample": "-1"})
    assert (wrong.status_code, "before the deadline" in wrong.text) == (400, True)


def test_no_page_of_the_organizers_tells_a_value_of_a_sample_or_opens_to_a_team(
    stage: Stage, visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    organizer = visit("organizer")
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    paths = [
        "/organize",
        "/organize/submissions",
        f"/organize/submissions/{stage.submitted[0]}",
        "/organize/protocols",
        "/organize/protocols/new",
        RUNS,
        f"{RUNS}/{run_id}",
        f"{RUNS}/{run_id}/preview",
        f"{RUNS}/{run_id}/preview.csv",
        f"{RUNS}/{run_id}/preview.json",
        f"{RUNS}/{run_id}/apply?preview=x",
        "/organize/audit",
    ]
    folders = (str(stage.settings.splits_dir), str(stage.settings.private_dir))
    secrets = ("scene-SE1", "scene-LB1", "scene_id", "clearance_m", "10.0, -1.0", *folders)
    for path in paths:
        answer = organizer.get(path)
        assert answer.status_code == 200, path
        assert len(answer.content) < 150_000, path
        for withheld in secrets:
            assert withheld not in answer.text, (path, withheld)
    alpha = visit("alpha")
    for path in paths:
        assert alpha.get(path).status_code == 403, path


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_the_list_of_runs_asks_for_the_newest_and_leads_to_all(
    stage: Stage, visit: Callable[[str], Visitor], make_protocol: Make
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    organizer = visit("organizer")
    database = organizer.client.app.state.services.database  # type: ignore[attr-defined]
    older = f'href="{RUNS}?all_runs=true"'
    asked = []
    for number in (21, 4):
        for _ in range(number):
            stage.step("cancel", stage.draft(protocol="1.1"))
        with statements(database) as sent:
            page = organizer.get(RUNS).text
        asked.append(sum("FROM protocols" in one for one in sent))  # of each run that is shown
        assert (page.count('class="pbar'), older in page) == (20, True)
    assert asked[0] == asked[1]
    every = organizer.get(f"{RUNS}?all_runs=true").text
    assert (every.count('class="pbar'), older in every) == (25, False)
