"""What a new phase has where nothing is said: the advised settings on a withheld split."""

from typing import Any

import pytest
from tests.support.records import add_sample_split

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol, find_protocol
from exceptiondrive_records.splits.splits import find_split, publish_split
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.protocol import (
    NEWEST,
    NEWEST_WITHHELD,
    ProtocolDocument,
    packaged_protocol,
    packaged_protocol_toml,
)


def made(database: Database, *, is_public: bool, **said: Any) -> tuple[Phase, str]:
    with database.write() as session:
        add_sample_split(session)
        if is_public:
            revision = find_split(session, "sample").revision
            publish_split(session, "sample", revision, "sha256:" + "5" * 64, "test")
        new = NewPhase(
            id="next", challenge=ChallengeId("planning"), title="New", split="sample", **said
        )
        phase = create_phase(session, new, actor="test")
        return phase, find_protocol(session, phase.protocol_digest).version


def test_a_withheld_split_has_the_advised_settings(database: Database) -> None:
    phase, version = made(database, is_public=False)
    assert (phase.quota_per_day, phase.quota_total, version) == (1, 20, NEWEST_WITHHELD)


def test_a_public_split_has_the_open_ones(database: Database) -> None:
    phase, version = made(database, is_public=True)
    assert (phase.quota_per_day, phase.quota_total, version) == (3, None, NEWEST)


def test_what_is_said_is_heeded(database: Database) -> None:
    with database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.0"), "test")
    said = {"quota_per_day": 5, "quota_total": None, "protocol": "1.0"}
    phase, version = made(database, is_public=False, **said)
    assert (phase.quota_per_day, phase.quota_total, version) == (5, None, "1.0")


def test_the_last_protocol_of_the_organizers_is_the_usual_one_of_public_splits(
    database: Database,
) -> None:
    with database.write() as session:
        for version in ("1.0", NEWEST_WITHHELD):
            add_protocol(session, packaged_protocol_toml(version), "test")
    assert made(database, is_public=True)[1] == "1.0"


@pytest.mark.parametrize("section", ["geometry", "grading", "ranking", "plausibility", "tasks"])
def test_the_protocol_of_withheld_splits_scores_as_the_newest_does(section: str) -> None:
    newest, withheld = packaged_protocol(NEWEST), packaged_protocol(NEWEST_WITHHELD)
    assert getattr(newest, section) == getattr(withheld, section)


def test_it_shows_no_small_cell_and_nothing_else_is_other() -> None:
    def publication(protocol: ProtocolDocument) -> dict[str, Any]:
        return protocol.publication.model_dump()

    newest, withheld = packaged_protocol(NEWEST), packaged_protocol(NEWEST_WITHHELD)
    assert publication(withheld) == publication(newest) | {"min_samples_per_cell": 100}
