"""A protocol update of the caution order: what was read and measured stays, only grading runs."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml, parse_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_worker.splits.private_store import PrivateStore
from exceptiondrive_worker.splits.store import load_split
from exceptiondrive_worker.stages import Stages, Target
from exceptiondrive_worker.upload_reader import read_upload

D_BELOW_E = {"A": 0, "B": 1, "D": 2, "E": 3, "C": 4}


@pytest.fixture
def update() -> ProtocolDocument:
    """Protocol 1.1: yielding is less cautious than preparing to bypass; the sets follow."""
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    toml = toml.replace("E = 2, D = 3", "D = 2, E = 3")
    caution = parse_protocol(packaged_protocol_toml()).grading.model_copy(
        update={"caution": D_BELOW_E}
    )
    lines = []
    for line in toml.splitlines():
        if line.startswith("acceptable = "):
            under = caution.under_warning([Strategy(x) for x in json.loads(line.split(" = ")[1])])
        if line.startswith("under_warning = "):
            line = f"under_warning = {json.dumps(list(under))}"
        lines.append(line)
    return parse_protocol("\n".join(lines))


@pytest.fixture
def done() -> Counter[str]:
    return Counter()


@pytest.fixture
def stages(
    tmp_path: Path, tiny: Split, done: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> Stages:
    """Stages over one strategy file, every step counted."""
    # SE1 takes C D, LB1 takes C, RS1 takes C E
    chosen = {"a": "E", "b": "D", "c": "C", "d": "D"}
    predictions = [{"sample_id": key, "strategy": value} for key, value in chosen.items()]
    upload = json.dumps(
        {"schema": "exceptiondrive.strategy/1", "split": tiny.name, "predictions": predictions}
    ).encode()
    strategy = scoring_of(STRATEGY.id)

    def counting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            done[name] += 1
            return function(*args)

        return call

    class Counted(type(strategy)):  # type: ignore[misc]
        measure = staticmethod(counting("measure", strategy.measure))
        grade = staticmethod(counting("grade", strategy.grade))

    monkeypatch.setattr("exceptiondrive_worker.stages.scoring_of", lambda _: Counted())
    return Stages(
        PrivateStore(tmp_path / "private"),
        counting("load", lambda digest: upload),
        counting("read", read_upload),
    )


def test_a_new_order_of_caution_regrades_and_repeats_nothing_else(
    stages: Stages,
    done: Counter[str],
    tiny: Split,
    protocol: ProtocolDocument,
    update: ProtocolDocument,
) -> None:
    target = Target("sha256:upload", STRATEGY, load_split(tiny, protocol), protocol)
    before = stages.score(target).sheet
    assert done == {"load": 1, "read": 1, "measure": 1, "grade": 1}
    done.clear()
    after = stages.score(replace(target, protocol=update, split=load_split(tiny, update))).sheet
    assert done == {"grade": 1}
    # E for SE1 (C D) no longer warns too little, D for RS1 (C E) now does
    assert before.tasks["SE1"].metrics["under_warning"] == 1.0
    assert after.tasks["SE1"].metrics["under_warning"] == 0.0
    assert before.tasks["RS1"].metrics["under_warning"] == 0.0
    assert after.tasks["RS1"].metrics["under_warning"] == 1.0
    assert after.micro["accuracy"] == before.micro["accuracy"] == 0.25


def test_the_first_sheet_comes_back_unchanged_after_the_update(
    stages: Stages,
    done: Counter[str],
    tiny: Split,
    protocol: ProtocolDocument,
    update: ProtocolDocument,
) -> None:
    target = Target("sha256:upload", STRATEGY, load_split(tiny, protocol), protocol)
    digest = stages.score(target).digest
    stages.score(replace(target, protocol=update, split=load_split(tiny, update)))
    done.clear()
    assert stages.score(target).digest == digest
    assert done == {"grade": 1}
