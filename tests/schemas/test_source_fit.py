"""What a file looks like, and that each simple mistake of it is named and no right file suspected."""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import gzip
import json
import math
import random
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import pytest
from tests.support import realdata
from tests.support.extract import make_extract

from exceptiondrive_schemas.check import check, source_fit
from exceptiondrive_schemas.check.answers import PlanningDocument, TrajectoryPair
from exceptiondrive_schemas.check.source_fit import _means_at, file_profile
from exceptiondrive_schemas.check.transformations import (
    UNITS_M,
    Points,
    at_times,
    mirrored,
    rotated,
    scaled,
    summed,
    swapped,
)
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.protocol import ProtocolDocument

Drives = Mapping[str, Points]
Mistake = Callable[[Points], Points]


def increments(points: Points) -> Points:
    before = [(0.0, 0.0), *points[:-1]]
    return [(x - x0, y - y0) for (x0, y0), (x, y) in zip(before, points, strict=True)]


def sampled(time_step_s: float) -> Mistake:
    """Six waypoints of the same drive, another time apart; it goes on straight beyond its end."""

    def sample(points: Points) -> Points:
        (x0, y0), (x1, y1) = points[-2:]
        n_more = max(round((6 * time_step_s - 3.0) / 0.5), 0)
        beyond = [(x1 + k * (x1 - x0), y1 + k * (y1 - y0)) for k in range(1, n_more + 1)]
        times_s = [time_step_s * step for step in range(1, 7)]
        return at_times([*points, *beyond], 0.5, times_s)

    return sample


def test_a_trajectory_is_summed_and_read_between_waypoints_along_both_axes() -> None:
    assert summed([(1.0, 2.0), (3.0, -1.0)]) == [(1.0, 2.0), (4.0, 1.0)]
    found = at_times([(2.0, 1.0), (4.0, 4.0)], 0.5, [0.0, 0.25, 0.75, 1.0])
    assert found == [(0.0, 0.0), (1.0, 0.5), (3.0, 2.5), (4.0, 4.0)]


def test_distances_are_told_at_whole_seconds_that_have_a_waypoint(
    protocol: ProtocolDocument,
) -> None:
    geometry = protocol.geometry.model_copy(update={"time_step_s": 0.4})
    distances_m = [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]
    assert list(_means_at(distances_m, protocol.geometry)) == [2.0, 4.0, 6.0]
    assert list(_means_at(distances_m, geometry)) == [None, 5.0, None]


MISTAKES: dict[str, Mistake] = {
    "--mirror": mirrored,
    "--swap": swapped,
    "--rotate -90": lambda points: rotated(points, 1),
    "--rotate 90": lambda points: rotated(points, -1),
    "--rotate 180": lambda points: rotated(points, 2),
    **{f"--unit {unit}": partial(scaled, factor=1 / metres) for unit, metres in UNITS_M.items()},
    "--cumulative": increments,
    "--reverse": lambda points: points[::-1],
    **{f"--time-step-s {step:g} --truncate": sampled(step) for step in (1.0, 2.5)},
}
"""By the option of `convert` that mends it, what a planner's author did wrong."""
TOO_SHORT = {step: sampled(step) for step in (0.05, 0.1, 0.2, 0.25)}
"""Waypoints so far apart that the last one comes before the horizon: nothing mends that."""


def pairs_of(sources: Drives, edited: Drives | None = None) -> dict[str, TrajectoryPair]:
    def flat(points: Points | None) -> array[float] | None:
        return None if points is None else array("d", [each for point in points for each in point])

    return {
        sample_id: TrajectoryPair(flat(points), flat((edited or sources).get(sample_id)))
        for sample_id, points in sources.items()
    }


def profile_of(
    pairs: Mapping[str, TrajectoryPair], protocol: ProtocolDocument, recorded: Drives | None
) -> FileProfile:
    found = file_profile(pairs, protocol.geometry, protocol.plausibility, recorded)
    assert found is not None
    return found


def changed(drives: Drives, change: Mistake) -> dict[str, Points]:
    return {sample_id: change(points) for sample_id, points in drives.items()}


def braked(points: Points) -> Points:
    shares = (1.0, 0.8, 0.65, 0.55, 0.48, 0.42)
    return [(x * share, y * share) for (x, y), share in zip(points, shares, strict=True)]


@pytest.fixture(scope="module")
def recorded() -> dict[str, Points]:
    return dict(make_extract().recorded)


@pytest.fixture(scope="module")
def planned(recorded: Drives) -> dict[str, Points]:
    """What an ordinary planner says of these scenes: a tenth too fast or slow, a little aside."""
    chance = random.Random(7)

    def plan(points: Points) -> Points:
        pace, aside = chance.gauss(1.0, 0.1), chance.gauss(0.0, 0.02)
        return [(x * pace, y + aside * x) for x, y in points]

    return changed(recorded, plan)


