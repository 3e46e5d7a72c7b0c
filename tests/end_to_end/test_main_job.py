"""The main job with every real part: files of planners, the client, the API, the worker, the board.

On the made extract, which everybody has, each number is held against the naive scorer of the tests;
on the files of real planners too, where they are. Each test makes what it looks at, once a module.
"""

import csv
import gzip
import html
import io
import json
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support import extract, naive_scorer, realdata
from tests.support.floors import leave_open
from tests.support.processes import wait_until
from tests.support.reference import held_to
from tests.support.system import System, running_system

from exceptiondrive import evaluate_file
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.store import load_split
from exceptiondrive_worker.stages import Scored

pytestmark = [pytest.mark.slow]
MADE = extract.make_extract()
PLANNERS = {extract.NAME: tuple(MADE.files), **realdata.PLANNERS}
N_SAMPLES = {extract.NAME: extract.N_SAMPLES, **realdata.N_SAMPLES}
EVERY_FILE = [(phase, method) for phase, methods in PLANNERS.items() for method in methods]
SHOWN = {
    "hcc": 0.00005,
    "ur": 0.00005,
    "hpr": 0.00005,
    "cts": 0.005,
    "cts_x": 0.005,
    "cts_y": 0.005,
}
"""Half of the last published digit: hundredths of a per cent, centimetres."""
SWAP = "looks like x right / y forward: swap to (y, -x)"
WATCH_S = 120.0


class Job:
    """A running system, its splits and files, and what was submitted to it so far."""

    def __init__(self, system: System, folder: Path) -> None:
        self.system = system
        self.token = system.make_team("testers")
        self._folder = folder
        self._submitted: dict[tuple[str, str], dict[str, Any]] = {}
        self._naive: dict[tuple[str, str], naive_scorer.Sheet] = {}

    def file(self, phase: str, method: str) -> Path:
        if phase == extract.NAME:
            return MADE.path(self._folder, method)
        realdata.require()
        return realdata.file_path(phase, method)

    def split(self, phase: str) -> Path:
        return self.system.splits / phase / "split.json.gz"

    def submit(self, phase: str, method: str) -> dict[str, Any]:
        """Submit with the client, and wait for the score."""
        options = ("--phase", phase, "--method", method, "--allow-unranked", "--wait", "--json")
        done = self.system.client("submit", self.file(phase, method), *options, token=self.token)
        assert done.returncode == 0, done.stderr
        submission: dict[str, Any] = json.loads(done.stdout)
        return submission

    def submitted(self, phase: str, method: str) -> dict[str, Any]:
        """Return what a file became; it is submitted when it is first asked for."""
        key = (phase, method)
        if key not in self._submitted:
            self._submitted[key] = self.submit(phase, method)
        return self._submitted[key]

    def naive(self, phase: str, method: str) -> naive_scorer.Sheet:
        """Return the exact score by plain loops."""
        key = (phase, method)
        if key not in self._naive:
            content, split = self.file(*key).read_bytes(), self.split(phase).read_bytes()
            self._naive[key] = naive_scorer.score(content, naive_scorer.read(split))
        return self._naive[key]

    def exact_digest(self, submission_id: str) -> str:
        """Return the digest of the unrounded sheet that the records hold."""
        with sqlite3.connect(self.system.data / "records.sqlite3") as records:
            ((digest,),) = records.execute(
                "SELECT exact_digest FROM score_sheets WHERE submission_id = ?", (submission_id,)
            )
        return str(digest)

    def regions_digest(self, phase: str) -> str:
        """Return the digest of all regions of a split, which is the key of those digests."""
        split = Split.model_validate_json(gzip.decompress(self.split(phase).read_bytes()))
        return load_split(split, packaged_protocol()).regions_digest

    def board(self, phase: str) -> dict[str, Any]:
        """Return the board on which all planners of a phase stand."""
        ids = {self.submitted(phase, method)["id"] for method in PLANNERS[phase]}

        def has_all() -> bool:
            entries = self.system.get(f"/leaderboard?phase={phase}")["entries"]
            return ids <= {entry["submission_id"] for entry in entries}

        wait_until(has_all, "a board with all planners", WATCH_S)
        board: dict[str, Any] = self.system.get(f"/leaderboard?phase={phase}")
        return board

    def wait_for(self, submission_id: str, status: str) -> dict[str, Any]:
        """Wait for a status of a submission; return what its team is told then."""
        wait_until(lambda: self._told(submission_id)["status"] == status, status, WATCH_S)
        return self._told(submission_id)

    def _told(self, submission_id: str) -> dict[str, Any]:
        return self.system.submission(self.token, submission_id)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Job]:
    """A system with a phase on each split that is here, and a team."""
    base = tmp_path_factory.mktemp("system")
    MADE.write(base / "files")
    sources = {extract.NAME: base / "files" / "split.json.gz"}
    if realdata.is_here():
        sources |= {name: realdata.split_path(name) for name in realdata.PLANNERS}
    for name, source in sources.items():
        leave_open(base / "splits" / name)
        shutil.copy(source, base / "splits" / name / "split.json.gz")
    with running_system(base / "data", base / "splits") as system:
        system.work("register-splits")
        for name in sources:
            system.open_phase(name, name, "--shows-reported")
        system.open_phase("disturbed", extract.NAME)
        yield Job(system, base / "files")


