"""Wrong scores and leaks are found, which no rule over the records alone could see."""

import json
from pathlib import Path

import pytest
from tests.canary.values import CANARY_M
from tests.chaos.checker_scores import LeakSearch, Rescorer, differences
from tests.chaos.clients import planning_file

from exceptiondrive.inputs import given_split
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_worker.sample.files import write_sample_split


@pytest.fixture(scope="module")
def rescorer(tmp_path_factory: pytest.TempPathFactory) -> Rescorer:
    split = given_split(write_sample_split(tmp_path_factory.mktemp("splits")))
    return Rescorer(split, packaged_protocol())


def test_the_score_of_another_file_is_found(rescorer: Rescorer) -> None:
    ids = [sample.sample_id for sample in rescorer.split.samples]
    slow, fast = (rescorer.sheet_of(planning_file(ids, mps)) for mps in (1.0, 8.0))
    assert differences(slow, slow) == []
    assert ".macro_family.hcc" in differences(slow, fast)


def test_one_digit_in_one_family_is_found(rescorer: Rescorer) -> None:
    ids = [sample.sample_id for sample in rescorer.split.samples]
    due = rescorer.sheet_of(planning_file(ids, 1.0))
    document = due.model_dump(mode="json", by_alias=True)
    family, row = next((key, row) for key, row in document["families"].items() if row["ur"])
    row["ur"] += 1e-6
    wrong = type(due).model_validate_json(json.dumps(document))
    assert differences(wrong, due) == [f".families.{family}.ur"]


def test_a_canary_in_a_file_is_found_until_it_is_gone(tmp_path: Path) -> None:
    search, log = LeakSearch(tmp_path), tmp_path / "server.log"
    (tmp_path / "private").mkdir()
    (tmp_path / "private" / "measured").write_text(str(CANARY_M))
    log.write_text("all is well\n")
    assert list(search.leaks()) == []
    log.write_text(f"region [{CANARY_M}, 1.0]\n")
    try:
        for _ in range(2):
            assert [found.subject for found in search.leaks()] == ["server.log"]
    finally:
        log.unlink()
    assert list(search.leaks()) == []
