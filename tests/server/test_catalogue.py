"""GET /phases, /splits, /protocols, /tasks, /schemas, /examples, /entries, /me."""

import gzip
import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tokens import SCOPES_OF_ROLE, issue_token
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import find_split, publish_split, register_split
from exceptiondrive_schemas.api.submission import Me, PhaseView
from exceptiondrive_schemas.protocol import packaged_protocol_toml, parse_protocol
from exceptiondrive_schemas.published import DOCUMENT_NAMES
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.taxonomy import Taxonomy

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]


@pytest.fixture
def split_document() -> bytes:
    """A small development split."""
    sample = {
        "sample_id": "s1",
        "scene_id": "scene-1",
        "task": "SE1",
        "region": [[20.0, -1.0], [22.0, -1.0], [22.0, 1.0], [20.0, 1.0]],
    }
    document = {"schema": "exceptiondrive.split/1", "name": "sample", "title": "S"}
    return json.dumps({**document, "samples": [sample]}).encode()


def test_phases_are_public_and_carry_no_quota_without_a_token(api_on_both: "Api") -> None:
    (phase,) = api_on_both.get("/phases").json()
    assert (phase["id"], phase["is_open"], phase["n_samples"]) == ("dev", True, 3)
    assert phase["quota"] is None
    assert phase["max_upload_bytes"] == 64 * 1024


def test_a_phase_carries_the_quota_of_the_asking_team(api: "Api") -> None:
    api.submit("a")
    quotas = {
        who: PhaseView.model_validate_json(api.get("/phases/dev", who).content).quota
        for who in ("alpha", "beta")
    }
    assert quotas["alpha"] is not None
    assert quotas["beta"] is not None
    assert (quotas["alpha"].used_today, quotas["alpha"].remaining_today) == (1, 4)
    assert quotas["beta"].used_today == 0


def test_phases_are_listed_by_challenge(api: "Api") -> None:
    api.phase("words", challenge="strategy")
    assert [phase["id"] for phase in api.get("/phases?challenge=strategy").json()] == ["words"]


def test_a_closed_phase_says_so(api: "Api") -> None:
    api.phase("past", closes_at=datetime.now(UTC) - timedelta(days=1))
    assert api.get("/phases/past").json()["is_open"] is False


def test_an_unknown_phase_is_404(api: "Api", as_problem: Problem) -> None:
    as_problem(api.get("/phases/nowhere"), 404, "not_found")
    as_problem(api.get("/phases/nowhere/manifest"), 404, "not_found")


def test_the_manifest_holds_ids_and_nothing_withheld(api: "Api") -> None:
    response = api.get("/phases/dev/manifest")
    manifest = Manifest.model_validate_json(response.content)
    assert manifest.sample_ids == ("s1", "s2", "s3")
    assert manifest.challenge == api.get("/phases/dev").json()["challenge"] == "planning"
    assert set(response.json()) == {
        "schema", "name", "title", "revision", "waypoints", "time_step_s", "sample_ids", "challenge"
    }  # fmt: skip


def test_a_withheld_split_is_told_so_where_readers_know_of_it_and_else_is_unknown(
    api: "Api", as_problem: Problem
) -> None:
    with api.database.write() as session:
        manifest = find_split(session, "sample").manifest.model_copy(update={"name": "spare"})
        register_split(session, manifest, {"sudden_emergence": 3}, "test")

    def told(name: str) -> str:
        return str(as_problem(api.get(f"/splits/{name}"), 404, "not_found")["detail"])

    assert told("sample") == "There is no file of split 'sample', which is withheld."
    assert told("nothing") == "There is no split 'nothing'."
    assert told("spare") == told("nothing").replace("nothing", "spare"), "no phase uses it"
    with api.database.write() as session:
        for phase in list_phases(session):
            phase.visibility = "hidden"
    assert told("sample") == told("nothing").replace("nothing", "sample")
    revision = "?revision=sha256:" + "0" * 64
    assert told("sample" + revision) == told("nothing" + revision).replace("nothing", "sample")


