"""What changes from one protocol to another, in plain words."""

import pytest

from exceptiondrive_schemas.protocol import (
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.protocols.difference import (
    Difference,
    Stage,
    protocol_difference,
    split_changes,
)
from exceptiondrive_schemas.split import Manifest


def difference(old: str, new: str, n_sheets: int = 1240) -> Difference:
    toml = packaged_protocol_toml()
    assert old in toml
    return protocol_difference(
        packaged_protocol(), parse_protocol(toml.replace(old, new, 1)), n_sheets
    )


@pytest.mark.parametrize(
    ("old", "new", "sentence", "stage"),
    [
        (
            "d_safe_m = 2.0",
            "d_safe_m = 2.5",
            "required clearance of task SE1 (occluded pedestrian) 2.0 -> 2.5 m",
            Stage.GRADE,
        ),
        (
            "footprint_width_m = 1.85",
            "footprint_width_m = 1.95",
            "footprint width 1.85 -> 1.95 m",
            Stage.MEASURE,
        ),
        (
            "flag_blind",
            "first_step_from_mps = 3.0\nflag_blind",
            "first step from 2.0 -> 3.0 m/s",
            Stage.GRADE,
        ),
        (
            "d_safe_scale = 1.0",
            "d_safe_scale = 1.2",
            "factor of every required clearance 1.0 -> 1.2",
            Stage.GRADE,
        ),
        ("min_coverage = 0.99", "min_coverage = 0.9", "min coverage 0.99 -> 0.9", Stage.RANK),
        (
            "D = 3, C = 4",
            "D = 5, C = 9",
            "strategies from least to most cautious: as before, with other numbers",
            Stage.GRADE,
        ),
        (
            "percent_decimals = 2",
            "percent_decimals = 1",
            "percent decimals 2 -> 1",
            Stage.PUBLICATION,
        ),
    ],
)
def test_a_change_is_one_sentence_with_the_stage_it_repeats(
    old: str, new: str, sentence: str, stage: Stage
) -> None:
    found = difference(old, new)
    assert found.sentences == (sentence,)
    assert (found.stage, found.changes[0].stage) == (stage, stage)
    assert found.n_sheets == 1240


def test_a_new_order_of_caution_names_ties_and_order() -> None:
    old = packaged_protocol()
    ranks = {"A": 0, "B": 0, "C": 4, "D": 2, "E": 3}
    grading = old.grading.model_copy(update={"caution": ranks})
    found = protocol_difference(old, old.model_copy(update={"grading": grading}), 2)
    assert found.sentences == (
        "strategies from least to most cautious: A < B < E < D < C -> A = B < D < E < C",
    )
    assert found.sentence == "regrade only, 2 sheets"


def test_strategies_that_become_acceptable_are_told_with_what_follows() -> None:
    old = 'acceptable = ["C", "D"]\nunder_warning = ["A", "B", "E"]'
    new = 'acceptable = ["B", "C", "D"]\nunder_warning = ["A"]'
    assert difference(old, new).sentences == (
        "acceptable strategies of task SE1 (occluded pedestrian): C, D -> B, C, D",
        "under-warning strategies of task SE1 (occluded pedestrian): A, B, E -> A",
    )
    first = old.replace('["A", "B", "E"]', "[]").replace('["C", "D"]', '["A", "C", "D"]')
    assert "A, B, E -> none" in difference(old, first).sentences[1]


def test_the_summary_names_work_and_sheets() -> None:
    assert difference("d_safe_m = 2.0", "d_safe_m = 2.5").sentence == "regrade only, 1,240 sheets"
    assert difference("min_coverage = 0.99", "min_coverage = 0.9", 1).sentence == (
        "rank again only, 1 sheet"
    )


def test_another_version_of_the_same_content_repeats_nothing() -> None:
    found = difference('version = "1.0"', 'version = "1.1"')
    assert (found.changes, found.stage, found.n_sheets) == ((), Stage.NONE, 0)
    assert found.sentence == "nothing to recompute: every number stays"


@pytest.mark.parametrize(
    ("version", "is_earlier"),
    [
        ("0.9", True),
        ("0.9-draft", True),
        ("1.0-withheld", False),
        ("1.0.1", False),
        ("1.10", False),
        ("2.0-draft", False),
    ],
)
def test_an_earlier_version_is_remarked(version: str, is_earlier: bool) -> None:
    remark = difference('version = "1.0"', f'version = "{version}"').remark or ""
    assert remark.startswith(f"{version} is an earlier version than 1.0") is is_earlier


def test_other_waypoints_are_remarked_since_no_accepted_file_has_them() -> None:
    remark = difference("waypoints = 6", "waypoints = 8").remark or ""
    assert "hold 6 waypoints 0.5 s apart and cannot be scored under it" in remark


def test_changes_that_still_say_what_they_said_are_remarked() -> None:
    told = difference("d_safe_m = 2.0", "d_safe_m = 2.5").remark
    assert told == "`changes` still says what it said in 1.0"
    assert difference('changes = "First', 'changes = "Not the first').remark is None


def test_a_title_that_still_names_the_earlier_version_is_remarked() -> None:
    told = difference('version = "1.0"', 'version = "1.1"').remark or ""
    assert told.endswith("; the title is still ExceptionDrive 1.0")
    one = 'version = "1.0"\ntitle = "ExceptionDrive 1.0"'
    remark = difference(one, one.replace("1.0", "1.1")).remark or ""
    assert "title" not in remark


def test_a_new_rank_order_is_told_as_an_order() -> None:
    found = difference('metric = "hcc"\norder = "descending"', 'metric = "ur"\norder = "ascending"')
    (sentence,) = found.sentences
    assert sentence == (
        "entries of the planning challenge are ranked by hcc (highest first), then ur (lowest "
        "first) -> ur (lowest first), then ur (lowest first)"
    )


def test_the_heaviest_stage_of_several_counts() -> None:
    toml = packaged_protocol_toml().replace("d_safe_m = 2.0", "d_safe_m = 2.5", 1)
    both = parse_protocol(toml.replace("footprint_width_m = 1.85", "footprint_width_m = 2.0"))
    assert protocol_difference(packaged_protocol(), both, 3).stage is Stage.MEASURE


def manifest(revision: str, *ids: str) -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name="tiny",
        title="Tiny",
        revision="sha256:" + revision * 64,
        waypoints=6,
        time_step_s=0.5,
        sample_ids=ids,
    )


def test_a_split_revision_is_told_without_naming_a_sample() -> None:
    old, new = manifest("1", "a", "b"), manifest("2", "b", "c", "d")
    sentences = [change.sentence for change in split_changes(old, new)]
    assert sentences == ["the split gains 2 samples", "the split loses 1 sample"]
    (same,) = split_changes(old, manifest("3", "a", "b"))
    assert "regions, tasks or scenes change" in same.sentence
    assert split_changes(old, old) == ()
