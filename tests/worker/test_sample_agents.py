"""The synthetic agents of the strategy challenge: valid files, and about the paper's numbers."""

import gzip
import json
from pathlib import Path

import pytest

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_worker.sample.agents import AGENTS, Agent, agent_predictions
from exceptiondrive_worker.sample.files import write_planners
from exceptiondrive_worker.sample.scenes import SEED, sample_scenes, sample_split
from exceptiondrive_worker.splits.store import LoadedSplit, load_split
from exceptiondrive_worker.upload_reader import read_upload


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planners")
    write_planners(folder)
    return folder


@pytest.fixture(scope="module")
def loaded(protocol: ProtocolDocument) -> LoadedSplit:
    return load_split(sample_split(), protocol)


@pytest.fixture(scope="module")
def sheets(folder: Path, loaded: LoadedSplit, protocol: ProtocolDocument) -> dict[str, ScoreSheet]:
    """The exact sheet of each agent's file, read as an upload."""
    scoring, found = scoring_of(STRATEGY.id), {}
    for agent in AGENTS:
        data = (folder / f"{agent.file_name}.json.gz").read_bytes()
        answers = read_upload(data, challenge=STRATEGY, manifest=loaded.manifest, protocol=protocol)
        assert isinstance(answers, dict), answers
        counted = {name: column[loaded.rows] for name, column in answers.items()}
        found[agent.method] = exact_sheet(
            scoring, counted, loaded.arrays, loaded.manifest.ref, protocol
        )
    return found


def test_the_pair_stands_near_the_papers_rows(sheets: dict[str, ScoreSheet]) -> None:
    plain, reminded = (
        sheets[m].macro_family for m in ("Looking Agent", "Looking Agent + Reminder")
    )
    assert plain["accuracy"] == pytest.approx(0.52, abs=0.03)
    assert plain["under_warning"] == pytest.approx(0.46, abs=0.03)
    assert reminded["accuracy"] == pytest.approx(0.71, abs=0.03)
    assert reminded["under_warning"] == pytest.approx(0.29, abs=0.03)


def test_reminder_records_travel_with_one_agent_and_are_scored(
    sheets: dict[str, ScoreSheet],
) -> None:
    assert [method for method, sheet in sheets.items() if "reminder" in sheet.extra] == [
        "Looking Agent + Reminder"
    ]
    reminder = sheets["Looking Agent + Reminder"].extra["reminder"]
    assert reminder["given"] == reminder["presence_precision"] == 1.0
    assert 0.9 < (reminder["presence_recall"] or 0) < 1
    task, family = reminder["type_task_accuracy"] or 0, reminder["type_family_accuracy"] or 0
    assert 0.6 < task < family < 0.95


@pytest.mark.parametrize("agent", AGENTS, ids=lambda agent: agent.file_name)
def test_an_agent_repeats_itself(agent: Agent, protocol: ProtocolDocument) -> None:
    samples = sample_scenes()
    first = agent_predictions(agent, samples, protocol, SEED)
    assert agent_predictions(agent, samples, protocol, SEED) == first


def test_the_listing_names_the_counterpart_by_its_method(folder: Path) -> None:
    listing = json.loads((folder / "planners.json").read_text())
    linked = {row["method"]: row["without_reminder"] for row in listing if row["without_reminder"]}
    assert linked == {"Looking Agent + Reminder": "Looking Agent"}
    assert {row["challenge"] for row in listing} == {"planning", "strategy"}


def test_an_agent_without_reminder_writes_none(folder: Path) -> None:
    text = gzip.decompress((folder / "looking-agent.json.gz").read_bytes())
    assert b"reminder" not in text
