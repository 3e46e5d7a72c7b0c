"""The export of a phase: the same bytes twice, nothing that readers may not see, valid records."""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import jsonschema
import pandas as pd
import pytest
import tests.support
from tests.canary.values import CANARY_M
from tests.phases.browsing import visitor
from tests.phases.life import CAREFUL, PRIVATE_ONLY, PUBLIC_ONLY

from exceptiondrive_server.submissions.download import PIECE_BYTES, written_down

if TYPE_CHECKING:
    from tests.phases.life import Life

EXPORT = "/api/v1/organizer/phases/test/export"
SHARED = Path(tests.support.__path__[0]) / "every_eval_ever" / "eval.schema.json"
"""Of github.com/evaleval/every_eval_ever at 8afa738d5, MIT: its licence lies beside it."""


def files_of(life: "Life") -> dict[str, bytes]:
    """The files of the export, by their path within its folder."""
    answer = life.get(EXPORT, "organizer")
    assert answer.status_code == 200, answer.text
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as tar:
        members = [(one.name, tar.extractfile(one)) for one in tar.getmembers()]
    return {name.split("/", 1)[1]: file.read() for name, file in members if file is not None}


@pytest.fixture
def ended(life: "Life") -> "Life":
    life.make_phase(closes_at=life.ahead(60))
    life.submit("alpha", PUBLIC_ONLY, "=1+1 & Co")
    life.submit("beta", PRIVATE_ONLY)
    life.submit("gamma", CAREFUL)
    life.work()
    life.move(closes_at=life.now())
    life.apply(life.reveal())
    return life


def test_it_holds_what_readers_see_and_is_the_same_twice(ended: "Life") -> None:
    first = ended.get(EXPORT, "organizer").content
    assert ended.get(EXPORT, "organizer").content == first
    line = ended.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    assert (line["action"], line["subject"]) == ("phase exported", "test")
    files = files_of(ended)
    report = ended.json("/api/v1/phases/test/report")
    assert json.loads(files["report.json"]) == report
    for number in (report["board"], report["shake_up"]["board"]):
        public = ended.get(f"/api/v1/boards/test/{number}").content
        assert files[f"boards/board-{number}.json"] == public
        table = ended.get(f"/export/board.tex?phase=test&board={number}").content
        assert files[f"boards/board-{number}.tex"] == table
    assert json.loads(files["history.json"]) == ended.json("/api/v1/boards?phase=test")
    toml = ended.get("/api/v1/protocols/1.0?format=toml").content
    assert files["protocols/1.0.toml"] == toml
    for key in ended.entry_ids():
        sheet = ended.json(f"/api/v1/entries/{key}")["sheet"]
        assert json.loads(files[f"sheets/{key}.json"]) == sheet
    for name in files.keys() - {"README.md"}:
        folder = name.split("/")[0]
        assert folder.split(".")[0] in files["README.md"].decode(), name


def test_the_table_holds_every_number_of_every_sheet_in_both_forms(ended: "Life") -> None:
    files = files_of(ended)
    table = pd.read_parquet(io.BytesIO(files["results.parquet"]))
    assert len(table) == len(pd.read_csv(io.BytesIO(files["results.csv"])))
    for line in table.to_dict("records"):
        sheet = json.loads(files[f"sheets/{line['submission_id']}.json"])
        scope, name = line["scope"], line["id"]
        if scope == "average":
            row = sheet[name]
        else:
            row = sheet["families" if scope == "family" else "tasks"][name]
        for metric, value in row.items():
            told = line[metric]
            assert (value is None and pd.isna(told)) or told == value, (scope, name, metric)
    assert "'=1+1 & Co" in set(table["method"]), "no formula for a spreadsheet"
    board = ended.board()
    named = table[["phase", "board", "protocol", "split_revision"]].drop_duplicates()
    (told,) = named.itertuples(index=False, name=None)
    under = (board["protocol"]["version"], board["split"]["revision"])
    assert told == ("test", board["board"], *under)