def assert_exact(computed: dict[str, Any], naive: naive_scorer.Sheet) -> None:
    """Every mean of a sheet is the naive one, to 1e-9."""
    assert computed["n"] == naive["n"]
    for key in ("coverage", "micro", "macro_family"):
        assert held_to(computed[key], naive[key]) == pytest.approx(naive[key], abs=1e-9)
    for part in ("families", "tasks"):
        assert computed[part].keys() == naive[part].keys()
        for name, row in naive[part].items():
            assert held_to(computed[part][name], row) == pytest.approx(row, abs=1e-9)


def assert_published(row: dict[str, Any], naive: dict[str, Any]) -> None:
    """A published row is the naive one to the digits that the protocol publishes."""
    for metric, half_m in SHOWN.items():
        value = naive[metric]
        if value is None:
            assert row[metric] is None
        else:
            assert row[metric] == pytest.approx(value, abs=half_m + 1e-9)
            assert row[metric] == round(row[metric], 4 if half_m < 0.001 else 2)


@pytest.mark.parametrize(("phase", "method"), EVERY_FILE)
def test_a_planners_file_is_scored(job: Job, phase: str, method: str) -> None:
    submission, naive = job.submitted(phase, method), job.naive(phase, method)
    assert submission["status"] == "scored"
    sheet = submission["sheet"]
    assert sheet["n"] == naive["n"] == N_SAMPLES[phase]
    assert_published(sheet["micro"], naive["micro"])
    assert_published(sheet["macro_family"], naive["macro_family"])
    for part in ("families", "tasks"):
        assert sheet[part].keys() == naive[part].keys()
        for name, row in naive[part].items():
            assert sheet[part][name]["n"] == row["n"]
            assert_published(sheet[part][name], row)


@pytest.mark.parametrize(("phase", "method"), EVERY_FILE)
def test_the_worker_scored_bit_for_bit_what_evaluate_computes_at_home(
    job: Job, phase: str, method: str
) -> None:
    submitted = job.submitted(phase, method)
    sheet = evaluate_file(job.file(phase, method), split=job.split(phase), protocol="1.0")
    assert_exact(sheet.model_dump(mode="json", by_alias=True), job.naive(phase, method))
    at_home = Scored(sheet, measurement_key="", regions_digest=job.regions_digest(phase))
    assert job.exact_digest(submitted["id"]) == at_home.digest


