"""The numbers of a workshop: the paper's counts give the paper's figures."""

import json
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.build.test_stages import report as run_report
from typer.testing import CliRunner

from exceptiondrive_build.candidates import (
    Candidate,
    asked,
    walk,
)
from exceptiondrive_build.cli import app
from exceptiondrive_build.inspection import draw
from exceptiondrive_build.numbers import audit_plan, draw_for, finite_population
from exceptiondrive_build.prompts import Prompts
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.report import Report, report, shares_fit
from exceptiondrive_build.scenes.keyframe import Camera, Keyframe
from exceptiondrive_build.values import (
    Change,
    Edited,
    Inspected,
    Mark,
    Reviewed,
    Screened,
    ViewEdit,
)
from exceptiondrive_build.workshop import Workshop, new_workshop
from exceptiondrive_schemas.base import Document

PAPER_FAMILY_SHARES = {
    "sudden_emergence": 25.56,
    "lane_blockage": 19.75,
    "bypass_and_gap_conflict": 24.96,
    "signal_and_rule_conflict": 3.60,
    "intersection_conflict": 9.10,
    "road_surface_hazard": 17.03,
}
SCENES, SUITABLE, ACCEPTED, DRAWN, INSPECTED, PASSED = 850, 3446, 3181, 8994, 168, 163
CAMERA = Camera(
    view="CAM_FRONT",
    image=f"{'0' * 64}.jpg",
    width_px=1600,
    height_px=900,
    intrinsic=((1266.0, 0.0, 800.0), (0.0, 1266.0, 450.0), (0.0, 0.0, 1.0)),
    camera_from_ego=((0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.5), (1.0, 0.0, 0.0, -1.7)),
)


class Deciding:
    """Appends decisions as the models and people of a workshop would have taken them."""

    def __init__(self, workshop: Workshop) -> None:
        self.workshop, self.prompts = workshop, Prompts(workshop)
        self.records: list[Record] = []

    def screen(self, candidate: Candidate, suitable: bool) -> None:
        by = asked(Kind.SCREEN, self.workshop, self.prompts, candidate)
        place = Screened(
            suitable=True,
            target_m=(12.0, 0.0),
            views=(ViewEdit(view="CAM_FRONT", instruction="here"),),
        )
        rejected = Screened(
            suitable=False,
            reason=next(iter(self.workshop.task_texts[candidate.task.id].rejections)),
        )
        self._decide(Kind.SCREEN, candidate, by, place if suitable else rejected)
        if suitable:
            candidate.place = place

    def edit(self, candidate: Candidate) -> None:
        assert candidate.place is not None
        by = asked(Kind.EDIT, self.workshop, self.prompts, candidate)
        view = candidate.place.views[0].view
        value = Edited(images={view: f"{candidate.sample_id * 4}.png"})
        candidate.current[Kind.EDIT] = self._decide(Kind.EDIT, candidate, by, value)

    def review(self, candidate: Candidate, accepted: bool) -> None:
        by = asked(Kind.REVIEW, self.workshop, self.prompts, candidate)
        marks = dict.fromkeys(Mark, 5) | ({} if accepted else {Mark.VISIBILITY: 1})
        changes = {"CAM_FRONT": Change(inside=0.5, outside=0.01)}
        self._decide(Kind.REVIEW, candidate, by, Reviewed(marks=marks, changes=changes))

    def inspect(self, candidate: Candidate, passed: bool) -> None:
        asked = (Author(person="ada"), candidate.pictures)
        self._decide(Kind.INSPECT, candidate, asked, Inspected(passed=passed))

    def _decide(
        self,
        kind: Kind,
        candidate: Candidate,
        asked: tuple[Author, tuple[str, ...]],
        value: Document,
    ) -> Record:
        by, inputs = asked
        told = value.model_dump(mode="json", exclude_none=True)
        record = Record(kind=kind, candidate=candidate.sample_id, by=by, inputs=inputs, value=told)
        self.records.append(record)
        return record

    def append(self) -> None:
        self.workshop.records.append(*self.records)
        self.records.clear()


def walk_of(folder: Path) -> Callable[[Workshop], dict[str, Candidate]]:
    """Walk a workshop once, in which nothing changes any more; any other one is walked as ever."""

    @cache
    def walked() -> dict[str, Candidate]:
        with Workshop(folder) as workshop:
            return walk(workshop)

    return lambda workshop: walked() if workshop.folder == folder else walk(workshop)


