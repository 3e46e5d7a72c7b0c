"""The queueing model of docs/scaling.md: closed forms, bounds, and a simulation of the same."""

import heapq
import math
import random
from itertools import pairwise

import pytest
from benchmarks.queueing import Demands, mean_wait_s, throughputs


def test_one_slot_takes_what_its_file_takes() -> None:
    assert throughputs(Demands(0.1, 0.02, 0.08), cores=2, slots=1) == pytest.approx([5.0])


def test_slots_that_only_wait_never_hinder_each_other() -> None:
    rates = throughputs(Demands(1e-12, 0.0, 0.5), cores=2, slots=8)
    assert rates == pytest.approx([2.0 * n for n in range(1, 9)])


@pytest.mark.parametrize("cores", [1, 2, 3, 8])
def test_slots_that_only_compute_fill_the_cores_exactly(cores: int) -> None:
    rates = throughputs(Demands(0.25, 0.0, 0.0), cores, slots=12)
    assert rates == pytest.approx([min(n, cores) / 0.25 for n in range(1, 13)])


def test_one_queue_and_waiting_is_the_formula_of_the_repairman() -> None:
    rate, (work_s, waits_s), n = 0.0, (0.2, 0.7), 6
    ratio = work_s / waits_s
    weights = [math.perm(n, k) * ratio**k for k in range(n + 1)]
    rate = (1 - weights[0] / sum(weights)) / work_s
    assert throughputs(Demands(work_s, 0.0, waits_s), cores=1, slots=n)[-1] == pytest.approx(rate)
    assert throughputs(Demands(1e-12, work_s, waits_s), 4, n)[-1] == pytest.approx(rate)


@pytest.mark.parametrize("demands", [Demands(0.1, 0.04, 0.3), Demands(0.05, 0.2, 0.02)])
def test_throughput_rises_with_slots_to_its_bound(demands: Demands) -> None:
    rates = throughputs(demands, cores=2, slots=60)
    assert all(more > 0.999 * less for less, more in pairwise(rates))
    assert 0.99 * demands.most_per_s(2) < rates[-1] <= demands.most_per_s(2) * (1 + 1e-9)


def test_a_simulation_of_slots_that_go_round_agrees() -> None:
    demands, slots = Demands(0.1, 0.03, 0.2), 5
    simulated = _simulated_per_s(demands, cores=2, slots=slots, n=60_000)
    assert throughputs(demands, 2, slots)[-1] == pytest.approx(simulated, rel=0.03)


def test_waiting_at_one_slot_is_that_of_a_plain_queue() -> None:
    assert mean_wait_s(3.0, [4.0]) == pytest.approx(1.0)  # 1 / (mu - lambda)


def test_waiting_at_two_equal_slots_is_erlangs() -> None:
    load = 0.75
    wait_s = 1 / (1 - load**2)  # M/M/2 with service of one second
    assert mean_wait_s(2 * load, [1.0, 2.0]) == pytest.approx(wait_s)


def test_more_arrivals_than_scores_have_no_mean_wait() -> None:
    with pytest.raises(ValueError, match="more arrive"):
        mean_wait_s(4.0, [2.0, 4.0])


def _simulated_per_s(demands: Demands, cores: int, slots: int, n: int) -> float:
    """Let slots go round: cores, chain, waiting; first come, first served, at random times."""
    rng = random.Random(3)
    free = {"cores": cores, "chain": 1}
    mean_s = {"cores": demands.cpu_s, "chain": demands.alone_s, "waits": demands.waits_s}
    after = {"cores": "chain", "chain": "waits", "waits": "cores"}
    lines: dict[str, list[int]] = {"cores": [], "chain": []}
    events: list[tuple[float, int, str]] = []
    now_s, done = 0.0, 0

    def begin(slot: int, place: str) -> None:
        heapq.heappush(events, (now_s + rng.expovariate(1 / mean_s[place]), slot, place))

    def come(slot: int, place: str) -> None:
        if place == "waits":
            begin(slot, place)
        elif free[place]:
            free[place] -= 1
            begin(slot, place)
        else:
            lines[place].append(slot)

    for slot in range(slots):
        come(slot, "cores")
    while done < n:
        now_s, slot, place = heapq.heappop(events)
        if place != "waits":
            if lines[place]:
                begin(lines[place].pop(0), place)
            else:
                free[place] += 1
        done += place == "chain"
        come(slot, after[place])
    return done / now_s
