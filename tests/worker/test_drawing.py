"""Drawings: of public splits, from the scoring code's own geometry; never of a withheld split."""

import contextlib
import json
import sqlite3
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sqlalchemy import select, text
from sqlalchemy.exc import IntegrityError

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.drawings import (
    PublicSplit,
    entry_drawings,
    find_public_split,
    keep_entry_drawings,
    protocol_drawing,
)
from exceptiondrive_records.splits.tables import EntryDrawingsRow, ProtocolDrawingRow
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.drawing import EntryDrawings, packaged_drawing, pictured_digest
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml, parse_protocol
from exceptiondrive_schemas.split import Split, SplitRef
from exceptiondrive_scoring.clearance import clearance_m
from exceptiondrive_scoring.drawing import protocol_drawing as draw_made_up
from exceptiondrive_scoring.footprint import footprints_m
from exceptiondrive_scoring.region import prepare_regions
from exceptiondrive_worker.drawing import WithheldSplitError, drawings_of, packaged_drawing_text
from exceptiondrive_worker.splits.admin import publish_split_file
from exceptiondrive_worker.stages import Target

World = Any
MakeFile = Callable[..., bytes]
pytestmark = pytest.mark.publishes_regions  # the tests of withheld splits have their own canary
CANARY_M = 23.719413
NEEDLE = "23.7194"
"""A coordinate of a withheld region, and how it begins however it is rounded."""


@pytest.fixture
def canary_split(make_split: Callable[..., Split]) -> Split:
    region = ((CANARY_M, -1.0), (26.0, -1.0), (26.0, 1.0), (CANARY_M, 1.0))
    return make_split({key: {"region": region} for key in ("a", "b", "c")})


def publish(world: World, protocol: ProtocolDocument) -> None:
    publish_split_file(
        world.database, world.files, world.context.splits, "tiny", protocol, while_open=True
    )


def kept(
    world: World, submission_id: str, split: Split, protocol: ProtocolDocument
) -> EntryDrawings:
    with world.database.read() as session:
        found = entry_drawings(session, submission_id, protocol.digest, split.revision)
    assert found is not None
    return found


def everything_recorded(world: World) -> str:
    with world.database.engine.connect() as connection:
        return "\n".join(
            repr(tuple(row))
            for table in Base.metadata.sorted_tables
            for row in connection.execute(text(f'SELECT * FROM "{table.name}"'))
        )


def n_rows(world: World, table: type[Base]) -> int:
    with world.database.read() as session:
        return len(list(session.scalars(select(table))))


def test_entries_of_a_public_split_are_drawn_once_with_the_board(
    world: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny)
    publish(world, protocol)
    submission_id = world.score(planning_file(tiny, edited_mps=1.0))
    world.build_board()
    world.build_board()
    assert n_rows(world, EntryDrawingsRow) == 1
    samples = kept(world, submission_id, tiny, protocol).samples
    assert {each.drawing.family for each in samples} == {
        protocol.taxonomy.task(sample.task).family for sample in tiny.samples
    }
    # families of one or two samples have no middle one
    assert {each.chosen_as for each in samples} == {"scene", "worst"}
    for each in samples:
        corners = [coordinate for corner in each.drawing.region for coordinate in corner]
        true = [coordinate for corner in tiny.samples[0].region for coordinate in corner]
        assert corners == pytest.approx(true, abs=1e-4)
        assert len(each.drawing.footprints) == 7


def test_the_worst_and_the_middle_of_a_family_are_those_of_the_stated_order(
    world: World,
    make_split: Callable[..., Split],
    planning_file: MakeFile,
    protocol: ProtocolDocument,
) -> None:
    split = make_split({key: {} for key in "abcde"})
    ends = {"a": 1.0, "b": 1.5, "c": 4.0, "d": 2.0, "e": None}
    changes = {
        key: {"edited": None if v is None else [[v * k * 0.5, 0.0] for k in range(1, 7)]}
        for key, v in ends.items()
    }
    world.add_phase(split)
    publish(world, protocol)
    submission_id = world.score(planning_file(split, changes=changes))
    world.build_board()
    chosen = kept(world, submission_id, split, protocol).samples
    assert [(each.chosen_as, each.drawing.sample_id) for each in chosen] == [
        ("scene", "c"),  # of a to e: their regions are equally far away
        ("worst", "c"),  # drives into the region; e gave no answer and cannot be drawn
        ("middle", "b"),  # of c, d, b, a
    ]
    assert chosen[1].drawing.segment is None
    assert chosen[1].drawing.metrics["hcc"] == 0.0