@pytest.fixture(scope="module")
def papers_shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A workshop with the paper's counts: 850 scenes, 21 tasks."""
    folder = tmp_path_factory.mktemp("paper") / "shop"
    new_workshop(folder, "exceptiondrive", "0" * 64)
    settings = folder / "workshop.toml"
    text = settings.read_text().replace("draw = 0", f"draw = {DRAWN}")
    shares = ", ".join(f"{family} = {share}" for family, share in PAPER_FAMILY_SHARES.items())
    settings.write_text(
        text.replace("tasks = []", f"tasks = []\nprinted_family_shares = {{ {shares} }}")
    )
    lines = (
        Keyframe(keyframe_id=f"k{n}", scene_id=f"s{n}", cameras=(CAMERA,)).model_dump_json()
        for n in range(SCENES)
    )
    (folder / "scenes.jsonl").write_text("\n".join(lines) + "\n")
    with Workshop(folder) as workshop:
        deciding = Deciding(workshop)
        ordered = sorted(walk(workshop).values(), key=lambda candidate: candidate.sample_id)
        for number, candidate in enumerate(ordered):
            deciding.screen(candidate, number < SUITABLE)
            if number < SUITABLE:
                deciding.edit(candidate)
                deciding.review(candidate, number < ACCEPTED)
        deciding.append()
        candidates = walk(workshop)
        for candidate in candidates.values():
            if candidate.place is not None and not candidate.is_suitable:
                deciding.edit(candidate)
        drawn = draw(candidates, workshop.settings.inspect)
        for number, sample_id in enumerate(drawn):
            deciding.inspect(candidates[sample_id], number < PASSED)
        deciding.append()
    with pytest.MonkeyPatch.context() as patch:
        walked = walk_of(folder)
        for module in ("report", "numbers"):
            patch.setattr(f"exceptiondrive_build.{module}.walk", walked)
        yield folder


@pytest.fixture(scope="module")
def papers(papers_shop: Path) -> Report:
    with Workshop(papers_shop) as workshop:
        return report(workshop)


def test_the_papers_counts_give_the_papers_figures(papers: Report) -> None:
    found = {line.id: (line.n, line.percent) for line in papers.funnel}
    assert found["combinations"] == (17_850, 100.0)
    assert found["suitable"] == (3_446, 19.31)
    assert found["accepted"] == (3_181, 92.31)
    assert found["rejected"] == (265, 7.69)
    assert found["inspected"] == (168, 5.28)
    assert found["passed"] == (163, 97.02)
    assert found["drawn"][0] == 8_994
    assert found["auxiliary"][0] == 9_259
    assert found["pairs"][0] == 12_440
    assert found["kept"][0] == 3_176
    assert papers.rejected_because["low_mark:visibility"] == 265


def test_the_audit_has_both_intervals(papers: Report) -> None:
    assert papers.audit is not None
    assert papers.audit.wilson == pytest.approx((0.9323, 0.9872), abs=1e-4)
    low, high = papers.audit.finite_population
    assert papers.audit.wilson[0] < low < 0.9702 < high < papers.audit.wilson[1]


def test_the_report_notes_what_the_printed_family_shares_fit(papers: Report) -> None:
    (note,) = papers.notes
    assert note == (
        "The printed family shares fit the 12,440 source and edited pairs in all; no whole numbers "
        "of the 3,181 accepted by the review, the 9,259 auxiliary, with those that the review rejected."
    )


def test_where_every_total_fits_no_other_is_told(shop: Path) -> None:
    settings = shop / "workshop.toml"
    shares = "printed_family_shares = { sudden_emergence = 100.0 }"
    settings.write_text(f"{shares}\n{settings.read_text()}")
    for stage in ("screen", "edit", "review"):
        run_report(shop, stage)
    with Workshop(shop) as workshop:
        (note,) = report(workshop).notes
    assert note.endswith("source and edited pairs in all.")
    assert "no whole numbers" not in note


def test_families_and_tasks_add_up(papers: Report) -> None:
    for parts in (papers.families, papers.tasks):
        assert sum(cell.candidates for cell in parts) == 17_850
        assert sum(cell.suitable for cell in parts) == 3_446
        assert sum(cell.accepted for cell in parts) == 3_176


