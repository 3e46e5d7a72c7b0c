"""A new order of caution on the strategy challenge, from document to rollback, by CLI and API."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.rescoring.application import Organizer, Serve
from tests.rescoring.documents import (
    caution_protocol,
    strategy_file,
)

from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_worker.stages import Scored, Stages, Target

Stage = Any
D_BELOW_E = {"A": 0, "B": 1, "D": 2, "E": 3, "C": 4}
REASON = ("--reason", "yielding is less cautious than preparing to bypass")


def entry_of(board: bytes, method: str) -> Any:
    (entry,) = (row for row in json.loads(board)["entries"] if row["method"] == method)
    return entry


def counted(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count from here on which stages of scoring a worker runs."""
    done: Counter[str] = Counter()

    class Counting(Stages):
        def _read(self, *given: Any) -> Any:
            done["read"] += 1
            return super()._read(*given)

        def score(self, target: Target) -> Scored:
            done["score" if target.made is None else "score a reference row"] += 1
            return super().score(target)

    old = stage.context.stages
    monkeypatch.setattr(
        "exceptiondrive_worker.stages.scoring_of",
        lambda challenge_id: _CountingMeasure(scoring_of(challenge_id), done),
    )
    stages = Counting(old.private, old._load_upload, old._read_answers)
    stage.context = replace(stage.context, stages=stages)
    return done


class _CountingMeasure:
    """A challenge's scoring that counts its measurements."""

    def __init__(self, scoring: Any, done: Counter[str]) -> None:
        self._scoring = scoring
        self._done = done

    def __getattr__(self, name: str) -> Any:
        if name == "measure":
            self._done["measure"] += 1
        return getattr(self._scoring, name)


@pytest.fixture
def organizer(agents: Stage, serve: Serve, tmp_path: Path) -> Organizer:
    return Organizer(*serve(agents), tmp_path)


def test_a_new_order_of_caution_goes_from_document_to_rollback(
    agents: Stage,
    organizer: Organizer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    toml = tmp_path / "1.1.toml"
    toml.write_text(caution_protocol("1.1", D_BELOW_E))
    told = organizer.say("protocols", "diff", str(toml), "--phase", "dev")
    assert "A < B < E < D < C -> A < B < D < E < C" in told
    assert "under-warning strategies of task SE1 (occluded pedestrian): A, B, E -> A, B" in told
    assert "regrade only, 3 sheets" in told
    organizer.say("protocols", "add", str(toml))
    done = counted(agents, monkeypatch)
    draft = ("--phase", "dev", "--protocol", "1.1", "--draft")
    run = organizer.rescore("start", *draft, *REASON)
    organizer.rescore("begin", run["id"], *REASON)
    assert agents.work() == 3
    scored = {"score": 3, "score a reference row": 1}
    assert done == scored, "a new order of caution reads and measures nothing again"

    before = organizer.board()
    preview = organizer.rescore("preview", run["id"])
    changes = {entry["method"]: entry for entry in preview["comparison"]["entries"]}
    agent, helped = changes["agent"], changes["agent+reminder"]
    assert agent["metric_shifts"]["accuracy"] == 0.0
    assert agent["metric_shifts"]["under_warning"] == pytest.approx(1 / 6, abs=1e-4)
    assert helped["metric_shifts"]["under_warning"] == pytest.approx(-1 / 6, abs=1e-4)
    assert helped["effect_shifts"]["accuracy"] == 0.0
    assert helped["effect_shifts"]["under_warning"] == pytest.approx(-1 / 3, abs=1e-4)
    assert "effect_shifts" not in agent
    assert (changes["careful"]["change"], helped["change"]) == ("none", "numbers")
    read = organizer.say("rescore", "preview", run["id"])
    assert "reminder's effect on agent+reminder: Accuracy +50.00 -> +50.00, " in read
    assert "Under-warning -16.67 -> -50.00" in read
    assert organizer.board() == before

    organizer.rescore("apply", run["id"], "--preview", preview["digest"], *REASON)
    after = organizer.board()
    old, new = (entry_of(board, "agent+reminder") for board in (before, after))
    for board, protocol, shift in ((old, "1.0", -1 / 6), (new, "1.1", -1 / 2)):
        effect = board["reminder_effect"]["differences"]["under_warning"]
        assert effect["difference"] == pytest.approx(shift, abs=1e-4), protocol
    assert old["metrics"]["accuracy"] == new["metrics"]["accuracy"] == 0.5
    assert new["metrics"]["under_warning"] == pytest.approx(1 / 3, abs=1e-4)
    assert json.loads(after)["protocol"]["version"] == "1.1"

    organizer.rescore("rollback", run["id"], *REASON)
    assert organizer.board() == before


def test_a_csv_carries_the_reminders_effect_before_and_after(
    agents: Stage,
    organizer: Organizer,
    tmp_path: Path,
) -> None:
    run_id = agents.ready(caution_protocol("1.1", D_BELOW_E))
    path = tmp_path / "new.csv"
    organizer.say("rescore", "preview", run_id, "--csv", str(path))
    organizer.refuse("cannot be written", "rescore", "preview", run_id, "--csv", str(tmp_path))
    head, *lines = (line.split(",") for line in path.read_text().splitlines())
    rows = {row["method"]: row for row in (dict(zip(head, line, strict=True)) for line in lines)}
    linked = rows["agent+reminder"]
    assert float(linked["old_under_warning.reminder_effect"]) == pytest.approx(-1 / 6, abs=1e-4)
    assert float(linked["new_under_warning.reminder_effect"]) == pytest.approx(-1 / 2, abs=1e-4)
    assert rows["agent"]["new_under_warning.reminder_effect"] == ""


def test_a_team_is_told_when_only_the_effect_of_its_reminder_changes(agents: Stage) -> None:
    """The entry's own numbers stay; those of its counterpart, and so the effect, do not."""
    unmoved = caution_protocol("1.1", D_BELOW_E)
    agents.submit_file(strategy_file("CCCC"), "sure", "alpha", linked_to=agents.submitted[0])
    agents.work()
    run_id = agents.ready(unmoved)
    (entry,) = (
        entry for entry in agents.preview(run_id).comparison.entries if entry.method == "sure"
    )
    assert entry.old.metrics == entry.new.metrics
    assert (entry.change, entry.effect_shifts["accuracy"]) == ("numbers", 0.0)
    agents.apply(run_id)
    with agents.database.read() as session:
        (notice,) = list_notifications(session, find_team(session, "alpha").id)
        assert list_notifications(session, find_team(session, "beta").id) == []
    assert "sure" in {told.method for told in notice.entries}
