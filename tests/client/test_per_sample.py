"""Results of samples: they add up to the sheet, and the worst stands first."""

import csv
import json
from pathlib import Path
from statistics import fmean

import pytest
from pyarrow.parquet import read_table
from tests.support.extract import make_extract
from typer.testing import CliRunner

from exceptiondrive import InvalidArgumentError, evaluate_file, evaluate_samples, to_dataframe
from exceptiondrive.cli import app
from exceptiondrive.evaluation import SampleResult, sound_file
from exceptiondrive.plot import Scenes
from exceptiondrive_schemas.protocol import packaged_protocol


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("extract")
    make_extract().write(found)
    return found


def results(folder: Path, planner: str) -> tuple[SampleResult, ...]:
    file = make_extract().path(folder, planner)
    return evaluate_samples(file, split=folder / "split.json.gz")


@pytest.mark.parametrize("planner", ["braking", "wild", "forgetful"])
def test_results_of_samples_have_the_means_of_the_sheet(planner: str, folder: Path) -> None:
    found = results(folder, planner)
    file = make_extract().path(folder, planner)
    sheet = evaluate_file(file, split=folder / "split.json.gz")
    assert len(found) == sheet.n
    for key in ("ur", "hcc", "hpr", "cts", "progress"):
        defined = [value for each in found if (value := getattr(each, key)) is not None]
        assert fmean(defined) == pytest.approx(sheet.micro[key], rel=1e-9), key
    for family, row in sheet.families.items():
        of_family = [each.hcc for each in found if each.family == family]
        assert fmean(of_family) == pytest.approx(row.metrics["hcc"], rel=1e-9)


def test_the_worst_stands_first_and_intrusions_are_told_apart_by_depth(folder: Path) -> None:
    found = results(folder, "wild")
    hits = [each for each in found if each.ur]
    assert hits == list(found[: len(hits)])
    families = {each.family for each in hits}
    assert {each.family for each in hits[: len(families)]} == families
    for family in families:
        depths = [each.depth_m or 0.0 for each in hits if each.family == family]
        assert depths == sorted(depths, reverse=True)
        rest = [each.hcc for each in found[len(hits) :] if each.family == family]
        assert rest == sorted(rest)
    deep = [each.depth_m for each in hits if each.depth_m]
    assert len(set(deep)) > len(hits) / 2
    for each in found:
        if not each.ur:
            assert each.depth_m == 0.0
            assert each.clearance_m is not None
            assert each.hcc == pytest.approx(min(each.clearance_m / each.required_m, 1.0))


def test_the_command_writes_them_as_csv(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.csv"
    file = make_extract().path(folder, "forgetful")
    command = ["evaluate", str(file), "--split", str(folder / "split.json.gz")]
    done = CliRunner().invoke(app, [*command, "--per-sample", str(output)])
    assert done.exit_code == 0, done.stderr
    assert f"160 samples in {output}" in done.stderr
    rows = list(csv.DictReader(output.read_text(encoding="utf-8").splitlines()))
    assert list(rows[0]) == list(SampleResult._fields)
    assert [row["sample_id"] for row in rows] == [
        each.sample_id for each in results(folder, "forgetful")
    ]
    missing = [row for row in rows if row["clearance_m"] == ""]
    assert missing
    assert {row["ur"] for row in missing} == {"1.0"}


def test_the_command_writes_them_as_parquet(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.parquet"
    file = make_extract().path(folder, "forgetful")
    command = ["evaluate", str(file), "--split", str(folder / "split.json.gz")]
    done = CliRunner().invoke(app, [*command, "--per-sample", str(output)])
    assert done.exit_code == 0, done.stderr
    rows = read_table(output).to_pylist()
    assert [SampleResult(**row) for row in rows] == list(results(folder, "forgetful"))


def test_the_worst_pictures_are_spread_over_the_families(folder: Path) -> None:
    sound = sound_file(make_extract().path(folder, "wild"), folder / "split.json.gz", None)
    found = {each.sample_id: each for each in results(folder, "wild")}
    families = {each.family for each in found.values()}
    shown = Scenes(*sound[:3]).worst(len(families))
    assert {found[each].family for each in shown} == families
    for sample_id in shown:
        one = found[sample_id]
        rivals = [each for each in found.values() if each.family == one.family]
        answered = [each for each in rivals if each.clearance_m is not None]
        assert one.ur == max(each.ur for each in answered)
        assert (one.depth_m or 0.0) == max(each.depth_m or 0.0 for each in answered)


def test_they_become_a_data_frame(folder: Path) -> None:
    found = results(folder, "braking")
    table = to_dataframe(found)
    assert list(table.columns) == list(SampleResult._fields)
    assert table["hcc"].mean() == pytest.approx(fmean(each.hcc for each in found))


def test_a_strategy_file_has_none(tmp_path: Path, folder: Path) -> None:
    ids = [each["sample_id"] for each in make_extract().split["samples"]]
    document = {
        "schema": "exceptiondrive.strategy/1",
        "split": "extract",
        "predictions": [{"sample_id": each, "strategy": "C"} for each in ids],
    }
    file = tmp_path / "strategy.json"
    file.write_text(json.dumps(document))
    with pytest.raises(InvalidArgumentError, match="Only planning files"):
        evaluate_samples(file, split=folder / "split.json.gz", protocol=packaged_protocol())


def test_a_table_of_no_known_ending_is_refused_before_anything_is_scored(
    folder: Path, tmp_path: Path
) -> None:
    file = make_extract().path(folder, "braking")
    output = tmp_path / "out.xlsx"
    command = ["evaluate", str(file), "--split", str(folder / "split.json.gz")]
    done = CliRunner().invoke(app, [*command, "--per-sample", str(output)])
    assert done.exit_code == 2
    assert ".csv, .csv.gz or .parquet" in done.stderr
    assert not output.exists()
