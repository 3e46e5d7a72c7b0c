"""The organizers' report of submissions that are alike, from real uploads to records."""

import json
import random
import re
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import select
from tests.support.worker import score_submission

from exceptiondrive_records.operations.overview import overview
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import SimilarityRow
from exceptiondrive_schemas.api.similarity import AlikeKind, SimilarityReport
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring import similarity
from exceptiondrive_worker import similarity_run
from exceptiondrive_worker.splits.private_store import Shelf

World = Any
N_SAMPLES = 120


@pytest.fixture
def crowd(world: World, make_split: Callable[..., Split]) -> World:
    split = make_split(
        {f"s{number:03d}": {"scene_id": f"scene-{number}"} for number in range(N_SAMPLES)},
        name="crowd",
    )
    world.add_phase(split)
    return world


def upload(
    seed: int,
    *,
    noise_m: float = 0.0,
    changed: dict[int, float] | None = None,
    scale: float = 1.0,
) -> bytes:
    """A planner's file: way by seed, some noise, some samples moved along x, all of it scaled."""
    steps, noise = random.Random(seed), random.Random(seed + 1000)
    answers = []
    for number in range(N_SAMPLES):
        pace = steps.uniform(0.5, 4.0) + (changed or {}).get(number, 0.0)
        way = [[scale * pace * t + noise.gauss(0, noise_m), 0.0] for t in range(1, 7)]
        answers.append({"sample_id": f"s{number:03d}", "source": way, "edited": way})
    head = {"schema": "exceptiondrive.planning/1", "split": "crowd"}
    return json.dumps({**head, "predictions": answers}).encode()


def report(world: World) -> SimilarityReport:
    world.build_board()
    with world.database.read() as session:
        return similarity_report(session, "dev")


def test_comparisons_end_in_time_and_go_on_after_the_next_board(
    crowd: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(2), team="beta")
    with monkeypatch.context() as patched:
        patched.setattr(similarity_run, "PART_OF_LIMIT", 0.0)
        found = report(crowd)
        assert (found.n_compared, found.n_waiting) == (1, 1)
    found = report(crowd)
    assert (found.n_compared, found.n_waiting) == (2, 0)


def test_equal_files_equal_answers_and_near_ones_are_told_apart(crowd: World) -> None:
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(1), team="beta")
    crowd.score(upload(1) + b"\n", team="gamma")
    crowd.score(upload(1, noise_m=0.1), team="delta")
    crowd.score(upload(2), team="epsilon")
    found = report(crowd)
    kinds = {(pair.first.team, pair.second.team): pair.kind for pair in found.pairs}
    assert kinds == {
        ("Alpha", "Beta"): AlikeKind.EQUAL_FILES,
        ("Alpha", "Gamma"): AlikeKind.EQUAL_ANSWERS,
        ("Beta", "Gamma"): AlikeKind.EQUAL_ANSWERS,
        ("Alpha", "Delta"): AlikeKind.NEAR,
        ("Beta", "Delta"): AlikeKind.NEAR,
        ("Gamma", "Delta"): AlikeKind.NEAR,
    }
    assert (found.n_compared, found.n_waiting) == (5, 0)
    crowd.score(upload(1), team="zeta")
    again = report(crowd)
    same = {(p.first.team, p.second.team) for p in again.pairs if p.kind is AlikeKind.EQUAL_FILES}
    assert same == {("Alpha", "Beta"), ("Alpha", "Zeta"), ("Beta", "Zeta")}
    assert found.probing == ()
    order = [pair.n_different for pair in found.pairs]
    assert order == sorted(order)


def test_a_file_that_a_team_withdrew_and_sent_again_is_no_pair(crowd: World) -> None:
    first = crowd.score(upload(1), team="alpha")
    with crowd.database.write() as session:
        withdraw(session, first, actor="test")
    crowd.score(upload(1), team="alpha")
    assert report(crowd).pairs == ()


def test_what_is_found_does_not_depend_on_when_it_is_compared(crowd: World) -> None:
    for team in ("alpha", "beta"):
        crowd.score(upload(1) + b" " * len(team), team=team)
        first = report(crowd)
    assert len(first.pairs) == 1
    crowd.reopen_context()
    again = report(crowd)
    assert again == first


def test_comparing_waits_for_nobodys_score(crowd: World) -> None:
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(1) + b" ", team="beta")
    _, waiting = crowd.submit(upload(2), team="gamma")
    kept_back = report(crowd)
    assert (kept_back.n_compared, kept_back.n_waiting) == (0, 2)
    score_submission(crowd.context, waiting)
    assert report(crowd).n_compared == 3