def test_a_development_split_is_downloaded_whole(api: "Api", split_document: bytes) -> None:
    digest, _ = api.services.files.put_stream([split_document], limit_bytes=10_000)
    with api.database.write() as session:
        publish_split(session, "sample", "sha256:" + "5" * 64, digest, "test")
    response = api.get("/splits/sample")
    assert response.content == split_document
    again = api.get("/splits/sample", headers={"If-None-Match": response.headers["etag"]})
    assert again.headers["vary"] == response.headers["vary"] == "Accept-Encoding"
    assert again.status_code == 304
    assert api.get("/phases/dev").json()["split_is_public"] is True


@pytest.mark.parametrize("accepted", ["gzip", "identity", "", "gzip;q=0"])
def test_a_packed_split_goes_out_packed_to_who_takes_it_and_is_json_to_all(
    api: "Api", split_document: bytes, accepted: str
) -> None:
    digest, _ = api.services.files.put_stream([gzip.compress(split_document)], limit_bytes=10_000)
    with api.database.write() as session:
        publish_split(session, "sample", "sha256:" + "5" * 64, digest, "test")
    answer = api.get("/splits/sample", headers={"Accept-Encoding": accepted})
    assert answer.headers.get("content-encoding") == ("gzip" if accepted == "gzip" else None)
    assert answer.content == split_document
    assert answer.headers["content-type"] == "application/json"
    assert answer.headers["content-disposition"] == 'attachment; filename="sample.json"'
    tag = {"Accept-Encoding": accepted, "If-None-Match": answer.headers["etag"]}
    assert api.get("/splits/sample", headers=tag).status_code == 304


def test_until_a_later_revision_is_in_force_a_split_is_downloaded_as_it_stands(
    api: "Api", split_document: bytes, as_problem: Problem
) -> None:
    """Registered, or even public already: what readers get is what the phase is scored on."""
    later_document = split_document.replace(b'"S"', b'"T"')
    put = api.services.files.put_stream
    before, after = (
        put([data], limit_bytes=10_000)[0] for data in (split_document, later_document)
    )
    first, second = "sha256:" + "5" * 64, "sha256:" + "6" * 64
    with api.database.write() as session:
        publish_split(session, "sample", first, before, "test")
        manifest = find_split(session, "sample").manifest.model_copy(update={"revision": second})
        register_split(session, manifest, {"sudden_emergence": 3}, "test")
    assert api.get("/splits/sample").content == split_document
    with api.database.write() as session:
        publish_split(session, "sample", second, after, "test")
    assert api.get("/splits/sample").content == split_document
    as_problem(api.get(f"/splits/sample?revision={second}"), 404, "not_found")
    with api.database.write() as session:
        for phase in list_phases(session):
            phase.split_revision = second
    assert api.get("/splits/sample").content == later_document


def test_a_public_split_that_no_phase_uses_is_downloaded_as_registered_last(
    api: "Api", split_document: bytes
) -> None:
    digest, _ = api.services.files.put_stream([split_document], limit_bytes=10_000)
    with api.database.write() as session:
        manifest = find_split(session, "sample").manifest.model_copy(update={"name": "spare"})
        register_split(session, manifest, {"sudden_emergence": 3}, "test")
        publish_split(session, "spare", manifest.revision, digest, "test")
    assert api.get("/splits/spare").content == split_document


@pytest.mark.parametrize(
    "how", [{"params": {"format": "toml"}}, {"headers": {"Accept": "application/toml"}}]
)
def test_a_protocol_is_given_as_the_toml_that_was_added(api: "Api", how: dict[str, Any]) -> None:
    response = api.get("/protocols/1.0", **how)
    assert response.headers["content-type"].startswith("application/toml")
    assert response.text == packaged_protocol_toml()


@pytest.mark.parametrize("accepted", ["application/toml;q=0, application/json", "*/*"])
def test_a_protocol_is_json_to_who_does_not_take_toml(api: "Api", accepted: str) -> None:
    response = api.get("/protocols/1.0", headers={"Accept": accepted})
    assert response.headers["content-type"] == "application/json"


def test_a_protocol_is_given_as_json_by_version_or_digest(api_on_both: "Api") -> None:
    (head,) = api_on_both.get("/protocols").json()
    by_version, by_digest = (
        api_on_both.get(f"/protocols/{name}") for name in (head["version"], head["digest"])
    )
    assert by_version.content == by_digest.content
    assert by_version.json()["schema"] == "exceptiondrive.protocol/1"
    assert parse_protocol(packaged_protocol_toml()).digest == head["digest"]
    etag = by_version.headers["etag"]
    assert api_on_both.get("/protocols/1.0", headers={"If-None-Match": etag}).status_code == 304


