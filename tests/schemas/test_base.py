"""What every document keeps: its digests follow its fields."""

import subprocess
import sys

import pytest

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.check.rules import RULES
from exceptiondrive_schemas.protocol import (
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)


def test_a_copy_derives_its_digests_anew() -> None:
    toml = packaged_protocol_toml()
    protocol = parse_protocol(toml)
    before = (protocol.digest, protocol.ranking_digest)
    copied = protocol.model_copy(update={"version": "9.9"})
    assert copied.digest != before[0]
    assert (
        copied.digest == parse_protocol(toml.replace('version = "1.0"', 'version = "9.9"')).digest
    )
    assert copied.ranking_digest == before[1], "no section of ranking was changed"


def test_what_was_derived_is_no_part_of_the_document() -> None:
    protocol = packaged_protocol()
    fresh = type(protocol).model_validate_json(protocol.model_dump_json(by_alias=True))
    assert protocol.digest
    assert protocol == fresh
    assert protocol.model_dump(mode="json") == fresh.model_dump(mode="json")


@pytest.mark.parametrize(
    "module", ["exceptiondrive_schemas.challenges", "exceptiondrive.cli.tables"]
)
def test_whatever_is_imported_first_every_challenge_is_known(module: str) -> None:
    script = f"import {module}\nfrom exceptiondrive_schemas.challenges import CHALLENGES as known\n"
    command = [sys.executable, "-c", f"{script}print(*known)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == list(CHALLENGES) == list(RULES)
