"""Protocols, splits, teams and phases: added once, and what is immutable stays."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from pydantic import ValidationError
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError
from tests.support.records import count_audit_lines

from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.phases import phases
from exceptiondrive_records.phases.policy import is_open
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols import protocols
from exceptiondrive_records.splits import splits
from exceptiondrive_records.teams import teams
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.split import Manifest

World = Any
TOML = packaged_protocol_toml()
COUNTS = {"sudden_emergence": 3}


def manifest(revision: str = "sha256:" + "6" * 64, n_samples: int = 3) -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name="sample",
        title="Sample",
        revision=revision,
        waypoints=6,
        time_step_s=0.5,
        sample_ids=tuple(f"s{i}" for i in range(n_samples)),
    )


def test_a_protocol_is_found_by_version_and_by_digest(world: World) -> None:
    with world.database.read() as session:
        assert protocols.find_protocol(session, "1.0") == packaged_protocol()
        assert protocols.find_protocol(session, world.protocol_digest) == packaged_protocol()
        assert protocols.list_protocols(session) == [packaged_protocol()]
        with pytest.raises(NotFound):
            protocols.find_protocol(session, "2.0")


def test_adding_the_same_protocol_again_does_nothing(world: World) -> None:
    with world.database.write() as session:
        protocols.add_protocol(session, "# a remark\n" + TOML, "test")
    with world.database.read() as session:
        assert count_audit_lines(session, "protocol added") == 1


def test_a_version_is_never_given_to_another_content(world: World) -> None:
    other = TOML.replace("min_coverage = 0.99", "min_coverage = 0.5")
    assert other != TOML
    with world.database.write() as session, pytest.raises(Conflict, match="new version"):
        protocols.add_protocol(session, other, "test")


def test_a_document_that_is_no_protocol_is_refused_with_every_reason(world: World) -> None:
    broken = TOML.replace("min_coverage = 0.99", "min_coverage = 2")
    with world.database.write() as session, pytest.raises(InvalidRecord, match="min_coverage"):
        protocols.add_protocol(session, broken, "test")


def test_a_protocol_that_was_edited_in_place_is_refused(world: World) -> None:
    edited = TOML.replace("min_coverage = 0.99", "min_coverage = 0.5")
    with world.database.write() as session:
        if session.get_bind().dialect.name == "sqlite":
            session.execute(text("DROP TRIGGER protocols_no_update"))
        else:
            session.execute(text("ALTER TABLE protocols DISABLE TRIGGER ALL"))
        session.execute(text("UPDATE protocols SET toml = :toml"), {"toml": edited})
    with world.database.read() as session, pytest.raises(Conflict, match="altered"):
        protocols.find_protocol(session, "1.0")


@pytest.mark.parametrize("table", ["protocols", "audit_lines"])
def test_the_database_refuses_to_delete_what_is_append_only(world: World, table: str) -> None:
    refused = pytest.raises(DatabaseError, match=r"append-only|(?i:foreign key)")
    with refused, world.database.write() as session:
        session.execute(text(f"DELETE FROM {table}"))


def test_registering_a_split_again_does_nothing(world: World) -> None:
    with world.database.write() as session:
        first = splits.register_split(session, manifest(), COUNTS, "test")
        assert splits.register_split(session, manifest(), COUNTS, "test") is first
    with world.database.read() as session:
        assert splits.manifest_of(session, "sample") == manifest()  # the one registered last
        assert count_audit_lines(session, "split registered") == 2


def test_a_split_revision_never_changes(world: World) -> None:
    with world.database.write() as session:
        splits.register_split(session, manifest(), COUNTS, "test")
    with world.database.write() as session, pytest.raises(Conflict, match="recorded otherwise"):
        splits.register_split(session, manifest(), {"lane_blockage": 3}, "test")


def test_family_counts_must_add_up(world: World) -> None:
    with world.database.write() as session, pytest.raises(InvalidRecord, match="add up to 2"):
        splits.register_split(session, manifest(), {"lane_blockage": 2}, "test")


def test_publishing_a_split_names_its_file_once(world: World) -> None:
    with world.database.write() as session:
        row = splits.find_split(session, "sample")
        splits.publish_split(session, "sample", row.revision, "sha256:file", "test")
        splits.publish_split(session, "sample", row.revision, "sha256:file", "test")
        assert count_audit_lines(session, "split published") == 0  # chained at the end
        with pytest.raises(Conflict, match="another file"):
            splits.publish_split(session, "sample", row.revision, "sha256:other", "test")
    with world.database.read() as session:
        assert splits.find_split(session, "sample").public_file_digest == "sha256:file"
        assert count_audit_lines(session, "split published") == 1
        view = phases.phase_view(session, phases.find_phase(session, "dev"), max_upload_bytes=1)
        assert view.split_is_public


@pytest.mark.parametrize(("slug", "name"), [("alpha", "New"), ("new", "Alpha")])
def test_team_ids_and_names_are_unique(world: World, slug: str, name: str) -> None:
    with world.database.write() as session, pytest.raises(Conflict, match="already"):
        teams.create_team(session, slug, name, actor="test")


@pytest.mark.parametrize(
    ("slug", "name"), [("A", "x"), ("../x", "x"), ("ok", " "), ("ok", "a\x00")]
)
def test_team_ids_and_names_must_be_fit_to_show(world: World, slug: str, name: str) -> None:
    with world.database.write() as session, pytest.raises(InvalidRecord):
        teams.create_team(session, slug, name, actor="test")


def create_phase(world: World, **changes: Any) -> Phase:
    values = {
        "id": "final",
        "challenge": "planning",
        "title": "Final",
        "split": "sample",
        "protocol": "1.0",
        **changes,
    }
    with world.database.write() as session:
        return phases.create_phase(session, NewPhase(**values), actor="test")


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"id": "dev"}, Conflict),
        ({"id": "No Slug"}, InvalidRecord),
        ({"challenge": "racing"}, ValidationError),
        ({"split": "nope"}, NotFound),
        ({"protocol": "9.9"}, NotFound),
        ({"quota_per_day": 0}, ValidationError),
        ({"quota_total": 0}, ValidationError),
        ({"quota_concurrent": 0}, ValidationError),
        ({"rejected_per_day": 0}, ValidationError),
        ({"title": ""}, ValidationError),
        ({"title": " "}, InvalidRecord),
        ({"title": "x" * 121}, ValidationError),
        ({"description": "x" * 4001}, ValidationError),
        (
            {
                "opens_at": datetime(2026, 1, 2, tzinfo=UTC),
                "closes_at": datetime(2026, 1, 1, tzinfo=UTC),
            },
            InvalidRecord,
        ),
    ],
)
def test_phases_that_make_no_sense_are_refused(
    world: World, changes: dict[str, Any], error: type[Exception]
) -> None:
    with pytest.raises(error):
        create_phase(world, **changes)


def test_a_phase_is_open_from_its_first_moment_until_just_before_its_last(world: World) -> None:
    opens_at = datetime(2026, 1, 1, tzinfo=UTC)
    closes_at = datetime(2026, 2, 1, tzinfo=UTC)
    phase = create_phase(world, opens_at=opens_at, closes_at=closes_at)
    moment = timedelta(microseconds=1)
    times = [opens_at - moment, opens_at, closes_at - moment, closes_at]
    assert [is_open(phase, at) for at in times] == [False, True, True, False]


def test_a_phase_view_carries_the_quota_of_the_asking_team(world: World) -> None:
    create_phase(world, quota_per_day=3, quota_total=2)
    world.submit("file")
    with world.database.read() as session:
        dev, final = phases.list_phases(session)
        view = phases.phase_view(session, dev, max_upload_bytes=16, team_id=world.team_id)
        assert view.quota is not None
        assert (view.protocol, view.n_samples, view.is_open) == ("1.0", 3, True)
        assert (view.quota.used_today, view.quota.remaining_today) == (1, 99)
        limited = phases.phase_view(session, final, max_upload_bytes=16, team_id=world.team_id)
        assert limited.quota is not None
        assert limited.quota.remaining_today == 2
        assert phases.phase_view(session, final, max_upload_bytes=16).quota is None
        assert phases.list_phases(session, "strategy") == []