def test_comparing_ends_for_a_score_that_comes_meanwhile(
    crowd: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        crowd.score(upload(number), team=f"team-{number}")
    monkeypatch.setattr(similarity_run, "POLL_EVERY_S", 0.0)
    sent: list[str] = []

    def send_one(*answers: Any) -> Any:
        if not sent:
            sent.append(crowd.submit(upload(9), team="late")[1])
        return similarity.fingerprinted_samples(*answers)

    monkeypatch.setattr(similarity_run, "fingerprinted_samples", send_one)
    assert (report(crowd).n_compared, report(crowd).n_compared) == (1, 1)
    score_submission(crowd.context, sent[0])
    assert report(crowd).n_compared == 4


def test_equal_files_are_told_before_any_worker_compares(crowd: World) -> None:
    crowd.submit(upload(1), team="alpha")
    crowd.submit(upload(1), team="beta")
    with crowd.database.read() as session:
        found = similarity_report(session, "dev")
    assert [pair.kind for pair in found.pairs] == [AlikeKind.EQUAL_FILES]
    assert found.n_compared == 0


@pytest.mark.row("I21")
def test_a_team_that_changes_one_sample_30_times_is_found_and_audited(crowd: World) -> None:
    for number in range(30):
        crowd.score(upload(1, changed={7: 0.1 * number}), team="alpha", method=f"m{number}")
    crowd.score(upload(2), team="beta")
    found = report(crowd)
    (probing,) = found.probing
    assert (probing.teams, probing.n_submissions) == (("Alpha",), 29)
    assert (probing.fewest_changed, probing.most_changed) == (1, 1)
    assert found.pairs == ()
    with crowd.database.read() as session:
        alarms = overview(session).probing
    assert [alarm.detail["submissions_at_least"] for alarm in alarms] == [20, 10, 5]
    assert {(alarm.subject, *alarm.detail["teams"]) for alarm in alarms} == {("dev", "Alpha")}
    assert "share most of their samples" in alarms[0].detail["seen"]


def test_probes_that_are_withdrawn_as_soon_as_they_are_scored_are_seen(crowd: World) -> None:
    for number in range(8):
        asked = upload(1, changed={7: 0.1 * number})
        probe = crowd.score(asked, team="alpha", method=f"m{number}")
        with crowd.database.write() as session:
            withdraw(session, probe, actor="team:alpha")
        found = report(crowd)
    assert (found.n_compared, found.n_waiting) == (8, 0)
    (probing,) = found.probing
    assert (probing.teams, probing.n_submissions) == (("Alpha",), 7)
    with crowd.database.read() as session:
        assert overview(session).probing


def probes(number: int, base: int = 1, scale: float = 1.0) -> bytes:
    """One sample of each of six cells is asked about, all others stay as they are."""
    asked = {20 * cell + number % 20: 0.3 + 0.1 * number for cell in range(6)}
    return upload(base, changed=asked, scale=scale)


def test_probes_of_many_cells_at_once_are_seen(crowd: World) -> None:
    """One in twenty samples moves with each of 22 uploads, and tells of a region in each cell."""
    crowd.score(upload(1), team="alpha")
    for number in range(22):
        crowd.score(probes(number), team="alpha", method=f"m{number}")
    (probing,) = report(crowd).probing
    assert (probing.teams, probing.n_submissions) == (("Alpha",), 22)
    assert (probing.fewest_changed, probing.most_changed) == (6, 6)


def test_probes_that_a_team_spreads_over_bases_are_seen_together(crowd: World) -> None:
    """Three of each base; a team that mends each of four planners once is not listed."""
    for base in range(5):
        for number in range(4):
            data = upload(base, changed={7: 0.1 * number})
            crowd.score(data, team="alpha", method=f"b{base} m{number}")
    for planner in range(10, 14):
        crowd.score(upload(planner), team="beta", method=f"p{planner}")
        crowd.score(upload(planner, changed={9: 0.5}), team="beta", method=f"p{planner}, mended")
    (probing,) = report(crowd).probing
    assert (probing.teams, probing.n_submissions) == (("Alpha",), 15)
    with crowd.database.read() as session:
        assert overview(session).probing[0].detail["teams"] == ["Alpha"]


def test_two_teams_that_change_the_same_planners_a_few_times_are_not_listed(crowd: World) -> None:
    """As two that begin with the same starters: neither team, and no planner, has five."""
    for planner in range(3):
        crowd.score(upload(planner), team="alpha", method=f"p{planner}")
    for team, planners in (("alpha", range(3)), ("beta", range(2))):
        for planner in planners:
            data = upload(planner, changed={9 if team == "alpha" else 7: 0.5})
            crowd.score(data, team=team, method=f"p{planner}, mended")
    assert report(crowd).probing == ()


def test_probes_of_several_teams_are_seen_together(crowd: World) -> None:
    for number in range(9):
        crowd.score(
            probes(number), team=("alpha", "beta", "gamma")[number % 3], method=f"m{number}"
        )
    (probing,) = report(crowd).probing
    assert (probing.teams, probing.n_submissions) == (("Alpha", "Beta", "Gamma"), 8)


def test_probes_whose_base_is_scaled_each_time_are_seen(crowd: World) -> None:
    for number in range(8):
        data = probes(number, scale=1 - 0.02 * number)
        crowd.score(data, team="alpha", method=f"m{number}")
    (probing,) = report(crowd).probing
    assert (probing.teams, probing.n_submissions) == (("Alpha",), 7)


def test_a_copy_made_a_little_slower_is_seen_across_teams(crowd: World) -> None:
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(1, scale=0.9), team="beta")
    crowd.score(upload(2), team="gamma")
    (pair,) = report(crowd).pairs
    assert (pair.kind, pair.first.team, pair.second.team) == (AlikeKind.SCALED, "Alpha", "Beta")
    assert pair.scale == pytest.approx(1 / 0.9, abs=0.001)


