"""How a worker process stands beside the others on its machine."""

import multiprocessing
import os
from multiprocessing.connection import Connection

import pytest

from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.process import BACKGROUND_NICENESS, give_way

LEAST_PRIORITY = 19
"""Of any process: more than that is not taken away."""


def _say_niceness(lanes: tuple[Lane, ...], answer: Connection) -> None:
    give_way(lanes)
    answer.send(os.nice(0))


@pytest.mark.parametrize(
    ("lanes", "expected"),
    [
        ((Lane.RESCORE,), BACKGROUND_NICENESS),
        ((Lane.LIVE,), 0),
        ((Lane.LIVE, Lane.RESCORE), 0),
    ],
)
def test_a_worker_of_the_background_alone_gives_way(lanes: tuple[Lane, ...], expected: int) -> None:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_say_niceness, args=(lanes, there))
    process.start()
    process.join(30)
    assert here.poll(), "the process said nothing"
    assert here.recv() == min(os.nice(0) + expected, LEAST_PRIORITY)
