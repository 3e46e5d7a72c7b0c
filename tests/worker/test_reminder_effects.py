"""The paired effect of a reminder on a board, against a computation that shares no code with it."""

import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import pytest
from sqlalchemy import select
from tests.support.worker import score_submission

from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.participation.disqualification import disqualify_submission
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_schemas.api.own_entries import link_words
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import MetricRow, PairedDifference, ReminderEffect
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring import compare as compare_module
from exceptiondrive_scoring.interval import draws_cut_off
from exceptiondrive_worker.boards import comparisons as comparisons_module
from exceptiondrive_worker.boards import reminder_effects as reminder_effects_module
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.private_store import Shelf

World = Any
N_SCENES, N_SAMPLES = 30, 120
ACCEPTABLE = {"SE1": "CD", "LB1": "C", "BG1": "BCE", "RS1": "CE"}
UNDER = {"SE1": "ABE", "LB1": "ABDE", "BG1": "A", "RS1": "AB"}
FAMILY = {"SE1": "sudden", "LB1": "lane", "BG1": "gap", "RS1": "road"}


@pytest.fixture(scope="module")
def scenes(make_split: Callable[..., Split]) -> Split:
    """Samples of four families, unevenly spread over scenes."""
    rng = Random(5)
    return make_split(
        {
            f"s{number:03d}": {
                "scene_id": f"scene-{int(rng.random() ** 2 * N_SCENES):02d}",
                "task": rng.choice(["SE1", "SE1", "SE1", "LB1", "BG1", "RS1"]),
            }
            for number in range(N_SAMPLES)
        }
    )


def answers(split: Split, seed: int, skill: float) -> dict[str, str]:
    rng = Random(seed)
    return {
        sample.sample_id: rng.choice(ACCEPTABLE[sample.task])
        if rng.random() < skill
        else rng.choice("ABCDE")
        for sample in split.samples
    }


def file_of(split: Split, strategies: dict[str, str]) -> bytes:
    return json.dumps(
        {
            "schema": "exceptiondrive.strategy/1",
            "split": split.name,
            "predictions": [{"sample_id": k, "strategy": v} for k, v in strategies.items()],
        }
    ).encode()


def naive_effect(
    split: Split, with_it: dict[str, str], without: dict[str, str], protocol: ProtocolDocument
) -> dict[str, tuple[float, tuple[float, float], float]]:
    """Sample by sample, draw by draw, in plain Python."""
    hits: dict[str, Callable[[str, str], bool]] = {
        "accuracy": lambda task, letter: letter in ACCEPTABLE[task],
        "under_warning": lambda task, letter: letter in UNDER[task],
    }
    names = sorted({sample.scene_id for sample in split.samples})
    rng = np.random.Generator(np.random.PCG64(protocol.ranking.bootstrap_seed))
    draws = [
        Counter(names[place] for place in rng.integers(0, len(names), size=len(names)))
        for _ in range(protocol.ranking.bootstrap_draws)
    ]
    found = {}
    for metric, hit in hits.items():
        rows = [
            (
                s.scene_id,
                FAMILY[s.task],
                hit(s.task, with_it[s.sample_id]) - hit(s.task, without[s.sample_id]),
            )
            for s in split.samples
        ]
        means = sorted(macro(rows, taken) for taken in draws)
        gaps: Counter[tuple[str, str]] = Counter()
        for scene, family, value in rows:
            gaps[scene, family] += value
        n_differing = len({scene for (scene, _), gap in gaps.items() if gap})
        cut = draws_cut_off(len(means), protocol.ranking.confidence, n_differing)
        interval = (means[cut], means[len(means) - 1 - cut])
        discordant = sum(row[2] != 0 for row in rows) / len(rows)
        found[metric] = (macro(rows, Counter(names)), interval, discordant)
    return found


def macro(rows: list[tuple[str, str, int]], taken: Counter[str]) -> float:
    """Mean of the family means, every sample as often as its scene was taken."""
    sums: defaultdict[str, int] = defaultdict(int)
    counts: defaultdict[str, int] = defaultdict(int)
    for scene, family, value in rows:
        sums[family] += taken[scene] * value
        counts[family] += taken[scene]
    means = [sums[family] / n for family, n in counts.items() if n]
    return math.fsum(means) / len(means)


def entry_of(board: Board, method: str) -> BoardEntry:
    (row,) = [row for row in board.entries if row.method == method]
    return row


def effect_of(board: Board, method: str) -> ReminderEffect:
    effect = entry_of(board, method).reminder_effect
    assert effect is not None
    return effect


@pytest.fixture
def pair(world: World, scenes: Split) -> tuple[World, str, str]:
    """Two linked submissions, scored: ids without and with reminder."""
    world.add_phase(scenes, challenge="strategy")
    plain = world.score(file_of(scenes, answers(scenes, 1, 0.3)), method="plain")
    reminded = world.score(
        file_of(scenes, answers(scenes, 2, 0.7)), method="reminded", linked_to=plain
    )
    return world, plain, reminded