@pytest.mark.parametrize(("phase", "method"), [(extract.NAME, "wild"), *realdata.WITH_REFERENCE])
def test_evaluate_prints_the_reference_scores(job: Job, phase: str, method: str) -> None:
    arguments = (job.file(phase, method), "--split", job.split(phase), "--json")
    done = job.system.client("evaluate", *arguments)
    assert done.returncode == 0, done.stderr
    computed = json.loads(done.stdout)
    assert_exact(computed, job.naive(phase, method))
    if phase in realdata.PLANNERS:
        golden = json.loads((realdata.GOLDEN / f"{phase}.{method}.json").read_text("utf-8"))
        for key in ("micro", "macro_family"):
            assert held_to(computed[key], golden[key]) == pytest.approx(golden[key], abs=1e-9)
        for part in ("families", "tasks"):
            assert set(computed[part]) == set(golden[part])
            for name, row in golden[part].items():
                assert held_to(computed[part][name], row) == pytest.approx(row, abs=1e-9)


@pytest.fixture(params=list(PLANNERS))
def phase(request: pytest.FixtureRequest) -> str:
    """Each phase whose files are here."""
    if request.param in realdata.PLANNERS:
        realdata.require()
    return str(request.param)


def test_the_board_ranks_by_hcc_then_ur_and_leaves_low_coverage_unranked(
    job: Job, phase: str
) -> None:
    board = job.board(phase)
    scored = {e["method"]: e for e in board["entries"] if e["source"] == "scored"}
    assert set(scored) == set(PLANNERS[phase])
    for method, entry in scored.items():
        assert_published(entry["metrics"], job.naive(phase, method)["macro_family"])
    ranks = naive_scorer.ranked(
        {method: job.naive(phase, method) for method in scored},
        {method: entry["metrics"] for method, entry in scored.items()},
    )
    assert {method: entry["rank"] for method, entry in scored.items()} == ranks
    places = [entry["rank"] for entry in scored.values() if entry["rank"]]
    assert places == sorted(places)


def test_equal_published_values_share_a_rank(job: Job) -> None:
    entries = {e["method"]: e for e in job.board(extract.NAME)["entries"]}
    one, other = (entries[method] for method in extract.TWINS)
    assert one["submission_id"] != other["submission_id"]
    assert (one["metrics"]["hcc"], one["rank"]) == (other["metrics"]["hcc"], other["rank"])


@pytest.mark.parametrize(
    ("phase", "method", "words"),
    [
        (extract.NAME, extract.UNRANKED, "66.25% of the samples as edited and"),
        ("nuscenes-real", "gpt-4.1", "66.96%"),
    ],
)
def test_who_covers_too_little_is_told_why_there_is_no_rank(
    job: Job, phase: str, method: str, words: str
) -> None:
    job.file(phase, method)  # skips where the real files are absent
    entry = next(e for e in job.board(phase)["entries"] if e["method"] == method)
    assert entry["rank"] is None
    assert words in entry["unranked_because"]


def test_the_papers_rows_stand_apart_and_are_never_ranked(job: Job, phase: str) -> None:
    board = job.board(phase)
    sources = [entry["source"] for entry in board["entries"]]
    reported = [entry for entry in board["entries"] if entry["source"] == "reported"]
    assert len(reported) == 7
    assert all(entry["rank"] is None for entry in reported)
    assert sources == sorted(sources, key=("scored", "reference", "reported").index)


def test_page_and_csv_say_the_numbers_of_the_board(job: Job, phase: str) -> None:
    board = job.board(phase)
    scored = {e["submission_id"]: e for e in board["entries"] if e["source"] == "scored"}
    table = csv.DictReader(io.StringIO(job.system.read(f"/api/v1/leaderboard.csv?phase={phase}")))
    lines = {line["submission_id"]: line for line in table if line["submission_id"]}
    assert lines.keys() == scored.keys()
    page = job.system.read(f"/?phase={phase}")
    for submission_id, entry in scored.items():
        line = lines[submission_id]
        assert line["rank"] == str(entry["rank"] or "")
        for metric, value in entry["metrics"].items():
            assert (float(line[metric]) if line[metric] else None) == value
        words = _row_of(page, submission_id)
        assert entry["method"] in words
        for metric in ("hcc", "ur"):
            assert f"{100 * entry['metrics'][metric]:.1f}" in words
        if entry["rank"]:
            assert str(entry["rank"]) in words


