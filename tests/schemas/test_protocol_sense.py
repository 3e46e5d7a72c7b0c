"""What the schema of a protocol allows and nobody can mean is refused, with its place and the reason."""

import pytest

from exceptiondrive_schemas.protocol import (
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.protocols.sense import nonsense

HCC_FIRST = """[[ranking.order.planning]]
metric = "hcc"
order = "descending"
"""
TOML = packaged_protocol_toml("1.1")


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.1-withheld"])
def test_every_protocol_that_ships_is_meant(version: str) -> None:
    assert nonsense(packaged_protocol(version)) == []


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (
            HCC_FIRST,
            HCC_FIRST.replace("descending", "ascending"),
            "ranking.order.planning: ascending puts the worst hcc first; should be descending",
        ),
        (
            HCC_FIRST,
            f"{HCC_FIRST}\n{HCC_FIRST}",
            "ranking.order.planning: hcc stands 2 times; once is enough",
        ),
        (
            "footprint_length_m = 4.084",
            "footprint_length_m = 60.0",
            "geometry.footprint_length_m: no vehicle is 60 m; should be from 0.5 to 55",
        ),
        (
            "footprint_width_m = 1.85",
            "footprint_width_m = 60.0",
            "geometry.footprint_width_m: no vehicle is 60 m; should be from 0.3 to 5",
        ),
        (
            "d_safe_m = 2.0",
            "d_safe_m = 1e-12",
            "tasks.0 (SE1).d_safe_m: 1e-12 m, scaled, is no clearance; should be at least 0.01",
        ),
    ],
)
def test_nonsense_is_named_with_its_place_and_what_it_would_do(
    old: str, new: str, line: str
) -> None:
    assert old in TOML
    assert nonsense(parse_protocol(TOML.replace(old, new, 1))) == [line]


@pytest.mark.parametrize("words", ["", "   "])
def test_a_version_says_what_it_changes(words: str) -> None:
    protocol = packaged_protocol("1.1").model_copy(update={"changes": words})
    assert nonsense(protocol) == ["changes: is empty; say to readers what this version changes"]


def test_a_scale_counts_with_the_clearance() -> None:
    toml = TOML.replace("d_safe_scale = 1.0", "d_safe_scale = 0.0001")
    found = nonsense(parse_protocol(toml))
    assert len(found) == len(packaged_protocol("1.1").tasks)