def test_the_scene_of_a_family_is_the_same_for_every_entry_whether_it_answered_or_not(
    world: World,
    make_split: Callable[..., Split],
    planning_file: MakeFile,
    protocol: ProtocolDocument,
) -> None:
    def box(x: float) -> dict[str, Any]:
        return {"region": ((x, -1.0), (x + 2, -1.0), (x + 2, 1.0), (x, 1.0))}

    split = make_split({"a": box(30.0), "b": box(10.0), "c": box(20.0)})
    world.add_phase(split)
    publish(world, protocol)
    answered = world.score(planning_file(split, edited_mps=9.0), method="answered")
    silent = planning_file(split, changes={"c": {"edited": None}})
    left_out = world.score(silent, method="left out")
    world.build_board()
    scenes = [
        each.drawing
        for submission_id in (answered, left_out)
        for each in kept(world, submission_id, split, protocol).samples
        if each.chosen_as == "scene"
    ]
    assert [scene.sample_id for scene in scenes] == ["c", "c"]  # neither the near nor the far one
    assert (len(scenes[0].edited), len(scenes[0].clearances_m)) == (7, 7)
    assert (scenes[1].edited, scenes[1].clearances_m) == ((), ())


def test_a_drawn_trajectory_is_that_of_its_sample_where_some_samples_do_not_count(
    world: World,
    make_split: Callable[..., Split],
    planning_file: MakeFile,
    protocol: ProtocolDocument,
) -> None:
    split = make_split({"a": {"control": True}, "b": {"withdrawn": "blurred"}, "c": {}, "d": {}})
    ends = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 0.5}
    changes = {key: {"edited": [[v * k, 0.0] for k in range(1, 7)]} for key, v in ends.items()}
    world.add_phase(split)
    publish(world, protocol)
    submission_id = world.score(planning_file(split, changes=changes))
    world.build_board()
    for each in kept(world, submission_id, split, protocol).samples:
        assert each.drawing.sample_id in ("c", "d")
        assert each.drawing.edited[-1][0] == pytest.approx(6 * ends[each.drawing.sample_id])


def test_the_clearance_at_each_time_step_is_what_the_scorer_measures_of_what_was_driven_until_then(
    world: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny)
    publish(world, protocol)
    submission_id = world.score(planning_file(tiny, edited_mps=9.0))
    world.build_board()
    n_hits = 0
    for each in kept(world, submission_id, tiny, protocol).samples:
        sample = each.drawing
        path, region = np.array([sample.edited]), prepare_regions(np.array([sample.region]))
        assert len(sample.clearances_m) == 7
        for step in range(1, 7):
            cut = clearance_m(path[:, : step + 1], region, protocol.geometry)[0]
            assert sample.clearances_m[step] == pytest.approx(cut, abs=1e-9)
        assert sample.clearances_m[-1] == pytest.approx(sample.clearance_m, abs=1e-9)
        assert list(sample.clearances_m) == sorted(sample.clearances_m, reverse=True)
        n_hits += sample.clearances_m[-1] == 0
    assert n_hits > 0  # some of it is a hit, which starts after t = 0


def test_among_equally_compliant_samples_the_nearest_is_the_worst(
    world: World,
    make_split: Callable[..., Split],
    planning_file: MakeFile,
    protocol: ProtocolDocument,
) -> None:
    split = make_split({key: {} for key in "abc"})
    ends = {"a": 0.5, "b": 0.9, "c": 0.7}
    changes = {
        key: {"edited": [[v * k * 0.5, 0.0] for k in range(1, 7)]} for key, v in ends.items()
    }
    world.add_phase(split)
    publish(world, protocol)
    submission_id = world.score(planning_file(split, changes=changes))
    world.build_board()
    chosen = kept(world, submission_id, split, protocol).samples
    own = [each.drawing for each in chosen if each.chosen_as != "scene"]
    assert [(drawing.sample_id, drawing.metrics["hcc"]) for drawing in own] == [
        ("b", 1.0),
        ("c", 1.0),
    ]


