"""Each stage runs only where its result is not kept: the work is counted."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import (
    GradingSection,
    PlausibilitySection,
    ProtocolDocument,
)
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_worker.splits.private_store import PrivateStore, Shelf
from exceptiondrive_worker.splits.store import load_split
from exceptiondrive_worker.stages import RejectedUpload, Stages, Target
from exceptiondrive_worker.upload_reader import read_upload


class Counted:
    """Stages over one upload whose every step is counted."""

    def __init__(self, folder: Path, upload: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: Counter[str] = Counter()
        self.private = PrivateStore(folder)
        self.upload = upload
        planning = scoring_of(PLANNING.id)
        regrading = planning.regrading
        assert regrading is not None
        regrade = self._counting("regrade", regrading.grade, bound=False)
        counted: Any = type(
            "CountedPlanning",
            (type(planning),),
            {
                "measure": self._counting("measure", planning.measure),
                "grade": self._counting("grade", planning.grade),
                "regrading": replace(regrading, grade=regrade),
            },
        )()
        self.stages = Stages(
            self.private,
            self._counting("load", lambda digest: self.upload, bound=False),
            self._counting("read", read_upload, bound=False),
        )
        monkeypatch.setattr("exceptiondrive_worker.stages.scoring_of", lambda _: counted)

    def _counting(
        self, name: str, function: Callable[..., Any], *, bound: bool = True
    ) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            self.done[name] += 1
            return function(*args[1:]) if bound else function(*args)

        return call

    def score(self, target: Target) -> tuple[str, Mapping[str, int]]:
        """Digest of the exact sheet, and what had to be done for it."""
        self.done.clear()
        digest = self.stages.score(target).digest
        return digest, dict(self.done)


REGRADED = {"regrade": 1}
"""What required clearances change; all else of a sheet is settled and kept."""
GRADED = {"grade": 1, **REGRADED}
"""Every metric, then those that required clearances change."""
EVERYTHING = {"load": 1, "read": 1, "measure": 1, **GRADED}


@pytest.fixture
def target(tiny: Split, protocol: ProtocolDocument) -> Target:
    return Target("sha256:upload", PLANNING, load_split(tiny, protocol), protocol)


@pytest.fixture
def counted(
    tmp_path: Path,
    tiny: Split,
    planning_file: Callable[..., bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> Counted:
    return Counted(tmp_path / "private", planning_file(tiny), monkeypatch)


def under(target: Target, tiny: Split, **sections: dict[str, Any]) -> Target:
    """The same target under another protocol, sections changed as given."""
    changes: dict[str, Any] = {
        name: getattr(target.protocol, name).model_copy(update=update)
        for name, update in sections.items()
    }
    other = target.protocol.model_copy(update={**changes, "version": "1.1"})
    return replace(target, protocol=other, split=load_split(tiny, other))


def test_the_first_run_does_everything_once(counted: Counted, target: Target) -> None:
    assert counted.score(target)[1] == EVERYTHING


def test_the_same_again_comes_to_the_same_bits_from_what_is_settled(
    counted: Counted, target: Target
) -> None:
    first, _ = counted.score(target)
    assert counted.score(target) == (first, REGRADED)


def test_a_fresh_store_comes_to_the_same_bits(
    counted: Counted, target: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, _ = counted.score(target)
    other = Counted(tmp_path / "other", counted.upload, monkeypatch)
    assert other.score(target) == (first, EVERYTHING)


def test_the_digest_tells_nothing_to_who_knows_the_sheet_but_not_the_regions(
    counted: Counted, target: Target
) -> None:
    """An upload that answers one sample has a sheet of one unknown clearance: all can be tried."""
    scored = counted.stages.score(target)
    assert scored.digest != content_digest(scored.sheet)
    other = replace(target, split=replace(target.split, regions_digest="f" * 64))
    elsewhere = replace(scored, regions_digest=other.split.regions_digest)
    assert elsewhere.sheet == scored.sheet
    assert elsewhere.digest != scored.digest


def test_new_required_clearances_touch_neither_upload_nor_geometry(
    counted: Counted, target: Target, tiny: Split
) -> None:
    first, _ = counted.score(target)
    tasks = tuple(task.model_copy(update={"d_safe_m": 9.0}) for task in target.protocol.tasks)
    other = target.protocol.model_copy(update={"tasks": tasks, "version": "1.1"})
    changed = replace(target, protocol=other, split=load_split(tiny, other))
    digest, work = counted.score(changed)
    assert work == REGRADED
    assert digest != first


def test_new_required_clearances_of_samples_touch_no_other_metric(
    counted: Counted, target: Target, tiny: Split
) -> None:
    counted.score(target)
    samples = (sample.model_copy(update={"d_safe_m": 9.0}) for sample in tiny.samples)
    stricter = load_split(tiny.model_copy(update={"samples": tuple(samples)}), target.protocol)
    assert counted.score(replace(target, split=stricter))[1] == REGRADED


@pytest.mark.parametrize(
    ("sections", "work"),
    [
        ({"grading": {"d_safe_scale": 2.0}}, REGRADED),
        ({"grading": {"headline": "micro"}}, REGRADED),
        ({"plausibility": {"flag_blind": 0.5}}, GRADED),
    ],
    ids=["scale", "headline", "plausibility"],
)
def test_other_grading_is_only_graded(
    counted: Counted,
    target: Target,
    tiny: Split,
    sections: dict[str, dict[str, Any]],
    work: dict[str, int],
) -> None:
    counted.score(target)
    assert counted.score(under(target, tiny, **sections))[1] == work


def _changed(value: Any) -> Any:
    """Another value of the same kind."""
    if isinstance(value, float):
        return value * 0.4
    if isinstance(value, int):
        return value + 1
    if isinstance(value, tuple):
        return value[:-1]
    if isinstance(value, dict):
        return {key: number + index for index, (key, number) in enumerate(value.items())}
    return {"macro_family": "micro"}[value]


@pytest.mark.parametrize(
    ("section", "name"),
    [
        *(("grading", name) for name in GradingSection.model_fields),
        *(("plausibility", name) for name in PlausibilitySection.model_fields),
    ],
)
def test_a_sheet_from_what_was_kept_is_that_of_a_fresh_store(
    counted: Counted,
    target: Target,
    tiny: Split,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    section: str,
    name: str,
) -> None:
    counted.score(target)
    value = _changed(getattr(getattr(target.protocol, section), name))
    other = under(target, tiny, **{section: {name: value}})
    fresh = Counted(tmp_path / "fresh", counted.upload, monkeypatch)
    assert counted.score(other)[0] == fresh.score(other)[0]


@pytest.mark.parametrize(
    "sections",
    [{"ranking": {"bootstrap_draws": 200}}, {"publication": {"percent_decimals": 1}}],
    ids=["ranking", "publication"],
)
def test_ranking_and_publication_settle_nothing_anew(
    counted: Counted, target: Target, tiny: Split, sections: dict[str, dict[str, Any]]
) -> None:
    counted.score(target)
    changed = under(target, tiny, **sections)
    assert counted.score(changed)[1] == REGRADED
    assert counted.stages.score(changed).sheet.protocol.version == "1.1"


@pytest.mark.parametrize(
    "update",
    [{"footprint_width_m": 1.0}, {"heading_hold_m": 0.5}, {"collision_tube": "footprints"}],
    ids=["footprint", "heading", "tube"],
)
def test_other_geometry_measures_stored_answers_and_never_reads_the_upload(
    counted: Counted, target: Target, tiny: Split, update: dict[str, Any]
) -> None:
    counted.score(target)
    assert counted.score(under(target, tiny, geometry=update))[1] == {"measure": 1, **GRADED}


def test_other_regions_measure_stored_answers(
    counted: Counted, target: Target, make_split: Callable[..., Split], tiny: Split
) -> None:
    counted.score(target)
    further = {s.sample_id: {"task": s.task, "scene_id": s.scene_id} for s in tiny.samples}
    further["a"]["region"] = [[20, -1], [22, -1], [22, 1], [20, 1]]  # type: ignore[assignment]
    moved = replace(target, split=load_split(make_split(further), target.protocol))
    assert counted.score(moved)[1] == {"measure": 1, **GRADED}


def test_other_tasks_of_the_split_are_only_graded(
    counted: Counted, target: Target, make_split: Callable[..., Split], tiny: Split
) -> None:
    counted.score(target)
    relabelled = {s.sample_id: {"task": "RS2", "scene_id": s.scene_id} for s in tiny.samples}
    other = replace(target, split=load_split(make_split(relabelled), target.protocol))
    assert counted.score(other)[1] == GRADED


def test_another_number_of_waypoints_needs_the_upload_again_and_rejects_it(
    counted: Counted, target: Target, tiny: Split
) -> None:
    counted.score(target)
    longer = under(target, tiny, geometry={"waypoints": 8})
    with pytest.raises(RejectedUpload) as caught:
        counted.score(longer)
    assert [group.code.value for group in caught.value.report.faults] == ["wrong_waypoint_count"]


@pytest.mark.parametrize(
    ("shelf", "work"),
    [
        (Shelf.SETTLED, GRADED),
        (Shelf.MEASUREMENTS, REGRADED),
        (Shelf.ANSWERS, REGRADED),
    ],
)
def test_a_damaged_file_is_made_again_where_it_is_needed(
    counted: Counted, target: Target, shelf: Shelf, work: dict[str, int]
) -> None:
    first, _ = counted.score(target)
    for path in (counted.private.root / shelf).iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    assert counted.score(target) == (first, work)


def test_what_another_version_kept_of_a_sheet_is_graded_again(
    counted: Counted, target: Target, tiny: Split
) -> None:
    counted.score(target)
    (path,) = (counted.private.root / Shelf.SETTLED).iterdir()
    columns = counted.private.read_columns(Shelf.SETTLED, path.name)
    assert columns is not None
    other = {**columns, "sheet": np.array(b'{"rows": 3}')}
    counted.private.write_columns(Shelf.SETTLED, path.name, other)
    assert counted.score(under(target, tiny, grading={"d_safe_scale": 2.0}))[1] == GRADED


def test_a_store_that_is_damaged_throughout_is_made_again(counted: Counted, target: Target) -> None:
    first, _ = counted.score(target)
    for path in counted.private.root.glob("*/*"):
        path.write_bytes(b"")
    assert counted.score(target) == (first, EVERYTHING)


def test_scene_sums_are_made_of_what_was_measured_and_from_the_upload_at_worst(
    counted: Counted, target: Target
) -> None:
    key = counted.stages.score(target).measurement_key
    counted.done.clear()
    first = counted.stages.scene_sums(target, key)
    assert counted.done == {"grade": 1}
    counted.done.clear()
    for path in counted.private.root.glob("*/*"):
        path.unlink()
    assert (counted.stages.scene_sums(target, key).sums == first.sums).all()
    assert counted.done == {name: EVERYTHING[name] for name in ("load", "read", "measure", "grade")}


def test_an_upload_that_needs_too_much_memory_is_rejected(tmp_path: Path, target: Target) -> None:
    def too_large(*_: Any) -> CheckReport:
        raise MemoryError

    stages = Stages(PrivateStore(tmp_path / "private"), lambda digest: b"{}", too_large)
    with pytest.raises(RejectedUpload) as caught:
        stages.score(target)
    assert [group.code.value for group in caught.value.report.faults] == ["inflates_too_large"]


def test_whatever_size_the_server_takes_is_read_and_reported_as_sound(
    counted: Counted, target: Target
) -> None:
    blanks = MAX_INFLATED_BYTES - len(counted.upload)
    usual = counted.stages.answers(target)
    counted.upload += b" " * blanks
    large = replace(target, file_digest="sha256:large")
    assert counted.stages.answers(large)["edited"].tobytes() == usual["edited"].tobytes()
    assert counted.stages.report(large).is_valid


def test_a_rejected_upload_leaves_nothing_in_the_store(
    tmp_path: Path, target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = Counted(tmp_path / "private", b"not json", monkeypatch)
    with pytest.raises(RejectedUpload):
        counted.score(target)
    assert list(counted.private.root.glob("*/*")) == []


def with_control(tiny: Split, sample_id: str) -> Split:
    """The split with one sample made a control."""
    return tiny.model_copy(
        update={
            "samples": tuple(
                sample.model_copy(update={"control": sample.sample_id == sample_id})
                for sample in tiny.samples
            )
        }
    )


def test_over_caution_is_of_the_controls_and_another_control_is_another_sheet(
    tmp_path: Path,
    tiny: Split,
    planning_file: Callable[..., bytes],
    protocol: ProtocolDocument,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stopping = {"b": {"edited": [[0.1 * step, 0.0] for step in range(1, 7)]}}
    upload = planning_file(tiny, edited_mps=3.0, changes=stopping)
    counted = Counted(tmp_path / "private", upload, monkeypatch)

    def sheet(split: Split) -> ScoreSheet:
        target = Target("sha256:upload", PLANNING, load_split(split, protocol), protocol)
        return counted.stages.score(target).sheet

    assert "over_caution" not in sheet(tiny).micro
    for control, share in (("b", 1.0), ("c", 0.0)):
        found = sheet(with_control(tiny, control))
        assert (found.n, found.micro["over_caution"]) == (3, share)
        assert "over_caution" not in found.macro_family
        assert found.coverage.n_edited == 3


def test_recorded_paths_are_measured_against_and_kept_apart(
    tmp_path: Path,
    tiny: Split,
    planning_file: Callable[..., bytes],
    protocol: ProtocolDocument,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted = Counted(tmp_path / "private", planning_file(tiny, source_mps=4.0), monkeypatch)
    path = tuple((2.0 * step, 3.0) for step in range(1, 7))
    told = tiny.model_copy(
        update={
            "samples": tuple(
                sample.model_copy(update={"recorded": path if sample.sample_id == "a" else None})
                for sample in tiny.samples
            )
        }
    )
    plain, fit = (
        counted.stages.score(
            Target("sha256:upload", PLANNING, load_split(split, protocol), protocol)
        ).sheet
        for split in (tiny, told)
    )
    assert plain.micro["source_l2_m"] is None
    assert fit.micro["source_l2_m"] == fit.micro["source_l2_2s_m"] == 3.0
    assert fit.families["lane_blockage"].metrics["source_l2_m"] is None
    assert fit.micro["hcc"] == plain.micro["hcc"]