def test_the_effect_is_what_a_naive_paired_bootstrap_finds(
    pair: tuple[World, str, str], scenes: Split, protocol: ProtocolDocument
) -> None:
    world, plain, _ = pair
    effect = effect_of(world.build_board(), "reminded")
    assert (effect.without, effect.without_method) == (plain, "plain")
    naive = naive_effect(scenes, answers(scenes, 2, 0.7), answers(scenes, 1, 0.3), protocol)
    for metric, (difference, interval, discordant) in naive.items():
        published = effect.differences[metric]
        assert published.difference == pytest.approx(difference, abs=0.00011)
        low, high = interval
        whole = (math.floor(low * 100 + 1e-7) / 100, math.ceil(high * 100 - 1e-7) / 100)
        assert published.interval == pytest.approx(whole), "of a withheld split"
        assert published.discordant is None
        assert 0 < discordant < 1
    assert effect.differences["accuracy"].verdict == "better with the reminder"
    assert effect.differences["under_warning"].verdict == "better with the reminder"


def test_the_sign_turns_with_the_direction_of_the_link(world: World, scenes: Split) -> None:
    world.add_phase(scenes, challenge="strategy")
    good = world.score(file_of(scenes, answers(scenes, 2, 0.7)), method="good")
    world.score(file_of(scenes, answers(scenes, 1, 0.3)), method="bad", linked_to=good)
    accuracy = effect_of(world.build_board(), "bad").differences["accuracy"]
    assert accuracy.difference is not None
    assert accuracy.difference < 0
    assert accuracy.verdict == "worse with the reminder"


def test_the_same_answers_have_no_effect(world: World, scenes: Split) -> None:
    world.add_phase(scenes, challenge="strategy")
    same = answers(scenes, 1, 0.3)
    plain = world.score(file_of(scenes, same), method="plain")
    again = file_of(scenes, dict(reversed(same.items())))
    world.score(again, method="again", linked_to=plain)
    accuracy = effect_of(world.build_board(), "again").differences["accuracy"]
    assert (accuracy.difference, accuracy.discordant) == (0.0, None)
    assert accuracy.verdict == "not separable on this split"


def test_an_entry_without_a_link_says_nothing_of_an_effect(pair: tuple[World, str, str]) -> None:
    world, _, _ = pair
    board = world.build_board()
    assert entry_of(board, "plain").reminder_effect is None
    document = json.loads(board.model_dump_json())
    (plain,) = [row for row in document["entries"] if row["method"] == "plain"]
    assert "reminder_effect" not in plain


def disqualify(session: Any, submission_id: str, *, actor: str) -> None:
    disqualify_submission(session, submission_id, reason="not by an agent", actor=actor)


def keep_to_its_team(session: Any, submission_id: str, *, actor: str) -> None:
    phase = session.get_one(Phase, "dev")
    phase.policy = phase.policy.model_copy(update={"entries_private": True})
    for each in session.scalars(select(Submission).where(Submission.id != submission_id)):
        each.published_at = each.received_at


def told_of(world: World, submission_id: str) -> SubmissionView:
    with world.database.read() as session:
        return view(session, session.get_one(Submission, submission_id))


@pytest.mark.parametrize("take_off", [withdraw, disqualify, keep_to_its_team])
def test_a_counterpart_that_may_not_be_shown_takes_the_effect_off_the_board(
    pair: tuple[World, str, str], take_off: Callable[..., Any]
) -> None:
    world, plain, reminded = pair
    effect = effect_of(world.build_board(), "reminded")
    told = told_of(world, reminded)
    assert (told.reminder_effect, told.no_effect_because) == (effect, None)
    assert re.fullmatch(
        rf"Without the reminder it is {plain}; by the reminder Accuracy \+[\d.]+ points "
        r"\(better with the reminder\), by the reminder Under-warning −[\d.]+ points "
        r"\(better with the reminder\)\.",
        link_words(told),
    )
    with world.database.write() as session:
        take_off(session, plain, actor="test")
    assert entry_of(world.build_board(), "reminded").reminder_effect is None
    told = told_of(world, reminded)
    assert told.no_effect_because == "that one is no entry of the board"
    assert link_words(told).endswith(f"{plain}; no effect is told: {told.no_effect_because}.")


def test_no_effect_is_told_against_a_run_that_another_replaced(
    pair: tuple[World, str, str], scenes: Split
) -> None:
    """Else a weak run that no reader finds on the board makes a reminder look good."""
    world, _, reminded = pair
    world.score(file_of(scenes, answers(scenes, 3, 0.8)), method="plain")
    board = world.build_board()
    assert [row.reminder_effect for row in board.entries] == [None] * len(board.entries)
    assert told_of(world, reminded).no_effect_because == "that one is no entry of the board"


