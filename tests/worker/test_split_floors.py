"""Floors that only workers read: what an organizer, or whoever has the server, cannot ask for."""

import json
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from datetime import timedelta
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from sqlalchemy import func, select
from tests.support import floors
from tests.support.documents import region_ahead
from tests.support.records import add_phase
from tests.support.worker import build_board_of, score_submission

from exceptiondrive_records.audit.log import SPLIT_FLOOR_HELD, audit_page
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.operations.overview import overview
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.splits.openings import opened_protocols
from exceptiondrive_records.submissions.sheets import scored_within_a_day
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.jobs import new_job
from exceptiondrive_records.work.lease import new_item
from exceptiondrive_records.work.tables import Profile
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import (
    GeometrySection,
    GradingSection,
    PlausibilitySection,
    ProtocolDocument,
    PublicationSection,
    RankingSection,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.split import Split, SplitRef
from exceptiondrive_schemas.taxonomy import Family, Task
from exceptiondrive_worker.failures import FailureCode
from exceptiondrive_worker.profile_run import describe_next
from exceptiondrive_worker.splits.admin import SplitsRefusedError, publish_split_file
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.floors import (
    FloorsUnreadableError,
    SplitFloors,
    breaches,
    read_floors,
)
from exceptiondrive_worker.splits.floors_held import hold_floors_again
from exceptiondrive_worker.splits.store import read_split
from exceptiondrive_worker.stages import Target

World = Any
FloatArray = NDArray[np.float64]
LEAKAGE = Path(__file__).parents[2] / "docs" / "leakage.md"
SAMPLE = Path(__file__).parents[2] / "hidden_splits" / "sample" / "split.json.gz"
NO_FLOORS = """
min_samples_per_cell = 1
max_percent_decimals = 4
footprint_length_m = [0, 1000]
footprint_width_m = [0, 1000]
d_safe_m = [0, 5000]
waypoints = [1, 200]
max_step_m = [0, 1000]
collision_tubes = ["footprints"]
"""
N_TASKS_READ = 12


def changed(version: str, **values: object) -> str:
    """Return protocol 1.1 as another version, with other values of fields by their name."""
    text = packaged_protocol_toml("1.1").replace('version = "1.1"', f'version = "{version}"')
    for name, value in values.items():
        text, n_found = re.subn(rf"(?m)^{name} = [^#\n]*", f"{name} = {value} ", text)
        assert n_found, name
    return text


POINT = changed(
    "9.0",
    waypoints=1,
    max_step_m=1000.0,
    footprint_length_m=0.001,
    footprint_width_m=0.001,
    footprint_centre_ahead_m=0.0,
    d_safe_scale=10.0,
    d_safe_m=20.0,
    collision_tube='"footprints"',
    percent_decimals=4,
).replace("sensitivity_factors = [0.5, 2.0] ", "sensitivity_factors = [10.0] ")
"""Made to read regions: HCC of one sample a task is the distance of a point from its region."""


@pytest.fixture(scope="module")
def withheld() -> Split:
    """The sample split without recorded paths, as most splits are; never published here."""
    split = read_split(SAMPLE)
    bare = tuple(sample.model_copy(update={"recorded": None}) for sample in split.samples)
    return split.model_copy(update={"samples": bare})


def write_floors(world: World, text: str, name: str = "sample") -> None:
    floors.write_floors(world.settings.splits_dir / name, text)


def open_phase(world: World, toml: str, split: Split, phase_id: str = "made") -> str:
    """Open a phase under any protocol, those too that no organizer could add: floors hold alone."""
    world.add_split(split)
    protocol = parse_protocol(toml)
    version = protocol.version
    with world.database.write() as session:
        now = database_now(session)
        row = ProtocolRow(digest=protocol.digest, version=version, toml=toml, created_at=now)
        if session.get(ProtocolRow, protocol.digest) is None:
            session.add(row)
            session.flush()
        add_phase(
            session,
            phase_id,
            split=split.name,
            protocol=version,
            quota_per_day=10_000,
            rejected_per_day=10_000,
        )
    return version


class Reader:
    """Reads the region of one sample of each of twelve tasks, all of them by every upload.

    All other samples are not answered, so HCC of a task is the distance of a point from a region:
    first of the start, then of points around it, then of points around what is surmised.
    """

    def __init__(self, world: World, split: Split) -> None:
        self.world, self.split = world, split
        self.protocol = parse_protocol(POINT)
        self.sizes = {task.id: 0 for task in self.protocol.tasks}
        self.probed: dict[str, Any] = {}
        for sample in split.samples:
            self.sizes[sample.task] += 1
            if len(self.probed) < N_TASKS_READ:
                self.probed.setdefault(sample.task, sample)
        self.statuses: list[str] = []

    def distances_m(self, at_m: dict[str, FloatArray]) -> dict[str, float]:
        """Upload a point for each task; return how far each is from the region of its sample."""
        points = {self.probed[task].sample_id: list(map(float, at_m[task])) for task in at_m}
        answers = []
        for sample in self.split.samples:
            way = [points[sample.sample_id]] if sample.sample_id in points else None
            answers.append({"sample_id": sample.sample_id, "source": way, "edited": way})
        head = {"schema": "exceptiondrive.planning/1", "split": self.split.name}
        data = json.dumps({**head, "predictions": answers}).encode()
        submission_id = self.world.score(data, phase_id="made", method=f"m{len(self.statuses)}")
        self.statuses.append(self.world.submission(submission_id).status.value)
        with self.world.database.read() as session:
            query = select(ScoreSheetRow.sheet).where(ScoreSheetRow.submission_id == submission_id)
            sheet = session.scalar(query)
        if sheet is None:
            return {}
        required_m = 20.0 * self.protocol.grading.d_safe_scale
        shares = {task: sheet.tasks[task].metrics["hcc"] or 0.0 for task in at_m}
        return {task: share * self.sizes[task] * required_m for task, share in shares.items()}

    def read(self, n_around: tuple[int, ...]) -> list[float]:
        """Return the IoU of each region that was read with the true one."""
        start = self.distances_m({task: np.zeros(2) for task in self.probed})
        seen: dict[str, list[tuple[FloatArray, float]]] = {task: [] for task in self.probed}
        for angle in np.linspace(-np.pi / 2, np.pi / 2, 16):
            toward = np.array([np.cos(angle), np.sin(angle)])
            self._look(seen, start, {task: toward * start.get(task, 1.0) for task in self.probed})
        for n_points in n_around:
            discs = {task: _surmised(seen[task]) for task in self.probed if seen[task]}
            for angle in np.linspace(0, 2 * np.pi, n_points, endpoint=False):
                toward = np.array([np.cos(angle), np.sin(angle)])
                at_m = {task: at + (radius + 3.0) * toward for task, (at, radius) in discs.items()}
                self._look(seen, start, at_m or {task: n_points * toward for task in self.probed})
        return [_iou(self.probed[task].region, seen[task]) for task in self.probed]

    def _look(
        self,
        seen: dict[str, list[tuple[FloatArray, float]]],
        start: dict[str, float],
        at_m: dict[str, FloatArray],
    ) -> None:
        for task, distance_m in self.distances_m(at_m).items():
            if distance_m < start[task] - 0.01:  # else the start is nearer
                seen[task].append((at_m[task], distance_m))


def _surmised(seen: list[tuple[FloatArray, float]]) -> tuple[FloatArray, float]:
    """Middle and radius of the disc that fits best what was read."""
    places = np.stack(np.meshgrid(np.arange(0, 80, 0.5), np.arange(-40, 40, 0.5)), -1)
    places = places.reshape(-1, 2)
    points = np.array([point for point, _ in seen])
    far = np.linalg.norm(places[:, None] - points[None], axis=-1)
    gap = far - np.array([distance_m for _, distance_m in seen])
    best = np.argmin(gap.std(axis=1))
    return np.asarray(places[best]), max(float(gap[best].mean()), 0.5)


def _iou(region: Any, seen: list[tuple[FloatArray, float]]) -> float:
    """What no circle around a point covers is the region: its true size decides nothing here."""
    if not seen:
        return 0.0
    middle, radius_m = _surmised(seen)
    guess: Any = shapely.Point(middle).buffer(2 * radius_m + 3)
    for point, distance_m in seen:
        guess = guess.difference(shapely.Point(point).buffer(distance_m, quad_segs=200))
    true = shapely.Polygon(region)
    return float(true.intersection(guess).area / true.union(guess).area)


def held(world: World) -> list[tuple[str, dict[str, Any]]]:
    """Subjects and details of the audit lines about floors, oldest first."""
    with world.database.read() as session:
        lines = audit_page(session, limit=1000)
        return [(it.subject, it.detail) for it in lines[::-1] if it.action == SPLIT_FLOOR_HELD]


def code_of(world: World, submission_id: str) -> str | None:
    code: str | None = world.submission(submission_id).failure_code
    return code


def test_a_protocol_made_for_it_reads_regions_where_no_floor_holds(
    world: World, withheld: Split
) -> None:
    """The attack itself, so that the next test refuses something that works."""
    write_floors(world, NO_FLOORS)
    open_phase(world, POINT, withheld)
    reader = Reader(world, withheld)
    ious = reader.read((8, 24))
    assert set(reader.statuses) == {SubmissionStatus.SCORED}
    assert sum(iou > 0.6 for iou in ious) >= 5
    assert held(world) == []


def test_the_same_protocol_reads_nothing_where_the_advised_floors_hold(
    world: World, withheld: Split
) -> None:
    version = open_phase(world, POINT, withheld)
    (world.settings.splits_dir / "sample" / "floors.toml").unlink()
    reader = Reader(world, withheld)
    assert reader.read((8, 24)) == [0.0] * N_TASKS_READ
    assert set(reader.statuses) == {SubmissionStatus.FAILED}
    with world.database.read() as session:
        assert session.scalar(select(func.count()).select_from(ScoreSheetRow)) == 0
        (line,) = overview(session).floors_held
    ((subject, detail),) = held(world)
    assert (subject, detail["phase"], detail["protocol"]) == ("sample", "made", version)
    asked = " ".join(detail["asked"])
    for name in ("percent_decimals", "footprint_length_m", "waypoints", "d_safe_m"):
        assert name in asked
    assert line.detail == detail


FINER: list[tuple[str, dict[str, Any], str]] = [
    ("percent_decimals", {"percent_decimals": 3}, "percent_decimals is 3, at most 2 may be"),
    ("metre_decimals", {"metre_decimals": 4}, "metre_decimals is 4, at most 2 may be"),
    ("footprint", {"footprint_length_m": 60.0}, "footprint_length_m is 60, it must lie from 4"),
    ("width", {"footprint_width_m": 0.01}, "footprint_width_m is 0.01"),
    ("micrometres", {"d_safe_m": 1e-6}, "d_safe_m is 1e-06, it must lie from 0.25 to 4"),
    ("centimetres", {"sensitivity_factors": [0.1]}, "d_safe_m is 0.2"),
    ("far", {"d_safe_scale": 10.0}, "d_safe_m is 20"),
    ("centre", {"footprint_centre_ahead_m": -6.0}, "footprint_centre_ahead_m is -6"),
    ("tube", {"collision_tube": '"footprints"'}, 'collision_tube is "footprints"'),
    ("leaps", {"max_step_m": 500.0}, "max_step_m is 500, it must lie from 30 to 30"),
    ("paths sorted", {"max_coordinate_m": 20.0}, "max_coordinate_m is 20"),
    ("sizes sorted", {"min_region_area_m2": 6.0}, "min_region_area_m2 is 6"),
    ("distances sorted", {"max_region_distance_m": 15.0}, "max_region_distance_m is 15"),
    ("one point", {"waypoints": 1}, "waypoints is 1"),
    ("pairs", {"compared_entries": 50}, "compared_entries is 50"),
    ("factors", {"sensitivity_factors": [0.5, 0.9, 1.1]}, "the number of sensitivity_factors is 3"),
    ("curve", {"clearance_curve": '"all_splits"'}, 'clearance_curve is "all_splits"'),
    ("outcomes", {"outcome_cells": '"all_splits"'}, 'outcome_cells is "all_splits"'),
]


@pytest.mark.parametrize(("what", "values", "words"), FINER, ids=[one[0] for one in FINER])
def test_what_is_finer_than_the_advised_floors_is_named(
    what: str, values: dict[str, Any], words: str
) -> None:
    protocol = parse_protocol(changed("9.1", **values))
    (found,) = breaches(SplitFloors(min_samples_per_cell=1), protocol)
    assert found.startswith(words), what


FLOORED = {
    "geometry": "waypoints max_coordinate_m max_step_m footprint_length_m footprint_width_m "
    "footprint_centre_ahead_m collision_tube min_region_area_m2 max_region_distance_m",
    "grading": "d_safe_scale sensitivity_factors clearance_curve_step clearance_curve_until",
    "publication": "percent_decimals metre_decimals min_samples_per_cell compared_entries "
    "clearance_curve outcome_cells",
    "tasks": "d_safe_m",
}
HARMLESS = {
    # one value, or within bounds of the schema that are as tight as a floor would be
    "geometry": "frame contact_tolerance_m heading_hold_tolerance_m "
    # made of the upload alone; a team turns its footprints by its waypoints anyway
    "time_step_s heading_hold_m reverse_above_deg",
    # which of the published means comes first; answers of the taxonomy, without a region
    "grading": "headline caution",
    # of intervals, which are told of a withheld split to whole per cents whatever they are made with
    "ranking": "bootstrap_draws bootstrap_seed confidence min_scenes "
    # of what is published besides: shares of the file that are missing, flags, two metrics
    "order min_coverage unranked_flags",
    # of the upload and labels
    "plausibility": "stationary_below_m blind_shift_below_m max_acceleration_mps2 "
    "min_turn_radius_m flag_edited_stationary_excess flag_source_stationary flag_blind "
    "flag_impossible frame_check_min_motion_m frame_check_max_angle_deg frame_check_min_samples "
    "progress_min_path_m first_step_from_mps flag_first_step flag_reverses_excess flag_progress "
    "flag_family_progress flag_family_min_samples flag_same_answer "
    # splits the hits in the totals by what the team itself decides: counted in docs/leakage.md
    "reaction_shift_m "
    # tells marks of controls, which are taken as known, and one bit of a median that is published
    "over_caution_below flag_over_caution flag_off_course_m",
    # words; which task is of which family makes cells, each of them held to min_samples_per_cell
    "families": "id title",
    "tasks": "id name family hazard region acceptable under_warning",
    "": "schema_ version title changes",
}


def test_each_field_of_a_protocol_is_held_by_a_floor_or_needs_none() -> None:
    """A field that comes later is added to one of the lists, with what it may tell of regions."""
    sections: dict[str, type[Document]] = {
        "": ProtocolDocument,
        "geometry": GeometrySection,
        "grading": GradingSection,
        "ranking": RankingSection,
        "plausibility": PlausibilitySection,
        "publication": PublicationSection,
        "families": Family,
        "tasks": Task,
    }
    for name, section in sections.items():
        floored, free = FLOORED.get(name, "").split(), HARMLESS.get(name, "").split()
        assert not set(floored) & set(free), name
        assert {*floored, *free} == set(section.model_fields) - set(sections), name
    tried = {field for _, values, _ in FINER for field in values}
    assert tried >= {field for fields in FLOORED.values() for field in fields.split()} - {
        "clearance_curve_step",  # tried below
        "clearance_curve_until",
        "min_samples_per_cell",
    }


def test_the_table_of_floors_says_what_is_advised_and_what_the_sample_has() -> None:
    section = re.split(r"^###? ", LEAKAGE.read_text("utf-8"), flags=re.MULTILINE)
    (text,) = (each for each in section if each.startswith("Floors that only workers read"))
    rows = re.findall(r"^\| (`\w+`.*?) \| (.*?) \| (.*?) \|", text, re.MULTILINE)
    named = [re.findall(r"\w+", fields) for fields, *_ in rows]
    assert {name for names in named for name in names} == set(SplitFloors.model_fields)
    for column, held in enumerate((SplitFloors(), read_floors(SAMPLE.parent)), 1):
        for row, names in zip(rows, named, strict=True):
            values = np.asarray([getattr(held, name) for name in names if name != "organizers"])
            if values.dtype.kind in "if":
                assert re.findall(r"[\d.]+", row[column]) == [f"{n:g}" for n in values.flat], row


def test_a_curve_that_floors_show_has_no_more_points_than_they_say() -> None:
    shows = SplitFloors(shows=("clearance_curve",), min_samples_per_cell=1)
    shown = changed("9.2", clearance_curve='"all_splits"')
    assert list(breaches(shows, parse_protocol(shown))) == []
    fine = shown.replace("clearance_curve_step = 0.1", "clearance_curve_step = 0.01")
    far = shown.replace("clearance_curve_until = 2.0", "clearance_curve_until = 10.0")
    words = "the number of points of a clearance_curve is {}, at most 21 may be"
    assert list(breaches(shows, parse_protocol(fine))) == [words.format(201)]
    assert list(breaches(shows, parse_protocol(far))) == [words.format(101)]


SMALL_CELLS = ["min_samples_per_cell is 1, the floor is 100"]


@pytest.mark.parametrize(
    ("version", "asked"), [("1.0", SMALL_CELLS), ("1.1", SMALL_CELLS), ("1.1-withheld", [])]
)
def test_of_the_packaged_protocols_the_one_for_withheld_splits_passes_the_advised_floors(
    version: str, asked: list[str]
) -> None:
    protocol = parse_protocol(packaged_protocol_toml(version))
    assert list(breaches(SplitFloors(), protocol)) == asked
    assert list(breaches(read_floors(SAMPLE.parent), protocol)) == [], "the sample is open"


def test_a_split_whose_maker_says_nothing_has_the_advised_floors(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    """An organizer asks for the cells of protocol 1.1, then 101 times for what may be asked."""
    floors_file = world.settings.splits_dir / tiny.name / "floors.toml"
    open_phase(world, packaged_protocol_toml("1.1"), tiny, "fine")
    open_phase(world, packaged_protocol_toml("1.1-withheld"), tiny, "coarse")
    floors_file.unlink()
    fine = world.score(planning_file(tiny), phase_id="fine")
    assert code_of(world, fine) == FailureCode.SPLIT_FLOOR.value
    assert held(world)[0][1]["asked"] == SMALL_CELLS
    files = [planning_file(tiny, edited_mps=1.0 + number / 100) for number in range(101)]
    codes = [code_of(world, world.score(data, phase_id="coarse")) for data in files]
    assert codes == [None] * 100 + [FailureCode.SPLIT_DAY_FULL.value]


def test_no_board_is_built_below_the_floors(
    world: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Floors that were raised hold what was scored before, too: its board is not built anew."""
    world.add_phase(tiny)
    world.score(planning_file(tiny))
    write_floors(world, "min_samples_per_cell = 100", tiny.name)
    build_board_of(world.context, "dev", world.protocol_digest())
    with world.database.read() as session:
        assert session.scalar(select(func.count()).select_from(BoardRow)) == 0
    ((_, detail),) = held(world)
    assert detail["asked"] == ["min_samples_per_cell is 1, the floor is 100"]
    log = capsys.readouterr().out
    assert all(part in log for part in ("job=board:dev", "code=split_floor", *detail["asked"]))
    write_floors(world, "", tiny.name)
    submission_id = world.score(planning_file(tiny, edited_mps=1.2))
    assert world.submission(submission_id).status is SubmissionStatus.SCORED


def test_a_public_split_holds_nothing_back(
    world: World, make_split: Callable[..., Split], planning_file: Callable[..., bytes]
) -> None:
    tiny = make_split({"a": {"region": region_ahead(10.0)}})
    write_floors(world, "min_samples_per_cell = 100", tiny.name)
    world.add_phase(tiny)
    context = world.context
    protocol = parse_protocol(packaged_protocol_toml())
    publish_split_file(world.database, world.files, context.splits, tiny.name, protocol)
    submission_id = world.score(planning_file(tiny))
    assert world.submission(submission_id).status is SubmissionStatus.SCORED


def test_only_so_many_submissions_a_day_are_scored_over_all_phases_and_teams(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    write_floors(world, "max_scored_per_day = 3", tiny.name)
    world.add_phase(tiny, "one")
    world.add_phase(tiny, "two")
    files = [planning_file(tiny, edited_mps=1.0 + number / 10) for number in range(6)]
    where = [("one", "alpha"), ("one", "beta"), ("two", "alpha"), ("two", "gamma"), ("one", "beta")]
    ids = [
        world.score(data, phase_id=phase, team=team)
        for data, (phase, team) in zip(files, where, strict=False)
    ]
    codes = [code_of(world, submission_id) for submission_id in ids]
    assert codes == [None, None, None, *[FailureCode.SPLIT_DAY_FULL.value] * 2]
    asked = held(world)[0][1]["asked"][0]
    assert re.search(r"after 3 of \d.*at most 3 a day", asked), "told before regions are opened"
    with world.database.read() as session:
        now = database_now(session)
        found = [
            scored_within_a_day(session, tiny.name, at, besides=ids[0])
            for at in (now, now + timedelta(days=1))
        ]
    assert found == [2, 0]


def test_what_is_scored_anew_takes_no_place_of_the_day(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    write_floors(world, "max_scored_per_day = 2", tiny.name)
    world.add_phase(tiny, "one")
    first, second, third = [
        world.score(planning_file(tiny, edited_mps=1.0 + number / 10), phase_id="one")
        for number in range(3)
    ]
    assert code_of(world, third) == FailureCode.SPLIT_DAY_FULL.value
    open_phase(world, changed("9.1"), tiny)
    write_floors(world, "max_scored_per_day = 1", tiny.name)
    with world.database.write() as session:
        digest = session.get_one(Phase, "made").protocol_digest
        jobs = [
            new_job(
                session.get_one(Submission, submission_id),
                digest,
                tiny.revision,
                Lane.RESCORE,
                False,
                database_now(session),
            )
            for submission_id in (first, second)
        ]
        session.add_all(jobs)
    assert all(score_submission(world.context, job.id) for job in jobs)
    with world.database.read() as session:
        anew = select(ScoreSheetRow.submission_id).where(ScoreSheetRow.protocol_digest == digest)
        assert set(session.scalars(anew)) == {first, second}


def test_only_so_many_protocols_ever_ask(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    write_floors(world, "max_protocols = 2", tiny.name)
    codes = []
    for number in range(3):
        open_phase(world, changed(f"9.{number}"), tiny, f"phase-{number}")
        submission_id = world.score(planning_file(tiny), phase_id=f"phase-{number}")
        codes.append(code_of(world, submission_id))
    assert codes == [None, None, FailureCode.SPLIT_FLOOR.value]
    assert held(world)[-1][1]["asked"] == ["it would be protocol number 3, at most 2 may be"]


def test_boards_count_among_the_protocols_whatever_comes_of_them(world: World, tiny: Split) -> None:
    """Rows of references would answer by any number of protocols, and a board that is not built, too."""
    write_floors(world, "max_protocols = 2", tiny.name)
    world.add_phase(tiny, "first")
    for number, length_m in enumerate((4.0, 28.0, 5.0)):  # the second touches a region
        toml = changed(f"9.{number}", footprint_length_m=length_m)
        open_phase(world, toml, tiny, f"phase-{number}")
        with world.database.read() as session:
            digest = session.get_one(Phase, f"phase-{number}").protocol_digest
        touches = pytest.raises(SplitRefusedError) if length_m == 28.0 else nullcontext()
        with touches:
            build_board_of(world.context, f"phase-{number}", digest)
    with world.database.read() as session:
        assert list(session.scalars(select(BoardRow.phase_id))) == ["phase-0"]
    assert held(world)[-1][1]["asked"] == ["it would be protocol number 3, at most 2 may be"]


@pytest.mark.parametrize("most_m", [70.0, 3.0], ids=["fits", "does not fit"])
def test_nobody_learns_below_the_floors_whether_a_split_fits(
    world: World, tiny: Split, planning_file: Callable[..., bytes], most_m: float
) -> None:
    """Neither by a board, nor by the look at a file of another phase that a taken-over server asks for."""
    world.add_phase(tiny, "fine")
    scored = world.score(planning_file(tiny), phase_id="fine")
    assert code_of(world, scored) is None
    open_phase(world, changed("9.1", max_region_distance_m=most_m), tiny)
    with world.database.read() as session:
        digest = session.get_one(Phase, "made").protocol_digest
    build_board_of(world.context, "made", digest)
    with world.database.write() as session:
        asked = new_item(Profile, scored, database_now(session), lane=Lane.LIVE)
        asked.submission_id, asked.protocol_digest = scored, digest
        asked.split_revision = tiny.revision
        session.add(asked)
    assert describe_next(world.context)
    with world.database.read() as session:
        assert session.scalars(select(Profile)).one().note == FailureCode.SPLIT_FLOOR.value
        assert digest not in opened_protocols(session, tiny.name)
    told = [detail["asked"] for _, detail in held(world)]
    assert told == [[f"max_region_distance_m is {most_m:g}, it must lie from 80 to 1000"]] * 2


def score_at_once(world: World, jobs: list[tuple[str, str]]) -> set[str | None]:
    """Score two jobs at once; return what became of their submissions."""
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda job: score_submission(world.context, job[1]), jobs))
    return {code_of(world, submission_id) for submission_id, _ in jobs}


def test_two_protocols_at_once_take_no_more_than_is_left(
    world: World, tiny: Split, planning_file: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are let begin, since neither is counted."""
    write_floors(world, "max_protocols = 1", tiny.name)
    jobs = []
    for number in range(2):
        open_phase(world, changed(f"9.{number}"), tiny, f"phase-{number}")
        jobs.append(world.submit(planning_file(tiny), phase_id=f"phase-{number}"))
    floors.let_begin_together(monkeypatch)
    assert score_at_once(world, jobs) == {None, FailureCode.SPLIT_FLOOR.value}
    with world.database.read() as session:
        assert len(opened_protocols(session, tiny.name)) == 1
    assert held(world)[-1][1]["asked"] == ["it would be protocol number 2, at most 1 may be"]


def test_two_jobs_at_once_open_a_split_under_one_new_protocol(
    world: World, tiny: Split, planning_file: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are let begin, since it is not counted, and it is counted once."""
    write_floors(world, "max_protocols = 1", tiny.name)
    open_phase(world, changed("9.1"), tiny)
    jobs = [
        world.submit(planning_file(tiny, edited_mps=1.1 + n / 10), phase_id="made")
        for n in range(2)
    ]
    floors.let_begin_together(monkeypatch)
    score_at_once(world, jobs)
    assert {world.submission(own).status for own, _ in jobs} == {SubmissionStatus.SCORED}
    with world.database.read() as session:
        assert len(opened_protocols(session, tiny.name)) == 1


def test_two_submissions_at_once_take_no_more_than_is_left_of_a_day(
    world: World, tiny: Split, planning_file: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are let begin, since neither has a sheet; the later one records none."""
    write_floors(world, "max_scored_per_day = 2", tiny.name)
    world.add_phase(tiny, "one")
    assert code_of(world, world.score(planning_file(tiny), phase_id="one")) is None
    jobs = [
        world.submit(planning_file(tiny, edited_mps=1.1 + n / 10), phase_id="one") for n in range(2)
    ]
    together, score = Barrier(2), world.context.stages.score

    def score_beside_the_other(target: Target) -> Any:
        together.wait(60)
        return score(target)

    monkeypatch.setattr(world.context.stages, "score", score_beside_the_other)
    assert score_at_once(world, jobs) == {None, FailureCode.SPLIT_DAY_FULL.value}
    assert "at most 2 a day" in held(world)[-1][1]["asked"][0]


@pytest.mark.parametrize(
    "database_url", [pytest.param("postgres", marks=pytest.mark.postgres)], indirect=True
)
def test_scores_of_one_split_wait_for_none_that_is_still_on_its_way(
    make_world: Callable[..., World],
    database_url: str,
    tiny: Split,
    planning_file: Callable[..., bytes],
) -> None:
    """However far the database is: the split is locked when a sheet is recorded, not before."""
    world = make_world(database_url)
    world.add_phase(tiny, "one")
    assert code_of(world, world.score(planning_file(tiny), phase_id="one")) is None
    of_split = world.context.splits.floors(tiny.name)
    ref = SplitRef(name=tiny.name, revision=tiny.revision)
    with world.database.write() as session:
        protocol = find_protocol(session, session.get_one(Phase, "one").protocol_digest)
        hold_floors_again(session, of_split, ref, protocol, "another")
        second = world.score(planning_file(tiny, edited_mps=1.2), phase_id="one")
    assert code_of(world, second) is None  # or it has waited for a lock, until it gave up


@pytest.mark.parametrize("part", ["private", None])
def test_the_private_part_is_closed_until_its_date(
    world: World,
    make_split: Callable[..., Split],
    planning_file: Callable[..., bytes],
    part: str | None,
) -> None:
    """Whoever has the server may point a phase at it, or at the whole: neither is scored."""
    parts = {f"s{n}": {"part": "private" if n % 2 else "public"} for n in range(6)}
    split = make_split(parts, name="parted")
    write_floors(world, "private_part_from = 2999-01-01T00:00:00Z", split.name)
    world.add_phase(split, "parted")
    fine = world.score(planning_file(split), phase_id="parted")
    assert code_of(world, fine) is None
    with world.database.write() as session:
        chosen = split.part("private") if part else split
        session.get_one(Phase, "parted").split_revision = chosen.revision
    submission_id = world.score(planning_file(split, edited_mps=1.2), phase_id="parted")
    assert code_of(world, submission_id) == FailureCode.SPLIT_FLOOR.value
    assert held(world)[-1][1]["asked"] == ["the private part is closed until 2999-01-01 00:00 UTC"]


def test_a_split_without_parts_is_closed_until_the_date_of_its_private_part(
    world: World, tiny: Split, planning_file: Callable[..., bytes]
) -> None:
    """Whose parts were lost on the way has all of them to lose."""
    write_floors(world, "private_part_from = 2999-01-01T00:00:00Z", tiny.name)
    world.add_phase(tiny)
    assert code_of(world, world.score(planning_file(tiny))) == FailureCode.SPLIT_FLOOR.value


@pytest.mark.parametrize("is_mount_point", [False, True])
def test_a_lost_folder_takes_no_floor_away(
    world: World, tiny: Split, planning_file: Callable[..., bytes], is_mount_point: bool
) -> None:
    """What was scored before is in memory, and its floors lie in the folder alone."""
    world.add_phase(tiny)
    assert code_of(world, world.score(planning_file(tiny))) is None
    folder, before = world.settings.splits_dir / tiny.name, world.context.splits.floors(tiny.name)
    away = folder.rename(folder.with_name("away"))
    if is_mount_point:
        folder.mkdir()
    with pytest.raises(FloorsUnreadableError, match="there is no split in"):
        world.context.splits.floors(tiny.name)
    second = world.score(planning_file(tiny, edited_mps=1.2))
    assert world.submission(second).status is SubmissionStatus.RECEIVED
    if is_mount_point:
        folder.rmdir()
    away.rename(folder)
    assert world.context.splits.floors(tiny.name) == before


@pytest.mark.parametrize(
    "text",
    [
        "max_protocol = 3",
        "d_safe_m = [3, 1]",
        "not toml",
        "private_part_from = 2026-01-01T00:00:00",
    ],
)
def test_floors_that_cannot_be_read_leave_everything_queued(
    world: World, tiny: Split, planning_file: Callable[..., bytes], text: str
) -> None:
    world.add_phase(tiny)
    write_floors(world, text, tiny.name)
    with pytest.raises(SplitsRefusedError, match=r"floors\.toml of tiny"):
        world.add_split(tiny)
    submission_id = world.score(planning_file(tiny))
    assert world.submission(submission_id).status is SubmissionStatus.RECEIVED