def test_it_says_under_which_licence_the_scenes_are(life: "Life") -> None:
    life.make_phase()
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    assert b"Licence" not in files_of(life)["README.md"]
    page = {"data_licence": "CC BY-NC-SA 4.0"}
    life.done("/phases/test", {"page": page}, "PATCH")
    assert b"\nLicence of its scenes: CC BY-NC-SA 4.0\n" in files_of(life)["README.md"]


def test_nothing_of_regions_and_no_unshown_part_is_in_it(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    life.reveal()  # scored, and not applied: readers see nothing of it
    files = files_of(life)
    assert "report.json" not in files
    everything = b"\n".join(files.values())
    board = life.board()
    assert board["split"]["revision"].encode() in everything
    for secret in (life.revisions()["private"], str(CANARY_M), "scene-"):
        assert secret.encode() not in everything, secret
    for who in (None, "alpha"):
        assert life.get(EXPORT, who).status_code in (401, 403)


class _Part(bytes):
    """Bytes that are counted while anything holds them."""

    alive = 0

    def __init__(self, _: bytes) -> None:
        type(self).alive += 1

    def __del__(self) -> None:
        type(self).alive -= 1


def test_what_is_written_down_is_taken_one_by_one_and_comes_back_whole() -> None:
    def parts() -> Iterator[bytes]:
        for n in range(5):
            assert _Part.alive <= 1, "only the part before this one may still be held"
            yield _Part(bytes([n]) * PIECE_BYTES)

    pieces = list(written_down(parts()))
    assert [len(one) for one in pieces] == [PIECE_BYTES] * 5
    assert b"".join(pieces) == b"".join(bytes([n]) * PIECE_BYTES for n in range(5))


def test_a_phase_without_a_board_has_no_export(life: "Life") -> None:
    life.make_phase()
    assert life.get(EXPORT, "organizer").status_code == 404
    page = visitor(life, "organizer")
    assert "/export" not in page.get("/organize/phases/test").text
    life.submit("alpha", CAREFUL)
    life.work()
    assert "/organize/phases/test/export" in page.get("/organize/phases/test").text


def test_entries_are_records_of_every_eval_ever(ended: "Life") -> None:
    validator = jsonschema.Draft7Validator(json.loads(SHARED.read_text()))
    found = {
        name.removeprefix("every_eval_ever/"): json.loads(data)
        for name, data in files_of(ended).items()
        if name.startswith("every_eval_ever/")
    }
    board = ended.board()
    assert len(found) == len(board["entries"]) == 3
    by_id = {entry["submission_id"]: entry for entry in board["entries"]}
    for path, record in found.items():
        assert [error.message for error in validator.iter_errors(record)] == []
        assert path.startswith(f"data/exceptiondrive/{record['model_info']['id']}/")
        entry = by_id[record["evaluation_id"].split("/")[1]]
        scores = {one["evaluation_result_id"]: one for one in record["evaluation_results"]}
        assert len(scores) == len(record["evaluation_results"])
        for metric in ("hcc", "ur"):
            score = scores[f"exceptiondrive.test.{metric}"]
            assert score["score_details"]["score"] == entry["metrics"][metric]
            assert score["metric_config"]["lower_is_better"] is (metric == "ur")
            limits = score["metric_config"]
            assert limits["min_score"] <= score["score_details"]["score"] <= limits["max_score"]
        for family, cell in entry["families"].items():
            score = scores[f"exceptiondrive.test.{family}.hcc"]["score_details"]
            assert (score["score"], score["uncertainty"]["num_samples"]) == (cell["hcc"], cell["n"])


def test_the_package_of_every_eval_ever_takes_them(ended: "Life", tmp_path: Path) -> None:
    """Its own validator, where the package is installed (it needs Python 3.12)."""
    validate = pytest.importorskip("every_eval_ever.validate", reason="every-eval-ever is absent")
    for name, data in files_of(ended).items():
        if name.startswith("every_eval_ever/"):
            file = tmp_path / name.removeprefix("every_eval_ever/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            report = validate.validate_file(file)
            assert report.valid, report.errors