def test_an_honest_file_is_not_suspected(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    profile = profile_of(pairs_of(planned, changed(planned, braked)), protocol, recorded)
    assert profile.mend is None
    assert profile.warnings == ()
    assert [label for label, _ in profile.lines] == [
        "source speed",
        "source L2",
        "standing still",
        "equal pairs",
        "longer source",
    ]


@pytest.mark.parametrize("option", MISTAKES)
def test_each_mistake_is_named_with_what_mends_it(
    option: str, planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    wrong = changed(planned, MISTAKES[option])
    profile = profile_of(pairs_of(wrong), protocol, recorded)
    assert profile.mend is not None
    assert profile.mend.convert_option == option
    assert profile.mend.error is not None
    assert profile.mend.mended_error is not None
    assert profile.mend.error > profile.mend.mended_error
    (sentence,) = profile.warnings
    assert f"{profile.mend.error:.0%} as they are" in sentence
    assert profile.mend.is_sideways == (option == "--mirror")
    of = "way to the side at the end of turns" if option == "--mirror" else "driven distance"
    assert f"are {profile.mend.mended_error:.0%} of the {of} off the recorded" in sentence
    assert sentence.endswith(f"mend it by `exceptiondrive convert FILE {option}`.")


@pytest.mark.parametrize("step_s", TOO_SHORT)
def test_waypoints_that_end_too_early_are_named_and_no_cure_is_promised(
    step_s: float, planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    profile = profile_of(pairs_of(changed(planned, TOO_SHORT[step_s])), protocol, recorded)
    assert profile.mend is not None
    assert profile.mend.convert_option is None
    (sentence,) = profile.warnings
    assert f"waypoints {step_s:g} s apart (the last at {6 * step_s:g} s, where 3 s" in sentence
    assert "`" not in sentence


def standing(points: Points) -> Points:
    return [(0.0, 0.0)] * len(points)


def at_pace(pace_mps: float) -> Mistake:
    return lambda points: [(pace_mps * 0.5 * step, 0.0) for step in range(1, len(points) + 1)]


def steady(points: Points) -> Points:
    """At the speed of the first step, straight ahead."""
    return [(points[0][0] * step, 0.0) for step in range(1, len(points) + 1)]


def beside(points: Points) -> Points:
    """In the next lane."""
    return [(x, y + 3.5 * step / 6) for step, (x, y) in enumerate(points, start=1)]


def stopping(points: Points) -> Points:
    shares = (0.9, 0.7, 0.5, 0.4, 0.35, 0.3)
    return [(x * share, y * share) for (x, y), share in zip(points, shares, strict=True)]


def backing(points: Points) -> Points:
    return [(-0.3 * step, 0.0) for step in range(1, len(points) + 1)]


INNOCENT: dict[str, Mistake] = {
    "stands": standing,
    "creeps": at_pace(0.4),
    "always at 30 km/h": at_pace(8.33),
    "always at 130 km/h": at_pace(36.1),
    "goes straight on": steady,
    "drives beside the recorded path": beside,
    "stops before everything": stopping,
    "at 0.7 of the pace": partial(scaled, factor=0.7),
    "at 0.3 of the pace": partial(scaled, factor=0.3),
    "at 1.4 of the pace": partial(scaled, factor=1.4),
    "backs away": backing,
    "is the recorded drive": list,
}
"""What planners do, well or badly, without a mistake in their files."""


@pytest.mark.parametrize("planner", INNOCENT)
def test_no_planner_is_told_to_convert_what_it_means(
    planner: str, planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    sources = changed(recorded, INNOCENT[planner])
    edited = changed(recorded, braked)
    for answers in (edited, sources, changed(recorded, standing)):
        assert profile_of(pairs_of(sources, answers), protocol, recorded).mend is None


def test_guesses_at_random_get_no_advice(recorded: Drives, protocol: ProtocolDocument) -> None:
    for seed in range(5):
        chance = random.Random(seed)
        wild = {
            sample_id: [(chance.gauss(0, 20), chance.gauss(0, 20)) for _ in points]
            for sample_id, points in recorded.items()
        }
        assert profile_of(pairs_of(wild), protocol, recorded).mend is None


def shuffled(drives: Drives) -> dict[str, Points]:
    some = random.Random(3).sample(list(drives.values()), len(drives))
    return dict(zip(drives, some, strict=True))


def moved_by(n_rows: int, *, only: int = 1) -> Callable[[Drives], dict[str, Points]]:
    """Give each so-manieth row the trajectory that stands some rows on."""

    def move(drives: Drives) -> dict[str, Points]:
        rows = list(drives.values())
        return {
            key: rows[(at + n_rows) % len(rows)] if at % only == 0 else points
            for at, (key, points) in enumerate(drives.items())
        }

    return move


def most(change: Mistake) -> Callable[[Drives], dict[str, Points]]:
    """Change three rows of five."""

    def part(drives: Drives) -> dict[str, Points]:
        items = enumerate(drives.items())
        return {key: change(points) if at % 5 < 3 else points for at, (key, points) in items}

    return part


PARTS: dict[str, Callable[[Drives], dict[str, Points]]] = {
    "trajectories under the ids of other samples": shuffled,
    "trajectories under the ids of other": lambda drives: dict(
        zip(drives, list(drives.values())[::-1], strict=True)
    ),
    "trajectories under the ids of": moved_by(5),
    "trajectories under the ids": moved_by(5, only=2),
    "mirrored (y to the right) in a part of its rows": most(mirrored),
    "centimetres in a part of its rows": most(partial(scaled, factor=100)),
}


@pytest.mark.parametrize("words", PARTS)
def test_what_is_wrong_with_a_part_of_the_rows_is_for_the_author_to_mend(
    words: str, planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    """Converting the whole file would spoil the rest, and leave a valid file."""
    mend = profile_of(pairs_of(PARTS[words](planned)), protocol, recorded).mend
    assert mend is not None
    assert mend.looks_like.startswith(words)
    assert mend.convert_option is None
    assert mend.by_hand


def test_a_point_ahead_of_the_axle_is_named_where_no_car_stands(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    moving = {key: points for key, points in recorded.items() if math.hypot(*points[-1]) > 1}
    ahead = changed({key: planned[key] for key in moving}, lambda p: [(x + 2.6, y) for x, y in p])
    mend = profile_of(pairs_of(ahead), protocol, moving).mend
    assert mend is not None
    assert mend.looks_like.startswith("waypoints of a point 2.")
    assert str(mend.convert_option).startswith("--origin-offset-m -2.")


def test_source_and_edited_exchanged_are_named(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    profile = profile_of(pairs_of(changed(planned, braked), planned), protocol, recorded)
    assert profile.mend is not None
    assert profile.mend.convert_option == "--exchange"
    assert profile.longer_sources is not None
    assert profile.longer_sources < 0.05


def test_a_slow_file_that_no_transformation_explains_is_called_slow(
    recorded: Drives, protocol: ProtocolDocument
) -> None:
    creeping = changed(recorded, lambda points: [(0.2 * step, 0.0) for step in range(1, 7)])
    profile = profile_of(pairs_of(creeping), protocol, recorded)
    assert profile.mend is None
    (sentence,) = profile.warnings
    assert sentence.startswith("The sources look too slow: median 0.40 m/s, recorded ")


def test_ten_wild_samples_do_not_matter(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    wild = {
        sample_id: [(190.0, 190.0)] * 6 if number < 10 else points
        for number, (sample_id, points) in enumerate(planned.items())
    }
    calm, stirred = (profile_of(pairs_of(each), protocol, recorded) for each in (planned, wild))
    assert stirred.mend is None
    assert stirred.median_source_l2_m == pytest.approx(calm.median_source_l2_m, abs=0.2)
    assert stirred.source_l2_m is not None
    assert stirred.source_l2_m > 10


def test_the_figures_are_those_of_known_trajectories(protocol: ProtocolDocument) -> None:
    """Recorded: 2 m/s. Source: 1 m behind all the way. One edited stands, one is the source."""
    known = {
        "source_speed_mps": 5 / 3,
        "recorded_speed_mps": 2.0,
        "standing_sources": 0.0,
        "standing_edited": 0.5,
        "equal_pairs": 0.5,
        "longer_sources": 0.5,
        "same_edited": None,
        "source_l2_m": 1.0,
        "source_l2_1s_m": 1.0,
        "source_l2_2s_m": 1.0,
        "source_l2_3s_m": 1.0,
        "median_source_l2_m": 1.0,
    }
    drive = [(float(step), 0.0) for step in range(1, 7)]
    behind = [(x - 1.0, y) for x, y in drive]
    still = [(0.0, 0.0)] * 6
    pairs = pairs_of({"a": behind, "b": behind}, {"a": still, "b": behind})
    profile = profile_of(pairs, protocol, {"a": drive, "b": drive})
    assert profile.model_dump(exclude={"mend"}) == pytest.approx(known)


def test_without_recorded_drives_the_rest_is_told(
    planned: Drives, protocol: ProtocolDocument
) -> None:
    profile = profile_of(pairs_of(changed(planned, increments)), protocol, None)
    assert profile.mend is None
    assert profile.source_l2_m is None
    assert profile.recorded_speed_mps is None
    assert [label for label, _ in profile.lines] == [
        "source speed",
        "standing still",
        "equal pairs",
        "longer source",
    ]


def test_too_few_samples_are_not_judged(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    few = dict(sorted(changed(planned, swapped).items())[: source_fit.MIN_COMPARED - 1])
    assert profile_of(pairs_of(few), protocol, recorded).mend is None


def test_the_order_of_the_file_changes_nothing(
    planned: Drives, recorded: Drives, protocol: ProtocolDocument
) -> None:
    wrong = changed(planned, increments)
    turned = dict(reversed(wrong.items()))
    first, second = (profile_of(pairs_of(each), protocol, recorded) for each in (wrong, turned))
    assert first.mend == second.mend


# Real planners

METHODS = [each for each in realdata.PLANNERS["nuscenes-real"] if each != "recorded-human"]
PUBLISHED_L2_M = {
    "claude-3.7-sonnet": "1.14",
    "gpt-4.1": "1.35",
    "gpt-4o": "1.15",
    "llama-3.2-11b": "1.57",
    "qwen-2.5-7b": "1.49",
}


def real_sources(method: str, protocol: ProtocolDocument) -> dict[str, Points]:
    realdata.require()
    data = realdata.file_path("nuscenes-real", method).read_bytes()
    document = check(data, protocol=protocol).document
    assert isinstance(document, PlanningDocument)
    return {
        sample_id: _points(pair.source)
        for sample_id, pair in document.answers.items()
        if pair.source is not None
    }


def _points(flat: Sequence[float]) -> Points:
    return list(zip(flat[::2], flat[1::2], strict=True))


@pytest.mark.parametrize("method", METHODS)
def test_a_real_planner_is_not_suspected_and_each_mistake_of_it_is_named(
    method: str, protocol: ProtocolDocument
) -> None:
    driven = real_sources("recorded-human", protocol)
    sources = real_sources(method, protocol)
    profile = profile_of(pairs_of(sources), protocol, driven)
    assert profile.warnings == ()
    assert f"{profile.source_l2_m:.2f}" == PUBLISHED_L2_M[method]
    some = dict(sorted(sources.items())[::5])
    found = {
        option: profile_of(pairs_of(changed(some, mistake)), protocol, driven).mend
        for option, mistake in MISTAKES.items()
    }
    assert {option: mend and mend.convert_option for option, mend in found.items()} == {
        option: option for option in MISTAKES
    }


BY_HAND: dict[str, Callable[[dict[str, Points]], dict[str, Points]]] = {
    "waypoints from t = 0 on": lambda all_: changed(all_, lambda p: [(0.0, 0.0), *p[:-1]]),
    "waypoints from 1 s on": lambda all_: changed(all_, lambda p: [*p[1:], sampled(1.0)(p)[3]]),
    "trajectories that stand one row off": lambda all_: dict(
        zip(all_, [*list(all_.values())[1:], *list(all_.values())[:1]], strict=True)
    ),
}
"""What no conversion mends, by the words that name it."""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mistake", BY_HAND)
def test_what_only_its_author_can_mend_is_named_for_real_planners(
    mistake: str, method: str, protocol: ProtocolDocument
) -> None:
    driven = real_sources("recorded-human", protocol)
    wrong = BY_HAND[mistake](real_sources(method, protocol))
    mend = profile_of(pairs_of(wrong), protocol, driven).mend
    assert mend is not None
    assert mend.looks_like.startswith(mistake)
    assert mend.by_hand


@pytest.mark.parametrize("method", realdata.PLANNERS["carla-pairs"])
def test_rows_of_real_pairs_that_stand_one_off_are_named_and_no_right_ones(
    method: str, protocol: ProtocolDocument
) -> None:
    realdata.require()
    data = realdata.file_path("carla-pairs", method).read_bytes()
    document = check(data, protocol=protocol).document
    assert isinstance(document, PlanningDocument)
    assert profile_of(document.answers, protocol, None).mend is None
    edited = [pair.edited for pair in document.answers.values()]
    off = {
        sample_id: TrajectoryPair(pair.source, other)
        for (sample_id, pair), other in zip(
            document.answers.items(), [*edited[1:], edited[0]], strict=True
        )
    }
    mend = profile_of(off, protocol, None).mend
    assert mend is not None
    assert mend.looks_like.startswith("edited trajectories, or the source ones, that stand one row")


def test_a_packed_file_of_the_wrong_frame_is_told_from_its_mirror_image(
    protocol: ProtocolDocument,
) -> None:
    """Without recorded drives x right and x left look alike; the report says both."""
    realdata.require()
    data = gzip.decompress(realdata.wrong_frame_path().read_bytes())
    assert json.loads(data)["predictions"]
    (group,) = check(data, protocol=protocol).report.faults
    assert "--rotate -90" in group.message
    assert "--swap" in group.message
