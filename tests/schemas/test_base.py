"""What every document keeps: its digests follow its fields."""

from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.protocol import packaged_protocol


def test_a_copy_derives_its_digests_anew() -> None:
    protocol = packaged_protocol()
    before = (protocol.digest, protocol.ranking_digest)
    copied = protocol.model_copy(update={"version": "9.9"})
    assert copied.digest != before[0]
    assert copied.digest == content_digest(copied)
    assert copied.ranking_digest == before[1], "no section of ranking was changed"


def test_what_was_derived_is_no_part_of_the_document() -> None:
    protocol = packaged_protocol()
    fresh = type(protocol).model_validate_json(protocol.model_dump_json(by_alias=True))
    assert protocol.digest
    assert protocol == fresh
    assert protocol.model_dump(mode="json") == fresh.model_dump(mode="json")