def test_no_effect_is_told_against_a_file_with_reminder_records_of_its_own(
    world: World, scenes: Split
) -> None:
    """It may be linked before it is scored, when nobody has read it."""
    world.add_phase(scenes, challenge="strategy")
    document = json.loads(file_of(scenes, answers(scenes, 1, 0.3)))
    document["predictions"][0]["reminder"] = {"hazard_present": True}
    plain, job = world.submit(json.dumps(document).encode(), method="plain")
    reminded = world.score(
        file_of(scenes, answers(scenes, 2, 0.7)), method="reminded", linked_to=plain
    )
    assert link_words(told_of(world, reminded)) == (
        f"Without the reminder it is {plain}; the effect is told while both are entries of the board."
    )
    score_submission(world.context, job)
    assert entry_of(world.build_board(), "reminded").reminder_effect is None
    why = told_of(world, reminded).no_effect_because
    assert why == "that one has reminder records of its own"
    with pytest.raises(Conflict, match=f"{plain!r} has reminder records of its own; link one"):
        world.submit(file_of(scenes, answers(scenes, 3, 0.7)), linked_to=plain)


def test_a_second_board_takes_the_effect_from_the_store_and_a_lost_store_comes_to_the_same(
    pair: tuple[World, str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, _, _ = pair
    compared: list[int] = []
    compare = compare_module.compare

    def counted(*args: Any) -> Any:
        compared.append(1)
        return compare(*args)

    monkeypatch.setattr(comparisons_module, "compare", counted)
    first = effect_of(world.build_board(), "reminded")
    assert effect_of(world.build_board(), "reminded") == first
    assert len(compared) == 1
    for shelf in Shelf:
        for path in (world.settings.private_dir / shelf).iterdir():
            path.unlink()
    assert effect_of(world.build_board(), "reminded") == first
    assert len(compared) == 2


def test_a_kept_effect_names_the_counterpart_of_today(pair: tuple[World, str, str]) -> None:
    """The same bytes under another name, or sent again: the numbers are kept, the names are not."""
    world, plain, reminded = pair
    first = effect_of(world.build_board(), "reminded")
    with world.database.write() as session:
        session.get_one(Submission, plain).method = "renamed"
    renamed = effect_of(world.build_board(), "reminded")
    assert (renamed.without, renamed.without_method) == (plain, "renamed")
    scenes_file = world.files.read(world.submission(plain).file_digest, limit_bytes=10**6)
    with world.database.write() as session:
        withdraw(session, plain, actor="test")
    again = world.score(scenes_file, method="renamed")
    with world.database.write() as session:
        session.get_one(Submission, reminded).linked_to = again
    sent_again = effect_of(world.build_board(), "reminded")
    assert (sent_again.without, sent_again.without_method) == (again, "renamed")
    assert sent_again.differences == renamed.differences == first.differences


def test_only_rounded_numbers_are_published(pair: tuple[World, str, str]) -> None:
    world, _, _ = pair
    for found in effect_of(world.build_board(), "reminded").differences.values():
        numbers = [found.difference, found.discordant, *(found.interval or ())]
        assert all(n is None or round(n, 4) == n for n in numbers)


def test_a_verdict_never_says_more_than_the_published_interval() -> None:
    barely = PairedDifference(
        difference=0.01,
        interval=(0.00003, 0.02),
        discordant=0.1,
        verdict="better with the reminder",
    )
    differences = dict.fromkeys(STRATEGY.metric_keys, barely)
    effect = ReminderEffect(without="a", without_method="A", differences=differences)
    rounding = Rounding(STRATEGY, packaged_protocol().publication, is_public=True)
    row: MetricRow = dict.fromkeys(STRATEGY.metric_keys, 0.5)
    published = reminder_effects_module.published_effect(effect, STRATEGY, rounding, [row, row])
    assert published.differences["accuracy"].interval == (0.0, 0.02)
    assert published.differences["accuracy"].verdict == compare_module.NOT_SEPARABLE


@pytest.mark.parametrize("is_public", [True, False])
def test_the_difference_is_that_of_the_two_published_values(is_public: bool) -> None:
    """Exact means 0.27639 and 0.20964 differ by 0.06675: the board shows 0.2764 and 0.2096."""
    exact = PairedDifference(
        difference=-0.06675, interval=(-0.09, -0.03), discordant=0.3, verdict="better"
    )
    effect = ReminderEffect(
        without="a", without_method="A", differences=dict.fromkeys(STRATEGY.metric_keys, exact)
    )
    rounding = Rounding(STRATEGY, packaged_protocol().publication, is_public=is_public)
    rows: list[MetricRow] = [dict.fromkeys(STRATEGY.metric_keys, x) for x in (0.2096, 0.2764)]
    published = reminder_effects_module.published_effect(effect, STRATEGY, rounding, rows)
    assert {each.difference for each in published.differences.values()} == {-0.0668}
