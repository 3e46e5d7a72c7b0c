"""A challenge that is registered by one fixture goes from upload to board to page, to the last metric.

Its protocol is the packaged one, which was written before it. One of its metrics is a minimum.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.client.servers import run

from exceptiondrive import ServerError
from exceptiondrive.challenges import challenge_of
from exceptiondrive_schemas.challenges import (
    CHALLENGES,
    STRATEGY,
    Challenge,
    ChallengeId,
    Metric,
    UnknownChallengeError,
)
from exceptiondrive_schemas.check import CheckedDocument
from exceptiondrive_schemas.check.fault_list import FaultList
from exceptiondrive_schemas.check.fault_list import Path as Place
from exceptiondrive_schemas.check.rules import RULES, SCORED_BY, register
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import Plausibility
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.challenge import ChallengeScoring, scoring_of
from exceptiondrive_scoring.grade import SampleScores, sample_scores
from exceptiondrive_worker import upload_reader

if TYPE_CHECKING:
    from tests.client.servers import Running


def metric(key: str, label: str, **more: Any) -> Metric:
    return Metric(key=key, label=label, title=f"{label} of the gap", meaning="Toy.", **more)


GAPS = Challenge(
    id=ChallengeId("gaps"),
    title="Gaps",
    file_schema="exceptiondrive.gaps/1",
    words=STRATEGY.words,
    metrics=(
        metric(
            "wide", "Wide", unit="fraction", better="higher", role="primary", aggregation="share"
        ),
        metric(
            "closed", "Closed", unit="fraction", better="lower", role="primary", aggregation="share"
        ),
        metric(
            "least_gap",
            "Least gap",
            unit="metre",
            better="higher",
            role="diagnostic",
            aggregation="minimum",
        ),
        metric(
            "median_gap",
            "Median gap",
            unit="metre",
            better=None,
            role="diagnostic",
            aggregation="quantile",
            level=0.5,
        ),
    ),
)


class GapsDocument(CheckedDocument):
    """A sound file: sample id to a gap in metres."""

    challenge: ClassVar[ChallengeId] = GAPS.id


class GapRules:
    """A gap is a number, not below zero."""

    required_keys: ClassVar[frozenset[str]] = frozenset({"sample_id", "gap_m"})
    optional_keys: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, protocol: ProtocolDocument, faults: FaultList) -> None:
        self._faults = faults

    def answer(self, prediction: dict[str, Any], path: Place, sample_id: str | None) -> Any:
        gap = prediction.get("gap_m")
        if not isinstance(gap, float) or gap < 0:
            self._faults.add(
                FaultCode.WRONG_TYPE, (*path, "gap_m"), expected="metres", got=str(gap)
            )
        return gap

    def finish(self, answers: Mapping[str, Any], manifest: Manifest | None) -> None:
        pass

    def notes(self, n_predictions: int, profile: FileProfile | None) -> tuple[str, ...]:
        return ()

    def unranked_because(self, n_predictions: int, profile: FileProfile | None) -> None:
        pass

    def document(self, split: str, answers: Mapping[str, Any]) -> GapsDocument:
        return GapsDocument(split, answers)


class GapScoring(ChallengeScoring):
    """A gap is wide from the required clearance on, closed at zero."""

    challenge = GAPS

    def columns(self, document: CheckedDocument, sample_ids: Any) -> dict[str, NDArray[Any]]:
        return {"gap_m": np.array([document.answers[each] for each in sample_ids])}

    def measure(
        self, answers: Columns, split: SplitArrays, geometry: GeometrySection
    ) -> dict[str, NDArray[Any]]:
        return dict(answers)

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> SampleScores:
        gap_m = measurements["gap_m"]
        by_key = {"wide": gap_m >= split.d_safe_m, "closed": gap_m == 0}
        return sample_scores(GAPS.metrics, by_key | {"least_gap": gap_m, "median_gap": gap_m})

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        return {"edited": 1.0}

    def plausibility(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> Plausibility:
        return Plausibility(shares={})


def read_fast(
    text: bytes, manifest: Any, protocol: ProtocolDocument
) -> dict[str, NDArray[Any]] | None:
    """A fast reader that is sure of whatever the standard decoder reads in order."""
    predictions = json.loads(text)["predictions"]
    if [each["sample_id"] for each in predictions] != list(manifest.sample_ids):
        return None
    return {"gap_m": np.array([each["gap_m"] for each in predictions])}


@pytest.fixture(params=["precise", "fast"])
def gaps(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Challenge]:
    """Register the challenge, for the time of a test; some challenges have a fast reader too."""
    register(GAPS, GapRules, f"{__name__}:GapScoring")
    if request.param == "fast":
        monkeypatch.setitem(upload_reader.FAST_READERS, GAPS.id, read_fast)
    yield GAPS
    for registry in (CHALLENGES, RULES, SCORED_BY):
        del registry[GAPS.id]


@pytest.fixture
def phase(gaps: Challenge, working: "Running") -> "Running":
    """The running system with a phase of the challenge, made over the API."""
    made = httpx.post(
        f"{working.url}/api/v1/organizer/phases",
        headers={"authorization": f"Bearer {working.organizer_token}"},
        json={
            "id": "gaps-dev",
            "challenge": "gaps",
            "title": "Gaps",
            "split": "tiny",
            "protocol": "1.0",
            "quota_per_day": 5,
        },
    )
    assert made.status_code == 201, made.text
    return working


def gap_file(folder: Path, *gaps_m: float) -> Path:
    predictions = [{"sample_id": f"s{n}", "gap_m": gap_m} for n, gap_m in enumerate(gaps_m)]
    path = folder / f"gaps-{gaps_m[0]}.json"
    document = {"schema": GAPS.file_schema, "split": "tiny", "predictions": predictions}
    path.write_text(json.dumps(document))
    return path


def ok(server: "Running", *words: object) -> Any:
    done = run(server, *words)
    assert done.exit_code == 0, (words, done.stderr, done.exception)
    return done


def submit(server: "Running", path: Path, method: str) -> Any:
    words = ("submit", path, "--phase", "gaps-dev", "--method", method, "--wait", "--json")
    return json.loads(ok(server, *words).stdout)


def test_from_upload_to_board_to_page_to_export(phase: "Running", tmp_path: Path) -> None:
    near = submit(phase, gap_file(tmp_path, 0.0, 0.25, 9.0, 9.0), "Near")
    far = submit(phase, gap_file(tmp_path, 8.0, 9.0, 9.0, 7.5), "Far")
    assert (near["rank"], far["rank"]) == (1, 1)  # each was first when it came
    assert far["sheet"]["micro"] == {"wide": 1, "closed": 0, "least_gap": 7.5, "median_gap": 8}

    with phase.client() as client:
        board = client.leaderboard(phase="gaps-dev")
        assert [(entry.method, entry.rank) for entry in board.entries] == [("Far", 1), ("Near", 2)]
        second = board.entries[1]
        assert second.micro == {"wide": 0.5, "closed": 0.25, "least_gap": 0, "median_gap": 0.25}
        assert second.intervals["least_gap"] is None, "each family has one scene"
        assert board.challenge == "gaps"
        paired = board.comparisons[0].overall["least_gap"]
        assert paired.difference is not None
        assert [each.id for each in client.phases() if each.challenge == "gaps"] == ["gaps-dev"]
        by_gap = client.leaderboard(phase="gaps-dev", sort="least_gap")
        assert [entry.method for entry in by_gap.entries] == ["Near", "Far"]
    csv = csv_of(phase)
    assert "least_gap" in csv.splitlines()[0]
    assert len(csv.splitlines()) == 3
    assert "Least gap" in ok(phase, "leaderboard", "--phase", "gaps-dev").stdout
    ok(phase, "status", far["id"])

    pages = pages_of(phase, far["id"], near["id"])
    for words in (("Far", "Near", "Least gap"), ("Far", "Least gap"), ("Far", "Near"), ("Gaps",)):
        page = next(pages)
        assert all(word in page for word in words), words
    assert "Least gap" in next(pages)


def csv_of(server: "Running") -> str:
    return httpx.get(f"{server.url}/api/v1/leaderboard.csv?phase=gaps-dev").text


def pages_of(server: "Running", first: str, second: str, third: str = "") -> Iterator[str]:
    """The pages of the board, an entry, two or three entries, the file and the protocol."""
    for address in (
        "/?phase=gaps-dev",
        f"/entries/{first}",
        f"/compare?phase=gaps-dev&a={first}&b={second}&more={third}",
        "/submit?phase=gaps-dev",
        "/protocols/1.0",
    ):
        page = httpx.get(f"{server.url}{address}", headers={"accept": "text/html"})
        assert page.status_code == 200, (address, page.text[:500])
        yield page.text


def test_what_was_stored_before_a_metric_is_shown_after_it(
    phase: "Running", tmp_path: Path
) -> None:
    ids = [
        submit(phase, gap_file(tmp_path, gap_m, 9.0, 9.0, 9.0), f"Gap {gap_m}")["id"]
        for gap_m in (1.0, 2.0, 3.0)
    ]
    longer = metric("longest", "Longest", unit="metre", better="lower", role="diagnostic")
    more = GAPS.model_copy(update={"metrics": (*GAPS.metrics, longer)})
    CHALLENGES[GAPS.id] = more  # the fixture takes it back
    assert "Gap 2.0" in next(pages_of(phase, *ids))
    assert len(list(pages_of(phase, *ids))) == 5
    for words in (("leaderboard", "--phase", "gaps-dev"), ("status", ids[0])):
        ok(phase, *words)
    assert len(csv_of(phase).splitlines()) == 4


def test_a_fault_of_its_own_is_told(phase: "Running", tmp_path: Path) -> None:
    path = gap_file(tmp_path, -1.0, 1.0, 1.0, 1.0)
    words = ("submit", path, "--phase", "gaps-dev", "--method", "Wrong")
    done = run(phase, *words)
    assert done.exit_code == 2
    assert "gap_m" in done.stderr + done.stdout


@pytest.mark.usefixtures("gaps")
def test_a_second_of_the_same_name_is_refused() -> None:
    with pytest.raises(ValueError, match="registered already"):
        register(GAPS, GapRules, f"{__name__}:GapScoring")


def test_an_unknown_challenge_is_named_and_the_known_ones_too() -> None:
    for look_up in (CHALLENGES.__getitem__, RULES.__getitem__, scoring_of):
        with pytest.raises(UnknownChallengeError, match=r"'gaps' here; known: planning, strategy"):
            look_up(ChallengeId("gaps"))
    assert packaged_protocol().digest.startswith("sha256:a8e2d761")


def test_a_client_older_than_a_challenge_asks_for_a_newer_one() -> None:
    with pytest.raises(ServerError, match="no challenge 'gaps' here") as caught:
        challenge_of("gaps")
    assert "Install the newest client" in caught.value.advice
