"""A later revision that corrects one part of a split: the part that stays belongs to it as to the first."""

from typing import TYPE_CHECKING

import pytest
from tests.phases.life import CAREFUL, PRIVATE_ONLY, PUBLIC_ONLY, SAMPLES, split_of
from tests.support.floors import write_floors
from tests.support.worker import add_split, due_jobs, score_submission

from exceptiondrive_records.splits.splits import list_splits
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.datasheet import SplitChange
from exceptiondrive_worker.sample.files import sample_datasheet
from exceptiondrive_worker.splits.store import parts_of

if TYPE_CHECKING:
    from tests.phases.life import Life

Revisions = dict[SplitPart | None, str]
WITHDRAWN = {"public": "b", "private": "a"}
COUNTED = {"public": 2, "private": 3}
PARTS = list(WITHDRAWN)


def correct(life: "Life", *parts: str) -> Revisions:
    """Add a revision that withdraws a sample of each of these parts; return it by its parts."""
    gone = [WITHDRAWN[part] for part in parts]
    split = split_of(SAMPLES, "parted")
    samples = (
        each.model_copy(update={"withdrawn": "no hazard"}) if each.sample_id in gone else each
        for each in split.samples
    )
    later = split.model_copy(update={"samples": tuple(samples)})
    name = f"split-{'-'.join(parts)}.json"
    add_split(life.database, life.worker.splits_dir, later, name, f"{' and '.join(gone)} goes.")
    return {part: later.part(part).revision for part in parts_of(later)}


def apply(life: "Life", run: str) -> None:
    life.apply(run)
    life.done(f"/rescoring/{run}/close")


def end(life: "Life") -> None:
    life.work()
    life.move(closes_at=life.now())


def target_of(life: "Life", run: str) -> str:
    view = life.json(f"/api/v1/organizer/rescoring/{run}", "organizer")
    return str(view["to_split"]["revision"])


@pytest.mark.parametrize("corrected", PARTS)
def test_a_new_phase_counts_the_public_part_of_the_revision(life: "Life", corrected: str) -> None:
    later = correct(life, corrected)
    n_public = COUNTED["public"] - (corrected == "public")
    made = life.make_phase()
    assert made["split_revision"] == later["public"]
    assert (made["now"]["part"], made["now"]["n_counted"]) == ("public", n_public)
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    assert (life.board()["part"], life.board()["n_samples"]) == ("public", n_public)


@pytest.mark.parametrize("corrected", PARTS)
def test_the_private_part_of_the_revision_is_closed_until_its_date(
    life: "Life", corrected: str
) -> None:
    later = correct(life, corrected)
    folder = life.worker.splits_dir / "parted"
    write_floors(folder, "private_part_from = 2999-01-01T00:00:00Z")
    life.make_phase(policy={"live_part": "whole"})
    own = life.submit("alpha", CAREFUL)
    for job in due_jobs(life.database):
        score_submission(life.context, job)
    assert life.json("/api/v1/phases/test")["split_revision"] == later[None]
    view = life.json(f"/api/v1/submissions/{own}", "alpha")
    assert (view["status"], view["failure"]["code"]) == ("failed", "split_floor")


@pytest.mark.parametrize("corrected", [*PARTS, "both"])
def test_a_reveal_takes_the_part_as_it_was_corrected_and_tells_of_entries_alone(
    life: "Life", corrected: str
) -> None:
    """Mid-season: where the public part is another, the phase goes there before the deadline."""
    parts = PARTS if corrected == "both" else [corrected]
    life.make_phase(closes_at=life.ahead(60), policy={"late_entries": "own_view"})
    replaced, entry = (life.submit("alpha", way) for way in (PRIVATE_ONLY, PUBLIC_ONLY))
    life.work()
    later = correct(life, *parts)
    if "public" in parts:
        apply(life, life.start_run(split_revision=later["public"]))
    assert life.json(f"/api/v1/submissions/{replaced}", "alpha")["sheet"] is not None
    end(life)
    before = life.board()
    assert life.json("/api/v1/phases/test")["now"]["takes_late_entries"]
    run = life.reveal()
    assert target_of(life, run) == later["private"]
    apply(life, run)
    assert life.board()["n_samples"] == COUNTED["private"] - ("private" in parts)
    sheets = [life.json(f"/api/v1/submissions/{e}", "alpha")["sheet"] for e in (replaced, entry)]
    assert [sheet is not None for sheet in sheets] == [False, True]
    assert not life.json("/api/v1/phases/test")["now"]["takes_late_entries"]
    assert life.upload("beta", CAREFUL).status_code == 403
    shake_up = life.json("/api/v1/phases/test/report")["shake_up"]
    assert (shake_up["board"], shake_up["part"]) == (before["board"], "public")