def _row_of(page: str, submission_id: str) -> list[str]:
    """Return the texts of the page's first table row that leads to an entry."""
    rows = re.findall(r"<tr\b.*?</tr>", page, re.DOTALL)
    row = next(row for row in rows if f"/entries/{submission_id}" in row)
    return [html.unescape(text).strip() for text in re.split(r"<[^>]*>", row) if text.strip()]


def test_the_same_bytes_again_are_the_first_submission(job: Job, phase: str) -> None:
    method = PLANNERS[phase][-1]
    first, again = job.submitted(phase, method), job.submit(phase, method)
    assert again["id"] == first["id"]
    assert again["is_duplicate"]


def test_the_wrong_frame_is_refused_by_the_client_before_anything_is_sent(
    job: Job, phase: str, wrong_frame: Callable[[str], Path]
) -> None:
    options = ("--phase", phase, "--method", "Wrong frame", "--json")
    done = job.system.client("submit", wrong_frame(phase), *options, token=job.token)
    assert done.returncode == 2
    assert SWAP in done.stdout + done.stderr


def test_the_server_refuses_the_wrong_frame_with_the_same_words(
    job: Job, phase: str, wrong_frame: Callable[[str], Path]
) -> None:
    """Sent past the client's own check, as a script might."""
    file = wrong_frame(phase)
    at_home = job.system.client("check", file, "--phase", phase, "--json", token=job.token)
    assert at_home.returncode == 2
    submission = job.system.post(job.token, file, phase, "Wrong frame")
    there = job.wait_for(submission["id"], "rejected")["report"]
    assert there["faults"] == json.loads(at_home.stdout)["faults"]


@pytest.fixture
def wrong_frame(job: Job, tmp_path: Path) -> Callable[[str], Path]:
    """Writes a file of a phase anew in a planner's usual wrong frame: x right, y forward."""

    def write(phase: str) -> Path:
        method = "recorded-human" if phase == "nuscenes-real" else PLANNERS[phase][0]
        target = tmp_path / "wrong-frame.json"
        target.write_bytes(extract.in_wrong_frame(job.file(phase, method).read_bytes()))
        return target

    return write


def test_a_planners_file_of_another_split_is_refused_too(job: Job) -> None:
    realdata.require()
    done = job.system.client("check", realdata.wrong_frame_path())
    assert done.returncode == 2
    assert SWAP in done.stdout + done.stderr


def test_killing_the_worker_and_emptying_the_broker_loses_and_doubles_nothing(
    job: Job, tmp_path: Path
) -> None:
    sent: dict[str, bytes] = {}
    for number in range(12):
        varied = extract.varied(MADE.files["wild"], number + 1)
        (tmp_path / "varied.json").write_bytes(varied)
        made = job.system.post(
            job.token, tmp_path / "varied.json", "disturbed", f"Variation {number}"
        )
        sent[made["id"]] = varied
        if number in (3, 7):
            job.system.kill_workers()
        if number == 9:
            job.system.empty_broker()
    for submission_id, varied in sent.items():
        told = job.wait_for(submission_id, "scored")
        naive = naive_scorer.score(varied, MADE.split)
        assert_published(told["sheet"]["macro_family"], naive["macro_family"])
    counted = [each["id"] for each in job.system.submissions(job.token)]
    assert sorted(each for each in counted if each in sent) == sorted(sent)
    assert "the audit log is intact" in job.system.organize("audit", "verify")
    job.system.operate("exceptiondrive-server", "verify")
