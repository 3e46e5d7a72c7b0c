"""A protocol document that is wrong is told line by line: place, what is expected, what stands there."""

import pytest

from exceptiondrive_schemas.protocol import ProtocolError, packaged_protocol_toml, parse_protocol

SE2 = 'name = "cyclist_swerve_in"'


def faults(*changes: tuple[str, str]) -> list[str]:
    toml = packaged_protocol_toml()
    for old, new in changes:
        assert old in toml
        toml = toml.replace(old, new, 1)
    with pytest.raises(ProtocolError) as refused:
        parse_protocol(toml)
    return refused.value.faults


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (
            "d_safe_m = 2.0",
            "d_safe_m = -4.25",
            "tasks.0 (SE1).d_safe_m: should be greater than 0, not -4.25",
        ),
        (
            "d_safe_m = 2.0",
            'd_safe_m = "2.5 m"',
            'tasks.0 (SE1).d_safe_m: should be a valid number, not "2.5 m"',
        ),
        ("d_safe_m = 2.0", "d_safe_m = inf", "tasks.0 (SE1).d_safe_m: should be a finite number,"),
        ("time_step_s = 0.5", "time_step_s = 12:30:00", "geometry.time_step_s: should be a number"),
        ("waypoints = 6", "waypoints = 6.5", "geometry.waypoints: should be a valid integer"),
        ('version = "1.0"', 'version = "next"', "version: should be a version such as 1.1 or"),
        (SE2, 'name = "swerve in!"', "tasks.1 (SE2).name: should be letters, digits and"),
        ('schema = "exc', 'shema = "exc', "shema: is not in a protocol; is schema meant?"),
        ("waypoints = 6", "waypoints = ", "not TOML: Invalid value (at line 10, column"),
        ("waypoints = 6", "waypoints = 6\nwaypoints = 8", "not TOML: Cannot overwrite a value"),
        ("waypoints = 6", f"waypoints = 1{'0' * 5000}", "not a protocol: a number has too many"),
        ('id = "SE2"', 'id = "SE1"', "document: task ids must be unique; repeated: SE1"),
    ],
)
def test_a_problem_names_its_place_what_is_expected_and_what_is_there(
    old: str, new: str, line: str
) -> None:
    assert any(problem.startswith(line) for problem in faults((old, new))), faults((old, new))


def test_a_wrong_unit_is_named_with_what_was_meant() -> None:
    assert faults(("footprint_width_m = 1.85", "footprint_width_cm = 185.0")) == [
        "geometry.footprint_width_m: is missing",
        "geometry.footprint_width_cm: is not in a protocol; is footprint_width_m meant?",
    ]


def test_every_problem_is_told_in_one_pass_and_a_flood_is_cut() -> None:
    assert len(faults(("d_safe_m = 2.0", "d_safe_m = 0"), ("waypoints = 6", "waypoints = 0"))) == 2
    flood = "".join(f"k{number} = 1\n" for number in range(300))
    told = faults(("min_coverage = 0.99", f"min_coverage = 0.99\n{flood}"))
    assert (len(told), told[-1]) == (101, "and 200 more")


def test_what_is_not_toml_at_all_or_nested_without_end_is_told_so() -> None:
    for text, words in (("<html>", "not TOML"), ("a = " + "[" * 5000, "nested too deeply")):
        with pytest.raises(ProtocolError, match=words):
            parse_protocol(text)