def test_no_sample_is_named(papers_shop: Path, papers: Report) -> None:
    with Workshop(papers_shop) as workshop:
        named = {workshop.sample_id(k, t.id) for k in workshop.keyframes for t in workshop.tasks}
    assert len(named) == 17_850
    assert not named & set(re.findall(r"[0-9a-f]{16}", papers.model_dump_json()))


def test_the_command_prints_and_draws_it(papers_shop: Path, tmp_path: Path) -> None:
    picture = tmp_path / "report.svg"
    command = ["report", "-w", str(papers_shop), "--plot", str(picture)]
    printed = CliRunner().invoke(app, command)
    assert printed.exit_code == 0, printed.output
    for words in ("19.31", "92.31", "163 of 168 passed, 97.02%", "12,440", "visibility"):
        assert words in printed.stdout
    told = re.findall(r"^unsuitable: ([\d,]+) (.*)", printed.stdout, re.MULTILINE)
    assert sum(int(n.replace(",", "")) for n, _ in told) == 17_850 - 3_446
    assert told[-1][1] == "of 11 further kinds: --json"
    assert picture.read_bytes().startswith(b"<?xml")
    as_json = json.loads(CliRunner().invoke(app, [*command[:3], "--json"]).stdout)
    assert as_json["funnel"][2]["n"] == 3_446


@pytest.mark.parametrize(
    ("name", "said"), [("none/report.svg", "No such file or directory."), ("report.xyz", "'xyz'")]
)
def test_a_picture_that_cannot_be_drawn_is_named_with_why(
    papers_shop: Path, tmp_path: Path, name: str, said: str
) -> None:
    path = tmp_path / name
    result = CliRunner().invoke(app, ["report", "-w", str(papers_shop), "--plot", str(path)])
    assert result.exit_code == 2
    assert f"{path}: " in result.stderr
    assert said in result.stderr
    assert "Errno" not in result.stderr
    assert "163 of 168 passed" in result.stdout


def test_time_and_money_are_of_all_answers_so_far(shop: Path) -> None:
    with (shop / "workshop.toml").open("a") as file:
        file.write("[prices.vision-model]\nprompt = 1000.0\ncompletion = 2000.0\n")
        file.write("[prices.editing-model]\nimage = 0.5\n")
    run_report(shop, "screen", "--limit", "10")
    run_report(shop, "edit")
    with Workshop(shop) as workshop:
        found = report(workshop)
    screen, edit, review = found.spent
    assert (screen.calls, screen.prompt_tokens, screen.completion_tokens) == (10, 10_000, 500)
    assert screen.cost == pytest.approx(10 * 1.1)
    assert screen.left.calls == 8
    assert edit.calls > 0
    assert edit.cost == pytest.approx(0.5 * edit.calls)
    assert (review.calls, review.left.candidates) == (0, found.line("edited").n)
    assert found.audit is None


@given(st.lists(st.integers(1, 500), min_size=2, max_size=6))
def test_shares_of_whole_numbers_fit_their_total(counts: list[int]) -> None:
    total = sum(counts)
    assert shares_fit(_printed(counts, total), total)


def _printed(counts: list[int], total: int) -> Iterable[float]:
    return [round(100 * count / total, 2) for count in counts]


def test_a_plan_says_the_smallest_draw_that_is_narrow_enough(papers_shop: Path) -> None:
    with Workshop(papers_shop) as workshop:
        plan = audit_plan(workshop)
    assert plan.share == pytest.approx(163 / 168)
    for row in plan.rows:
        low, high = finite_population(plan.share, row.draw, plan.accepted)
        assert high - low <= row.width
        low, high = finite_population(plan.share, row.draw - 1, plan.accepted)
        assert high - low > row.width
    printed = CliRunner().invoke(app, ["audit", "plan", "-w", str(papers_shop), "--share", "0.9"])
    assert f"{draw_for(0.05, 0.9, ACCEPTED):,}" in printed.stdout


def test_nothing_accepted_cannot_be_audited(shop: Path) -> None:
    result = CliRunner().invoke(app, ["audit", "plan", "-w", str(shop)])
    assert result.exit_code == 2
    assert "No edit is accepted" in result.stderr
