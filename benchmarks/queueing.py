"""A queueing model of scoring: slots that go round between cores, the audit chain and waiting. Pure.

Exact mean value analysis of a closed network (Reiser and Lavenberg 1980), service times taken as
exponential. Each of `slots` worker processes always has a file: it computes on one of the cores, waits
for what nobody else is kept from by (round trips to database and broker), and passes what one does at a
time: the end of a write transaction, which holds the head of the audit chain.
"""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Demands:
    """What one file takes.

    Attributes:
        cpu_s: CPU seconds on any of the cores.
        alone_s: Seconds that one file at a time has for itself.
        waits_s: Seconds of waiting that keep nobody else.
    """

    cpu_s: float
    alone_s: float
    waits_s: float

    def most_per_s(self, cores: int) -> float:
        """Files a second that no number of slots goes beyond."""
        return min(cores / self.cpu_s, 1 / self.alone_s if self.alone_s else float("inf"))


def throughputs(demands: Demands, cores: int, slots: int) -> list[float]:
    """Return files a second with 1, 2, ... `slots` slots."""
    cpu_s, in_chain, in_cores = demands.cpu_s, 0.0, 0.0
    idle = [1.0] + [0.0] * (cores - 1)
    """Probability that so many files are at the cores."""
    found = []
    for n in range(1, slots + 1):
        spare = sum((cores - 1 - j) * share for j, share in enumerate(idle))
        at_cores_s = cpu_s / cores * (1 + in_cores + spare)
        at_chain_s = demands.alone_s * (1 + in_chain)
        rate = n / (at_cores_s + at_chain_s + demands.waits_s)
        in_cores, in_chain = rate * at_cores_s, rate * at_chain_s
        busy = [cpu_s / j * rate * idle[j - 1] for j in range(1, cores)]
        some = sum((cores - j) * share for j, share in enumerate(busy, start=1))
        idle = [max(0.0, 1 - (cpu_s * rate + some) / cores), *busy]
        found.append(rate)
    return found


def mean_wait_s(arrivals_per_s: float, rates: Sequence[float]) -> float:
    """Return seconds from arrival to score where files come at random (a birth-death chain).

    Args:
        arrivals_per_s: Fewer than the last rate.
        rates: Files a second while 1, 2, ... of them are in service, from `throughputs`.

    Raises:
        ValueError: More come than are scored: the queue grows without end.
    """
    load = arrivals_per_s / rates[-1]
    if load >= 1:
        raise ValueError("more arrive than can be scored")
    weights = [1.0]
    for rate in rates:
        weights.append(weights[-1] * arrivals_per_s / rate)
    last, n = weights[-1], len(rates)
    total = sum(weights) + last * load / (1 - load)
    present = sum(k * weight for k, weight in enumerate(weights))
    present += last * (n * load / (1 - load) + load / (1 - load) ** 2)
    return present / total / arrivals_per_s