def test_a_drawing_says_what_the_scorer_measured(
    world: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny)
    publish(world, protocol)
    submission_id = world.score(planning_file(tiny, edited_mps=2.0))
    world.build_board()
    sample = kept(world, submission_id, tiny, protocol).samples[0].drawing
    path = np.array([sample.edited])
    boxes = footprints_m(path, protocol.geometry)[0]
    assert np.allclose(np.array(sample.footprints), boxes, atol=1e-4)
    exact = clearance_m(path, prepare_regions(np.array([sample.region])), protocol.geometry)[0]
    assert sample.clearance_m == pytest.approx(exact, abs=1e-9)
    assert sample.segment is not None
    assert np.hypot(*np.subtract(*sample.segment)) == pytest.approx(exact, abs=3e-4)


def test_nothing_of_a_withheld_split_is_drawn(
    world: World, canary_split: Split, planning_file: MakeFile
) -> None:
    world.add_phase(canary_split)
    world.score(planning_file(canary_split))
    world.build_board()
    assert n_rows(world, EntryDrawingsRow) == 0
    assert NEEDLE not in everything_recorded(world)


def test_the_search_finds_the_canary_once_the_split_is_public(
    world: World, canary_split: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(canary_split)
    world.score(planning_file(canary_split))
    publish(world, protocol)
    world.build_board()
    assert NEEDLE in everything_recorded(world)


def test_the_worker_refuses_to_draw_a_split_that_is_not_the_public_one(
    world: World, canary_split: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(canary_split)
    submission_id = world.score(planning_file(canary_split))
    loaded = world.context.splits.find("tiny", canary_split.revision, protocol)
    challenge = PLANNING
    target = Target(world.submission(submission_id).file_digest, challenge, loaded, protocol)
    other = PublicSplit(SplitRef(name="tiny", revision="sha256:" + "0" * 64), "sha256:" + "1" * 64)
    with pytest.raises(WithheldSplitError, match="not public"):
        drawings_of(world.context.stages, other, target)


def test_the_database_refuses_drawings_of_a_withheld_split(
    make_world: Callable[..., World],
    database_url: str,
    canary_split: Split,
    planning_file: MakeFile,
    protocol: ProtocolDocument,
) -> None:
    world = make_world(database_url)
    world.add_phase(canary_split)
    submission_id = world.score(planning_file(canary_split))
    ref = SplitRef(name="tiny", revision=canary_split.revision)
    with world.database.read() as session:
        assert find_public_split(session, ref) is None
    forged = PublicSplit(ref, "sha256:" + "1" * 64)
    with pytest.raises(IntegrityError), world.database.write() as session:
        keep_entry_drawings(
            session, submission_id, protocol.digest, forged, EntryDrawings(samples=())
        )
    publish(world, protocol)
    with world.database.write() as session:
        found = find_public_split(session, ref)
        assert found is not None
        keep_entry_drawings(
            session, submission_id, protocol.digest, found, EntryDrawings(samples=())
        )
    assert n_rows(world, EntryDrawingsRow) == 1


def test_a_drawing_whose_split_is_withheld_again_by_hand_is_reported(
    world: World, tiny: Split, planning_file: MakeFile, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny)
    publish(world, protocol)
    submission_id = world.score(planning_file(tiny))
    world.build_board()
    with world.database.read() as session:
        assert violations(session) == []
    withhold = "UPDATE splits SET public_file_digest = NULL"
    with pytest.raises(IntegrityError), world.database.write() as session:
        session.execute(text(withhold))
    path = world.settings.database_url.removeprefix("sqlite:///")
    with contextlib.closing(sqlite3.connect(path)) as by_hand, by_hand:  # foreign keys are off
        by_hand.execute(withhold)
    with world.database.read() as session:
        (found,) = violations(session)
    assert (found.rule, found.subject) == ("drawing of a withheld split", submission_id)


def test_strategies_have_nothing_to_draw(
    world: World, tiny: Split, protocol: ProtocolDocument
) -> None:
    world.add_phase(tiny, challenge="strategy")
    publish(world, protocol)
    answers = [{"sample_id": sample.sample_id, "strategy": "C"} for sample in tiny.samples]
    document = {"schema": "exceptiondrive.strategy/1", "split": "tiny", "predictions": answers}
    world.score(json.dumps(document).encode())
    world.build_board()
    assert n_rows(world, EntryDrawingsRow) == 0


def test_what_is_left_over_is_drawn_with_the_next_board(
    world: World,
    tiny: Split,
    planning_file: MakeFile,
    protocol: ProtocolDocument,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("exceptiondrive_worker.drawing.DRAWN_AT_ONCE", 1)
    world.add_phase(tiny)
    publish(world, protocol)
    for speed in (1.0, 2.0, 3.0):
        world.score(planning_file(tiny, edited_mps=speed), method=f"m{speed}")
    for n_drawn in (1, 2, 3, 3):
        world.build_board()
        assert n_rows(world, EntryDrawingsRow) == n_drawn


def test_the_packaged_drawing_is_what_the_scorer_draws() -> None:
    hint = "run: python -m exceptiondrive_worker.drawing"
    held = json.loads(packaged_drawing().model_dump_json(by_alias=True))
    made = json.loads(packaged_drawing_text())
    assert flat(held) == pytest.approx(flat(made), abs=2e-4), hint


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Leaves by path, so that numbers are compared nearly and words exactly."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for key, each in items for k, v in flat(each, f"{path}/{key}").items()}
    return {path: value}


def test_the_made_up_sample_passes_at_sixty_per_cent_of_the_required_clearance(
    protocol: ProtocolDocument,
) -> None:
    sample = draw_made_up(protocol).sample
    assert (sample.task, sample.d_safe_m) == ("BG1", 0.8)
    assert sample.clearance_m == pytest.approx(0.6 * 0.8, abs=1e-6)
    assert sample.metrics["hcc"] == pytest.approx(0.6, abs=1e-6)
    assert sample.metrics["hpr"] == pytest.approx(0.8 / (0.32 + 0.8), abs=1e-6)
    assert sample.metrics["ur"] == 0.0


def test_the_made_up_sample_follows_the_document(protocol: ProtocolDocument) -> None:
    wider = {"footprint_width_m": 2.4, "waypoints": 8, "collision_tube": "footprints"}
    changed = protocol.model_copy(
        update={
            "geometry": protocol.geometry.model_copy(update=wider),
            "grading": protocol.grading.model_copy(update={"d_safe_scale": 2.0}),
        }
    )
    sample = draw_made_up(changed).sample
    assert sample.d_safe_m == pytest.approx(1.6)
    assert sample.clearance_m == pytest.approx(0.96, abs=1e-6)
    assert (len(sample.edited), len(sample.tube)) == (9, 9)
    assert pictured_digest(changed) != pictured_digest(protocol)


def test_a_protocol_that_differs_is_drawn_with_its_first_board(world: World, tiny: Split) -> None:
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    changed = parse_protocol(toml.replace("footprint_width_m = 1.85", "footprint_width_m = 2.40"))
    assert changed.geometry.footprint_width_m == 2.4
    with world.database.write() as session:
        add_protocol(
            session, toml.replace("footprint_width_m = 1.85", "footprint_width_m = 2.40"), "test"
        )
    world.add_phase(tiny, protocol="1.1")
    with world.database.read() as session:
        assert protocol_drawing(session, changed) == packaged_drawing()  # until a worker drew it
    world.build_board()
    world.build_board()
    assert n_rows(world, ProtocolDrawingRow) == 1
    with world.database.read() as session:
        found = protocol_drawing(session, changed)
    assert found.pictured == pictured_digest(changed)
    assert found == draw_made_up(changed)