@pytest.mark.parametrize("corrected", [*PARTS, "both"])
def test_a_correction_after_the_reveal_leaves_it_a_reveal(life: "Life", corrected: str) -> None:
    parts = PARTS if corrected == "both" else [corrected]
    life.make_phase(
        closes_at=life.ahead(60), policy={"late_entries": "own_view", "run_choice": "team"}
    )
    better = life.submit("alpha", PUBLIC_ONLY)
    replaced = life.submit("alpha", PRIVATE_ONLY)
    life.work()
    best = life.request("POST", f"/api/v1/submissions/{replaced}/choose?rule=best", "alpha")
    assert best.status_code == 200, best.text
    end(life)
    before = life.board()
    assert life.entry_ids() == [better], "the best on what teams could see"
    apply(life, life.reveal())
    later = correct(life, *parts)
    if "private" in parts:
        apply(life, life.start_run(split_revision=later["private"]))
    assert life.board()["n_samples"] == COUNTED["private"] - ("private" in parts)
    assert life.entry_ids() == [better]
    assert life.json(f"/api/v1/submissions/{replaced}", "alpha")["sheet"] is None
    assert not life.json("/api/v1/phases/test")["now"]["takes_late_entries"]
    shake_up = life.json("/api/v1/phases/test/report")["shake_up"]
    assert shake_up["board"] == before["board"]
    assert f"board={before['board']}#board" in life.get("/phases/test/report").text


def test_a_run_to_another_part_is_told_the_part_of_that_revision(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    later = correct(life, "public")

    def hint(revision: str) -> str:
        run = life.start_run(split_revision=revision)
        last = life.json(f"/api/v1/organizer/rescoring/{run}", "organizer")["blockers"][-1]
        life.done(f"/rescoring/{run}/cancel")
        return str(last)

    for revision in (later[None], later["private"]):
        assert hint(revision).endswith(f"cancel this run and name {later['public']}.")


def test_what_readers_are_told_of_a_split_waits_until_a_phase_shows_it(life: "Life") -> None:
    """The public part is that of both revisions: the later one is known when its private part is."""
    life.make_phase(closes_at=life.ahead(60))

    def n_samples() -> int:
        return int(life.json("/api/v1/phases/test")["n_samples"])

    n_first = n_samples()
    first, later = life.revisions(), correct(life, "private")

    def known(revision: str | None) -> bool:
        return bool(life.get(f"/splits/parted?revision={revision}").status_code == 200)

    assert (known(first[None]), known(later[None])) == (True, False)
    assert n_samples() == n_first
    end(life)
    apply(life, life.reveal())
    assert (known(first[None]), known(later[None])) == (True, True)
    assert n_samples() == n_first - 1
    assert str(later[None]) in life.get("/splits/parted").text


@pytest.mark.parametrize("told_by", ["words", "datasheet"])
def test_a_revision_that_waits_rewords_nothing_that_the_history_says(
    life: "Life", told_by: str
) -> None:
    """It holds a part that is registered: what readers were told of that stays."""
    life.make_phase()
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    first = life.revisions()["public"]
    second = correct(life, "public")["public"]
    run = life.start_run(split_revision=second)
    apply(life, run)
    sources = ("/history?phase=test", "/feed.atom?phase=test", f"/rescoring/{run}")

    def told() -> list[str]:
        return [
            *(life.get(source).text for source in sources),
            *life.json(f"/api/v1/rescoring/{run}")["changes"],
            *life.json("/api/v1/boards?phase=test")[0]["what_changed"],
        ]

    before = told()
    assert "b goes." in before[0]
    split, folder = split_of(SAMPLES, "parted"), life.worker.splits_dir
    for gone, name in (("bc", "split-waits.json"), ("c", "split-back.json")):
        samples = (
            it.model_copy(update={"withdrawn": "no hazard"}) if it.sample_id in gone else it
            for it in split.samples
        )
        later = split.model_copy(update={"samples": tuple(samples)})
        if told_by == "datasheet":
            changes = SplitChange.between(split, later, "Others.")
            sheet = sample_datasheet(later).model_copy(update={"changes": changes})
            beside = folder / "parted" / name.replace("split", "datasheet")
            beside.write_bytes(canonical_json(sheet))
        add_split(life.database, folder, later, name, "Others." * (told_by == "words"))
    assert told() == before
    with life.database.read() as session:
        said = {row.revision: row.changes for row in list_splits(session)}
    assert said[first] is None, "a run back to it repeats no words"
    held = said[second]
    assert held is not None
    assert held.words == "b goes."