def test_an_unknown_protocol_is_404(api: "Api", as_problem: Problem) -> None:
    as_problem(api.get("/protocols/9.9"), 404, "not_found")
    as_problem(api.get("/tasks?protocol=9.9"), 404, "not_found")


def test_tasks_are_21_in_six_families(api: "Api") -> None:
    taxonomy = Taxonomy.model_validate_json(api.get("/tasks").content)
    assert (len(taxonomy.tasks), len(taxonomy.families)) == (21, 6)
    assert api.get("/tasks?protocol=1.0").json() == api.get("/tasks").json()


def test_tasks_tell_the_clearance_that_is_required_after_scaling(api: "Api") -> None:
    toml = packaged_protocol_toml("1.0").replace('version = "1.0"', 'version = "1.5"')
    toml = toml.replace("d_safe_scale = 1.0", "d_safe_scale = 1.5")
    with api.database.write() as session:
        digest = add_protocol(session, toml, "test").digest
        for phase in list_phases(session):
            phase.protocol_digest = digest
    told = [task["d_safe_m"] for task in api.get("/tasks?protocol=1.5").json()["tasks"]]
    assert told == [1.5 * task.d_safe_m for task in parse_protocol(toml).tasks]


def test_every_document_has_a_schema_and_an_example(api: "Api") -> None:
    assert api.get("/schemas").json() == list(DOCUMENT_NAMES)
    for name in DOCUMENT_NAMES:
        assert api.get(f"/schemas/{name}").json()["title"]
        assert api.get(f"/examples/{name}").status_code == 200


@pytest.mark.parametrize("name", ["nothing", "__init__", "..%2fproblem", "board.json"])
def test_an_unknown_document_is_404(api: "Api", as_problem: Problem, name: str) -> None:
    as_problem(api.get(f"/schemas/{name}"), 404, "not_found")
    as_problem(api.get(f"/examples/{name}"), 404, "not_found")


def test_an_entry_shows_row_and_published_sheet(api: "Api", make_entry: Callable[..., Any]) -> None:
    own = api.submit("a").json()["id"]
    api.score(own, 0.75)
    api.publish(make_entry("Planner", submission_id=own))
    entry = api.get(f"/entries/{own}").json()
    assert (entry["phase"], entry["board"], entry["entry"]["rank"]) == ("dev", 1, 1)
    assert entry["sheet"]["macro_family"]["hcc"] == 0.75


def test_what_is_on_no_board_is_not_found_in_the_same_words(
    api_on_both: "Api", as_problem: Problem, make_entry: Callable[..., Any]
) -> None:
    scored, waiting = (api_on_both.submit(content).json()["id"] for content in ("a", "b"))
    api_on_both.score(scored)
    api_on_both.publish(make_entry("another", submission_id="x"))
    details = {
        as_problem(api_on_both.get(f"/entries/{name}"), 404, "not_found")["detail"].replace(
            name, "..."
        )
        for name in (scored, waiting, "0" * 16, "x")
    }
    assert len(details) == 1


def test_me_tells_who_the_token_speaks_for(api: "Api") -> None:
    me = Me.model_validate_json(api.get("/me", "alpha").content)
    assert (me.team, me.token_name, me.expires_at) == ("Alpha", "laptop", None)
    assert {"read:own", "submit"} <= set(me.scopes)
    assert "organizer" not in me.scopes
    assert (me.role, me.phases) == (None, ())
    organizer = Me.model_validate_json(api.get("/me", "organizer").content)
    assert (organizer.team, organizer.role, organizer.phases) == (None, "owner", ())
    with api.database.write() as session:
        scopes = SCOPES_OF_ROLE[OrganizerRole.HELPER]
        api.tokens["confined"] = issue_token(
            session, None, "Bob", scopes, actor="test", phases=("dev",)
        )[0]
    confined = Me.model_validate_json(api.get("/me", "confined").content)
    assert (confined.team, confined.role, confined.phases) == (None, "helper", ("dev",))