def test_an_honest_season_raises_no_alarm(crowd: World) -> None:
    """Trained anew, tuned in speed, another rule for a part of the scenes: ten revisions of each."""
    chance = random.Random(7)
    for planner in range(4):
        for revision in range(10):
            scale, rule = 1.0, {}
            if revision % 3 == 1:
                scale = 1 + chance.uniform(-0.1, 0.1)
            if revision % 3 == 2:
                part = chance.sample(range(N_SAMPLES), chance.randrange(15, 50))
                rule = dict.fromkeys(part, -0.4)
            data = upload(planner, noise_m=0.02 * revision, changed=rule, scale=scale)
            crowd.score(data, team=f"team-{planner}", method=f"m{revision}")
    found = report(crowd)
    assert found.n_compared == 40
    assert (found.pairs, found.probing) == ((), ())


def test_a_copy_with_one_sample_changed_is_found_across_teams(crowd: World) -> None:
    """However far that sample is moved: a fingerprint may not even hold it."""
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(1, changed={11: 20.0}), team="beta")
    (pair,) = report(crowd).pairs
    assert (pair.kind, pair.n_different) == (AlikeKind.NEAR, 1)


def test_one_team_sending_variants_of_its_planner_does_not_probe(crowd: World) -> None:
    for number in range(6):
        crowd.score(upload(1, noise_m=0.15 * number), team="alpha", method=f"m{number}")
    assert report(crowd).probing == ()


def test_records_hold_sums_alone(crowd: World) -> None:
    crowd.score(upload(1), team="alpha")
    crowd.score(upload(1, noise_m=0.1), team="beta")
    report(crowd)
    with crowd.database.read() as session:
        rows = list(session.scalars(select(SimilarityRow.alike)))
    assert any("equal_share" in row for row in rows)
    assert not re.search(r"\bs\d{3}\b|scene|region|way", "".join(rows))


def test_candidates_alone_are_read_whole(crowd: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand submissions are compared by fingerprint: strangers' trajectories are not loaded."""
    for number in range(8):
        crowd.score(upload(number), team=f"team-{number}")
    report(crowd)
    compared: list[object] = []

    def counted(*pair: Any) -> Any:
        compared.append(pair)
        return similarity.compare_pair(*pair)

    monkeypatch.setattr(similarity_run, "compare_pair", counted)
    crowd.score(upload(3) + b"\n", team="copy")
    assert len(report(crowd).pairs) == 1
    assert len(compared) == 1
    assert len(list((crowd.settings.private_dir / Shelf.FINGERPRINTS).iterdir())) == 9


def test_no_more_are_compared_at_once_than_a_board_has_time_for(
    crowd: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(similarity_run, "COMPARED_AT_ONCE", 2)
    for number in range(3):
        crowd.score(upload(number), team=f"team-{number}")
    assert (report(crowd).n_compared, report(crowd).n_compared) == (2, 3)
