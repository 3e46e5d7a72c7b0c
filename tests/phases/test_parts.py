"""A split with parts: the live board counts one part, the other is revealed at the end."""

import re
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import event
from tests.phases.browsing import visitor
from tests.phases.life import CAREFUL, PRIVATE_ONLY, PUBLIC_ONLY, SAMPLES, split_of
from tests.support.databases import POSTGRES_ALONE, wait_until_it_waits
from tests.support.documents import strategy_file
from tests.support.worker import add_split

from exceptiondrive_records.db.errors import PhaseClosed
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.flip import apply_run
from exceptiondrive_records.rescoring.showing import reveal_board
from exceptiondrive_records.rescoring.views import preview_of
from exceptiondrive_records.splits.drawings import entry_drawings
from exceptiondrive_records.splits.splits import find_split, list_splits
from exceptiondrive_records.submissions.submissions import accept, find_submission, lock_jobs
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.datasheet import SplitChange
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.sample.files import sample_datasheet
from exceptiondrive_worker.splits.admin import (
    SplitsRefusedError,
    add_split_file,
    publish_split_file,
)
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.store import SplitStore, SplitUnavailableError, load_split

if TYPE_CHECKING:
    from tests.phases.life import Life

MOVES_NO_MORE = "From the reveal on, for good, the deadline moves no more."
PLACES = (
    "/?phase=test",
    "/export/board.csv?phase=test",
    "/export/board.tex?phase=test",
    "/feed.atom?phase=test",
    "/compare?phase=test",
    "/api/v1/leaderboard?phase=test",
    "/api/v1/leaderboard.csv?phase=test",
    "/api/v1/boards?phase=test",
    "/api/v1/phases",
    "/api/v1/phases/test",
    "/api/v1/phases/test/manifest",
)
OF_ENTRY = (
    "/entries/{id}",
    "/badges/{id}.svg",
    "/api/v1/entries/{id}",
    "/api/v1/entries/{id}/receipt",
)
OF_TEAM = (
    "/api/v1/submissions",
    "/api/v1/submissions/{id}",
    "/api/v1/submissions/{id}/receipt",
    "/api/v1/notifications",
)


def everything(life: "Life", who: str, submission_id: str) -> str:
    """All that a participant can read about the phase and an own submission."""
    texts = [life.get(path.format(id=submission_id)).text for path in PLACES + OF_ENTRY]
    texts += [life.get(path.format(id=submission_id), who).text for path in OF_TEAM]
    texts += [life.get(f"/api/v1/boards/test/{number}").text for number in range(1, 9)]
    return re.sub(r'"request_id": ?"[^"]*"', "", "\n".join(texts))


def test_a_split_with_parts_is_three_revisions_and_the_whole_is_the_default(life: "Life") -> None:
    found = life.revisions()
    assert set(found) == {None, "public", "private"}
    assert len(set(found.values())) == 3
    with life.database.read() as session:
        whole = find_split(session, "parted")
        assert (whole.part, whole.n_samples) == (None, 5)
        public = find_split(session, "parted", found["public"])
        assert (public.n_samples, public.family_counts) == (
            2,
            {"sudden_emergence": 1, "lane_blockage": 1},
        )
        assert public.manifest.sample_ids == whole.manifest.sample_ids


def test_what_a_part_holds_is_in_no_column_of_the_server(life: "Life") -> None:
    """Manifest and row of a part name all samples alike: nobody can tell which ones count."""
    found = life.revisions()
    with life.database.read() as session:
        rows = {row.part: row for row in list_splits(session) if row.name == "parted"}
        documents = {
            part: canonical_json(row.manifest).decode().replace(found[part], "REVISION")
            for part, row in rows.items()
        }
    assert documents["public"] == documents["private"] == documents[None]


@pytest.mark.parametrize("told_by", ["words", "datasheet"])
def test_a_later_revision_tells_of_each_part_what_changes_in_it(life: "Life", told_by: str) -> None:
    """A count over both parts would be untrue of the board, which counts one of them."""
    before, words = life.revisions(), "b goes, a comes nearer."
    life.make_phase()
    nearer = split_of(SAMPLES | {"a": ("SE1", 9.0, "private")}, "parted")
    samples = (
        it.model_copy(update={"withdrawn": "no hazard"}) if it.sample_id == "b" else it
        for it in nearer.samples
    )
    later = nearer.model_copy(update={"samples": tuple(samples)})
    if told_by == "datasheet":
        changes = SplitChange.between(split_of(SAMPLES, "parted"), later, words)
        sheet = sample_datasheet(later).model_copy(update={"changes": changes})
        path = life.worker.splits_dir / "parted" / "datasheet-2.json"
        path.write_bytes(canonical_json(sheet))
    said = words if told_by == "words" else ""
    add_split(life.database, life.worker.splits_dir, later, "split-2.json", said)
    with life.database.read() as session:
        rows = [row for row in list_splits(session) if row.changes is not None]
        after = {row.part: row.revision for row in rows}
        told = {row.part: row.changes.model_dump() for row in rows if row.changes is not None}
    told_words = {"words": words, "restored": 0, "drives": 0, "marks": 0}
    assert told == {
        None: told_words | {"previous": before[None], "moved": 1, "withdrawn": 1},
        "public": told_words | {"previous": before["public"], "moved": 0, "withdrawn": 1},
        "private": told_words | {"previous": before["private"], "moved": 1, "withdrawn": 0},
    }
    of_all = life.start_run(split_revision=after[None])
    assert life.json(f"/api/v1/organizer/rescoring/{of_all}", "organizer")["blockers"][-1] == (
        "To count the public part of that revision instead, cancel this run and name "
        f"{after['public']}."
    )
    life.done(f"/rescoring/{of_all}/cancel")
    run = life.start_run(split_revision=after["public"])
    view = life.json(f"/api/v1/organizer/rescoring/{run}", "organizer")
    assert [change["sentence"] for change in view["difference"]["changes"]] == [
        words,
        "1 sample withdrawn: files still answer, none counts",
        "N goes from 2 to 1",
    ]


def test_what_is_scored_as_a_whole_gets_no_parts(life: "Life") -> None:
    """Its private samples were scored before their time."""
    parted = split_of(SAMPLES, "plain")
    source, splits = life.worker.private_dir / "new.json", SplitStore(life.worker.splits_dir)
    source.parent.mkdir(exist_ok=True)
    source.write_text(parted.model_dump_json(by_alias=True, exclude_none=True))
    life.make_phase("whole", split="plain")
    life.submit("alpha", CAREFUL, "Planner", "plain", "whole")
    life.work()
    before = splits.files()
    with pytest.raises(SplitUnavailableError, match="is scored before its time"):
        add_split_file(life.database, splits, source, packaged_protocol(), "Half is kept.")
    assert splits.files() == before
    (held,) = (path for path in before if path.parent.name == "plain")
    away = held.rename(life.worker.private_dir / "away.json")
    with pytest.raises(SplitUnavailableError, match="is scored before its time"):
        add_split_file(life.database, splits, source, packaged_protocol(), "")
    assert held not in splits.files()
    away.rename(held)
    with pytest.raises(SplitsRefusedError, match="is scored before its time"):
        add_split(life.database, life.worker.splits_dir, parted, "split-2.json", "Half is kept.")
    with life.database.read() as session:
        assert [row.part for row in list_splits(session) if row.name == "plain"] == [None]


def test_the_live_board_counts_the_public_part_of_files_that_answer_everything(
    life: "Life",
) -> None:
    made = life.make_phase()
    assert (made["n_samples"], made["now"]["part"], made["now"]["n_counted"]) == (5, "public", 2)
    life.submit("alpha", PUBLIC_ONLY)
    life.submit("beta", PRIVATE_ONLY)
    life.work()
    board = life.board()
    assert (board["n_samples"], board["part"]) == (2, "public")
    first, second = board["entries"]
    assert (first["team"], first["metrics"]["ur"]) == ("Alpha Institute", 0.0)
    assert (second["team"], second["metrics"]["ur"]) == ("Beta Labs", 1.0)


def test_a_part_scores_as_a_split_of_its_samples_alone(life: "Life") -> None:
    """The sheet under a part equals that of a split which holds nothing else."""
    alone = {key: value for key, value in SAMPLES.items() if value[2] == "private"}
    life.add_split(split_of({k: (t, m, None) for k, (t, m, _) in alone.items()}, "alone"))
    life.make_phase("lone", split="alone")
    life.make_phase()
    mixed = {"a": 9.0, "b": 9.0, "c": 1.0, "d": 9.0, "e": 3.5}
    life.submit("alpha", mixed)
    lone = {key: speed for key, speed in mixed.items() if key in alone}
    life.submit("alpha", lone, "Planner", "alone", "lone")
    life.work()
    life.move(closes_at=life.now())
    life.apply(life.reveal())
    shown, expected = life.board()["entries"][0], life.board(phase="lone")["entries"][0]
    for key in ("metrics", "micro", "families", "intervals", "coverage", "flags"):
        assert shown[key] == expected[key], key


def test_every_sample_must_be_answered_whatever_counts(life: "Life") -> None:
    life.make_phase()
    lacking = life.submit("alpha", {"a": 1.0, "b": 1.0})
    life.work()
    view = life.json(f"/api/v1/submissions/{lacking}", "alpha")
    assert view["status"] == "rejected"
    assert '"c"' in str(view["report"]).replace("'", '"')


def test_nothing_of_the_private_part_is_readable_before_it_is_revealed(life: "Life") -> None:
    life.make_phase()
    mine = life.submit("alpha", PUBLIC_ONLY)
    life.submit("beta", PRIVATE_ONLY)
    life.work()
    before = everything(life, "alpha", mine)
    run = life.reveal()
    preview = life.json(f"/api/v1/organizer/rescoring/{run}/preview", "organizer")
    assert [entry["new"]["metrics"]["ur"] for entry in preview["comparison"]["entries"]] == [1, 0]
    private = life.revisions()["private"]
    seen = everything(life, "alpha", mine)
    assert private not in seen
    assert seen == before  # draft sheets and the draft board changed nothing that can be read
    assert life.get(f"/api/v1/rescoring/{run}").status_code == 404
    assert life.get(f"/api/v1/organizer/rescoring/{run}/preview", "alpha").status_code == 403


def accepted_with_its_first_byte(life: "Life", at: datetime, content: str) -> Submission:
    with life.database.write() as session:
        team = find_team(session, "beta")
        return accept(
            session,
            team_id=team.id,
            phase_id="test",
            method="Held in the air",
            file_digest=content,
            size_bytes=1,
            arrived_at=at,
        ).submission


@pytest.mark.parametrize("policy", [{}, {"late_entries": "own_view"}])
def test_an_upload_in_the_air_answers_nothing_that_was_revealed(
    life: "Life", policy: dict[str, str]
) -> None:
    """Its first byte came before the deadline; what it answers is written after the reveal."""
    life.make_phase(closes_at=life.ahead(60), policy={"live_part": "public", **policy})
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    run, before = life.reveal(), life.now() - timedelta(seconds=1)
    life.move(closes_at=life.now())
    slow = accepted_with_its_first_byte(life, before, "sha256:slow")
    assert slow.arrived_at == before, "a slow upload is in time until then"
    life.work()
    life.apply(run)
    with pytest.raises(PhaseClosed, match="closed at"):
        accepted_with_its_first_byte(life, before, "sha256:held")


@pytest.mark.parametrize("what", ["split", "board"])
def test_a_later_deadline_of_a_team_ends_with_the_reveal(life: "Life", what: str) -> None:
    """Else it chooses its final entry by the scores that were kept from all."""
    hidden = {"live_part": "public"} if what == "split" else {"frozen_scores": "hidden"}
    life.make_phase(
        split="parted" if what == "split" else "plain",
        closes_at=life.ahead(60),
        policy={"entries_shown": "chosen", "run_choice": "team", **hidden},
    )
    split = "parted" if what == "split" else "plain"
    own = [life.submit("beta", way, "M", split) for way in (PUBLIC_ONLY, PRIVATE_ONLY)]
    life.work()
    run = life.reveal() if what == "split" else life.done("/phases/test/freeze") and ""
    life.move(closes_at=life.now())
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    life.done("/teams/beta/allowances/test", grant, "PATCH")
    chosen = f"/api/v1/submissions/{own[0]}/choose"
    assert life.request("POST", chosen, "beta").status_code == 200
    organizer = visitor(life, "organizer")
    until = f"{datetime.fromisoformat(grant['closes_at']):%Y-%m-%d %H:%M} UTC"
    words = f"Beta Labs has a deadline of its own, {until}: it ends with the reveal."
    page = organizer.get(f"/organize/phases/test/reveal-{what}").text
    assert words in page
    assert MOVES_NO_MORE in page
    assert words not in organizer.get("/organize/phases/test/reveal-names").text
    if what == "split":
        life.work()
        path = f"/rescoring/{run}/preview"
        preview = life.json(f"/api/v1/organizer{path}", "organizer")
        assert preview["warnings"] == [MOVES_NO_MORE, words]
        assert words in organizer.get(f"/organize{path}").text
        step = f"/organize/rescoring/{run}/apply?preview={preview['digest']}"
        assert words in organizer.get(step).text
        life.apply(run)
        assert life.json(f"/api/v1/organizer{path}", "organizer")["warnings"] == []
    else:
        life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    for each in own:
        refused = life.request("POST", f"/api/v1/submissions/{each}/choose", "beta")
        assert refused.status_code == 409
    told = [n for n in life.json("/api/v1/notifications", "beta") if n["kind"] == "allowance"]
    assert {one["title"] for one in told} == {
        "What your team may submit to Test is changed",
        "Your team's own deadline in Test has ended",
    }
    assert [until in one["what_changed"][-1] for one in told] == [True] * 2
    for team in ("alpha", "gamma"):
        kinds = {one["kind"] for one in life.json("/api/v1/notifications", team)}
        assert "allowance" not in kinds
    shown = " ".join(organizer.get("/organize/teams/beta").text.split())
    assert "UTC</time>, ended with the reveal" in shown
    (own_limits,) = life.json("/api/v1/organizer/teams/beta/participation", "organizer")[
        "allowances"
    ]
    assert own_limits["is_ended_by_reveal"]
    late = life.upload("beta", 3.0, "M", split)
    assert (late.status_code, "own deadline ended" in late.json()["detail"]) == (403, True)
    assert life.get("/phases/test/report").status_code == 200, "all teams are done"
    assert "revealed" in life.refused("/teams/beta/allowances/test", grant, 409, "PATCH")


@POSTGRES_ALONE
@pytest.mark.parametrize("what", ["split", "board"])
def test_an_upload_that_is_under_way_at_a_reveal_takes_no_later_deadline_past_it(
    life: "Life", what: str
) -> None:
    """Else its team chooses between two entries by the scores that were kept from all."""
    hidden = {"live_part": "public"} if what == "split" else {"frozen_scores": "hidden"}
    life.make_phase(closes_at=life.ahead(60), policy={"run_choice": "team", **hidden})
    life.submit("beta", PUBLIC_ONLY)
    life.work()
    run = life.reveal() if what == "split" else life.done("/phases/test/freeze") and ""
    life.move(closes_at=life.now())
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    life.done("/teams/beta/allowances/test", grant, "PATCH")
    life.work()

    def reveal() -> None:
        with life.database.write() as session:
            if what == "board":
                reveal_board(session, "test", reason="the end", actor="test")
            else:
                seen = preview_of(session, run).digest
                apply_run(session, run, preview=seen, reason="the end", actor="test")

    with ThreadPoolExecutor() as pool:
        reveals: list[Future[None]] = []

        def reveal_before(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
            if statement.startswith("INSERT INTO submissions") and not reveals:
                reveals.append(pool.submit(reveal))
                wait_until_it_waits(life.database, reveals[0].done)

        services = life.client.app.state.services  # type: ignore[attr-defined]
        event.listen(services.database.engine, "before_cursor_execute", reveal_before)
        newest = life.submit("beta", PRIVATE_ONLY)
        reveals[0].result()
    life.work()
    assert newest in life.entry_ids()
    chosen = life.request("POST", f"/api/v1/submissions/{newest}/choose", "beta")
    assert (chosen.status_code, "deadline was" in chosen.json()["detail"]) == (409, True)


@POSTGRES_ALONE
def test_a_reveal_takes_jobs_before_the_submissions_whose_later_deadline_it_ends(
    life: "Life",
) -> None:
    life.make_phase(closes_at=life.ahead(60), policy={"live_part": "public"})
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    run = life.reveal()
    life.move(closes_at=life.now())
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    life.done("/teams/beta/allowances/test", grant, "PATCH")
    life.work()
    waiting = life.submit("beta", PUBLIC_ONLY)

    def reveal() -> None:
        with life.database.write() as session:
            seen = preview_of(session, run).digest
            apply_run(session, run, preview=seen, reason="the end", actor="test")

    with ThreadPoolExecutor() as pool:
        with life.database.write() as session:
            lock_jobs(session, Job.submission_id == waiting)  # as an organizer's `withdraw`
            revealing = pool.submit(reveal)
            wait_until_it_waits(life.database, revealing.done)
            find_submission(session, waiting, lock=True)
        revealing.result()


@pytest.mark.parametrize("scores", ["shown", "hidden"])
def test_a_reveal_of_the_split_says_that_it_ends_the_freeze_for_good(
    life: "Life", scores: str
) -> None:
    """After a rollback readers see what the freeze hid: whoever applies it knows that before."""
    policy = {"frozen_scores": scores, "late_entries": "own_view"}
    life.make_phase(closes_at=life.ahead(60), policy=policy)
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    life.done("/phases/test/freeze")
    hidden = life.submit("beta", CAREFUL)
    life.work()
    life.move(closes_at=life.now())
    run = life.reveal()
    preview = life.json(f"/api/v1/organizer/rescoring/{run}/preview", "organizer")
    freeze, late = (
        "The freeze ends with this; a rollback does not bring it back.",
        "Late files are refused from the reveal on, also after a rollback.",
    )
    assert preview["warnings"] == [freeze, late, MOVES_NO_MORE]
    organizer = visitor(life, "organizer")
    for page in (
        f"/organize/rescoring/{run}/preview",
        f"/organize/rescoring/{run}/apply?preview={preview['digest']}",
    ):
        assert freeze in organizer.get(page).text
    assert late in organizer.get("/organize/phases/test/reveal-split").text
    life.apply(run)
    (line,) = life.json("/api/v1/organizer/audit?action=freeze ended", "organizer")
    assert (line["subject"], line["detail"]) == ("test", {"reason": "as announced", "board": 1})
    titles = [one["title"] for one in life.json("/api/v1/notifications", "beta")]
    assert titles.count("The board of Test is revealed") == (scores == "hidden")
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    assert hidden in life.entry_ids()
    assert len(life.json("/api/v1/organizer/audit?action=freeze ended", "organizer")) == 1


@pytest.mark.parametrize("is_revealed", [False, True])
def test_no_run_is_restored_once_scores_were_revealed(life: "Life", is_revealed: bool) -> None:
    """Else whoever organizes the phase picks a team's final entry by what was kept from all."""
    policy = {"frozen_scores": "hidden", "run_choice": "team"}
    life.make_phase(split="plain", closes_at=life.ahead(60), policy=policy)
    life.done("/phases/test/freeze")
    _, newest = (life.submit("beta", way, "M", "plain") for way in (PUBLIC_ONLY, PRIVATE_ONLY))
    life.work()
    life.request("POST", f"/api/v1/submissions/{newest}/withdraw", "beta")
    life.move(closes_at=life.now())
    restore = f"/submissions/{newest}/restore"
    if not is_revealed:
        life.done(restore)
        return
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    assert "can no longer be restored" in life.refused(restore, {"reason": "x"}, 409)


def test_what_stood_at_the_deadline_and_was_withdrawn_after_the_reveal_is_restored(
    life: "Life",
) -> None:
    life.make_phase(closes_at=life.ahead(60))
    entry = life.submit("beta", PUBLIC_ONLY)
    life.work()
    life.move(closes_at=life.now())
    life.apply(life.reveal())
    life.request("POST", f"/api/v1/submissions/{entry}/withdraw", "beta")
    life.work()
    assert life.entry_ids() == []
    words = "only if it was withdrawn after the deadline"
    assert words in visitor(life, "beta").get(f"/submissions/{entry}").text
    life.done(f"/submissions/{entry}/restore")
    life.work()
    assert life.entry_ids() == [entry]


def test_an_upload_in_the_air_answers_no_board_that_was_hidden(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"frozen_scores": "hidden"})
    before = life.now() - timedelta(seconds=1)
    life.done("/phases/test/freeze")
    life.move(closes_at=life.now())
    assert accepted_with_its_first_byte(life, before, "sha256:slow").arrived_at == before
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    with pytest.raises(PhaseClosed, match="closed at"):
        accepted_with_its_first_byte(life, before, "sha256:held")


def test_what_a_freeze_hid_and_a_reveal_showed_opens_nothing_again(life: "Life") -> None:
    """Else an organizer shows the scores, then lets teams choose, or upload, by what was shown."""
    life.make_phase(
        split="plain",
        closes_at=life.ahead(60),
        policy={"frozen_scores": "hidden", "run_choice": "team"},
    )
    life.done("/phases/test/freeze")
    life.submit("alpha", PUBLIC_ONLY, "M", "plain")
    shown = {"policy": {"frozen_scores": "shown"}}
    words = "can no longer change"
    assert words in life.refused("/phases/test", shown, 409, "PATCH"), "during the freeze"
    life.move(closes_at=life.now())
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    assert words in life.refused("/phases/test", shown, 409, "PATCH")
    for later in (life.ahead(60), None):
        refused = life.refused("/phases/test", {"closes_at": later}, 409, "PATCH")
        assert "Create another phase" in refused
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    assert "revealed" in life.refused("/teams/alpha/allowances/test", grant, 409, "PATCH")


def test_a_freeze_that_was_ended_before_the_deadline_lets_it_move(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"frozen_scores": "hidden"})
    life.done("/phases/test/freeze")
    life.done("/phases/test/reveal", {"what": "board", "reason": "a pause is over"})
    life.change({"closes_at": life.ahead(90)})


def test_the_reveal_waits_for_the_deadline_then_flips_the_board_once(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    life.submit("alpha", PUBLIC_ONLY)
    life.submit("beta", PRIVATE_ONLY)
    life.work()
    run = life.reveal()
    preview = life.json(f"/api/v1/organizer/rescoring/{run}/preview", "organizer")
    organizer, waits = (
        visitor(life, "organizer"),
        "ready, but something prevents applying",
    )
    for address in ("/organize", f"/organize/rescoring/{run}"):
        assert waits in organizer.get(address).text
    body = {"preview": preview["digest"], "reason": "too early"}
    assert "open until" in life.refused(f"/rescoring/{run}/apply", body, 409)
    old = life.get("/api/v1/boards/test/1").text
    since = life.json("/api/v1/boards?phase=test")[0]["shown_from"]
    life.move(closes_at=life.now())
    life.apply(run)
    board = life.board()
    assert (board["n_samples"], board["part"]) == (3, "private")
    assert [entry["team"] for entry in board["entries"]] == ["Beta Labs", "Alpha Institute"]
    assert life.json("/api/v1/phases/test")["now"]["part"] == "private"
    assert "(private part), whose" in life.get("/phases/test").text
    assert "counts 3 samples, the private part of the split." in life.get("/?phase=test").text
    for later in (life.ahead(60), None):  # the private part would answer live uploads
        refused = life.refused("/phases/test", {"closes_at": later}, 409, "PATCH")
        assert "Create another phase" in refused
    assert life.board(f"&as_of={since}")["part"] == "public"
    assert life.get("/api/v1/boards/test/1").text == old
    changes = life.json("/api/v1/boards?phase=test")[0]["what_changed"]
    words = (
        "the private part of the split (3 samples) counts in place of the public part of the split"
    )
    assert changes == [f"{words} (2 samples)"]
    assert "other samples count: the private part;" in life.get("/?phase=test").text
    history = life.get("/history?phase=test").text
    assert history.count("<polyline") == 4, "two a drawing, which no line joins"
    assert ">other samples</text>" in history
    for page in (
        life.get(f"/rescoring/{run}"),
        visitor(life, "organizer").get(f"/organize/rescoring/{run}/preview"),
    ):
        assert "different samples count, or the same ones" in page.text


def test_a_reveal_that_is_rolled_back_stays_known(life: "Life") -> None:
    """What teams read of the private part they know: nothing that asks it opens again."""
    life.make_phase(closes_at=life.ahead(60), policy={"entries_shown": "chosen"})
    own = life.submit("beta", PUBLIC_ONLY)
    life.work()
    run, before = life.reveal(), life.now() - timedelta(seconds=1)
    life.move(closes_at=life.now())
    life.apply(run)
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    assert life.json("/api/v1/phases/test")["now"]["part"] == "public"
    refused = life.refused("/phases/test", {"closes_at": life.ahead(60)}, 409, "PATCH")
    assert "Create another phase" in refused
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    assert "revealed" in life.refused("/teams/beta/allowances/test", grant, 409, "PATCH")
    assert life.request("POST", f"/api/v1/submissions/{own}/choose", "beta").status_code == 409
    with pytest.raises(PhaseClosed, match="closed at"):
        accepted_with_its_first_byte(life, before, "sha256:held")


def test_after_a_rollback_pages_say_what_stands(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    own = life.submit("alpha", PUBLIC_ONLY)
    life.submit("beta", PRIVATE_ONLY)
    life.work()
    life.move(closes_at=life.now())
    run = life.reveal()
    life.apply(run)
    entry, report = f"/entries/{own}?phase=test", "/phases/test/report"
    public, private = (board["board"] for board in life.json("/api/v1/boards?phase=test")[::-1])
    stands = 'board={0}#board">board {0}</a>'
    assert stands.format(private) in life.get(entry).text
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    assert life.board()["board"] == life.board("&protocol=1.0")["board"] == public
    assert stands.format(public) in life.get(entry).text, "the board that is shown, built earlier"
    assert stands.format(private) not in life.get(entry).text
    assert (
        "Newest run (rolled back)" in visitor(life, "organizer").get("/organize/phases/test").text
    )
    told = life.get(report).text
    assert "Only the public part of the split counts." in told
    assert "not been revealed" not in told, "readers saw it"
    for page in (f"/rescoring/{run}", f"/organize/rescoring/{run}"):
        told = visitor(life, "organizer").get(page).text
        assert "Reveal of the private part of parted" in told
        assert "nother revision" not in told


def test_a_team_is_told_of_a_reveal_by_its_own_names(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60), policy={"anonymous": True})
    own = life.submit("alpha", PUBLIC_ONLY)
    life.work()
    life.move(closes_at=life.now())
    run = life.reveal()
    life.apply(run)
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    method = life.json(f"/api/v1/submissions/{own}", "alpha")["method"]
    assert method not in [entry["method"] for entry in life.board()["entries"]]
    back, revealed = life.json("/api/v1/notifications", "alpha")
    assert revealed["title"].endswith("now stands under the private part of split parted")
    assert back["title"].endswith("stands again under the public part of split parted")
    assert [entry["method"] for entry in (*back["entries"], *revealed["entries"])] == [method] * 2


def test_after_a_rollback_the_late_view_is_there_again_and_takes_no_more(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60), policy={"late_entries": "own_view"})
    life.submit("alpha", PUBLIC_ONLY)
    life.work()
    life.move(closes_at=life.now())
    late = life.submit("gamma", CAREFUL)
    life.work()
    path = "/api/v1/leaderboard?phase=test&view=late"
    before = life.json(path)
    run = life.reveal()
    life.apply(run)
    assert life.get(path).status_code == 404
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    life.work()
    after = life.json(path)
    assert late in [entry["submission_id"] for entry in after["entries"]]
    assert (after["part"], after["entries"]) == ("public", before["entries"])
    assert life.upload("gamma", PUBLIC_ONLY, "Once more").status_code == 403


def test_nobody_picks_after_the_reveal(life: "Life") -> None:
    """Not by withdrawing, nor by publishing; and the private score of no other entry is shown."""
    policy = {"entries_shown": "chosen", "entries_private": True, "late_entries": "own_view"}
    life.make_phase(closes_at=life.ahead(60), policy=policy)
    older = life.submit("alpha", PRIVATE_ONLY, "Older")
    chosen = life.submit("alpha", PUBLIC_ONLY, "Chosen")
    other = life.submit("beta", CAREFUL)
    life.work()
    for who, each in (("alpha", older), ("alpha", chosen), ("beta", other)):
        life.request("POST", f"/api/v1/submissions/{each}/publish?replace=true", who)
    life.request("POST", f"/api/v1/submissions/{chosen}/choose", "alpha")
    secret = life.submit("beta", PUBLIC_ONLY, "Kept private")
    life.work()
    beta, pages = visitor(life, "beta"), ("/my", f"/submissions/{secret}")
    assert all("Publish it" in beta.get(page).text for page in pages)
    life.move(closes_at=life.now())
    late = life.submit("gamma", CAREFUL)
    life.work()
    assert life.json(f"/api/v1/submissions/{late}", "gamma")["sheet"]["n"] == 2
    assert not any("Publish it" in beta.get(page).text for page in pages)
    life.apply(life.reveal())
    assert not any("Publish it" in beta.get(page).text for page in pages)
    why = life.json(f"/api/v1/submissions/{secret}", "beta")["unranked_because"]
    assert why == "it was private when hidden scores were revealed, and stays so"
    assert set(life.entry_ids()) == {chosen, other}
    sheets = {
        each: life.json(f"/api/v1/submissions/{each}", who)["sheet"]
        for who, each in (("alpha", older), ("alpha", chosen), ("beta", secret), ("gamma", late))
    }
    assert [each for each, sheet in sheets.items() if sheet is not None] == [chosen]
    assert sheets[chosen]["n"] == 3
    assert life.get(f"/api/v1/submissions/{older}/receipt", "alpha").status_code == 404
    for action, each in (("publish", secret), ("unpublish", other)):
        refusal = life.request("POST", f"/api/v1/submissions/{each}/{action}", "beta")
        assert (refusal.status_code, refusal.json()["code"]) == (409, "conflict")
    life.request("POST", f"/api/v1/submissions/{chosen}/withdraw", "alpha")
    life.work()
    assert set(life.entry_ids()) == {other}, "the older entry does not take its place"
    assert life.get("/api/v1/leaderboard?phase=test&view=late").status_code == 404
    again = life.upload("gamma", PUBLIC_ONLY, "Once more")
    assert (again.status_code, again.json()["code"]) == (403, "phase_closed")


def test_before_and_after_the_reveal_an_effect_is_told_where_both_files_are_entries(
    life: "Life",
) -> None:
    """The score of an entry and what its reminder changed there give the score of the other file."""
    life.make_phase(challenge="strategy", closes_at=life.ahead(60))

    def send(who: str, strategies: str, method: str, linked_to: str = "") -> str:
        content = strategy_file(dict(zip("abcde", strategies, strict=True)), "parted")
        answer = life.request(
            "POST",
            "/api/v1/submissions",
            who,
            data={"phase": "test", "method": method, "linked_to": linked_to},
            files={"file": (f"{who}.json", content)},
        )
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    replaced = send("alpha", "ABABA", "Agent")
    send("alpha", "CCCCC", "Agent", replaced)
    entry = send("beta", "BABAB", "Agent")
    send("beta", "CCCCA", "Agent + reminder", entry)
    life.work()

    def without() -> set[str]:
        effects = [each.get("reminder_effect") for each in life.board()["entries"]]
        return {each["without"] for each in effects if each}

    assert without() == {entry}
    life.move(closes_at=life.now())
    run = life.reveal()
    life.apply(run)
    assert without() == {entry}
    life.done(f"/rescoring/{run}/rollback")
    life.work()
    assert without() == {entry}


def test_the_whole_may_be_revealed_instead_and_a_split_without_parts_has_nothing(
    life: "Life",
) -> None:
    life.make_phase(policy={"revealed_part": "whole"})
    life.make_phase("plain", split="plain")
    life.submit("alpha", CAREFUL)
    life.work()
    words = life.refused("/phases/plain/reveal", {"what": "split", "reason": "end"}, 409)
    assert "has no parts" in words
    run = life.reveal()
    life.move(closes_at=life.now())
    life.apply(run)
    assert life.board()["n_samples"] == 5
    assert "part" not in life.board()
    again = life.refused("/phases/test/reveal", {"what": "split", "reason": "end"}, 409)
    assert "already" in again


@pytest.mark.parametrize(
    ("parts", "words"),
    [(("public", None), "samples of no part"), (("public", "public"), "all samples are public")],
)
def test_parts_must_be_complete(
    make_split: Callable[..., Split], parts: tuple[Any, ...], words: str
) -> None:
    samples = {key: ("SE1", 10.0, part) for key, part in zip("ab", parts, strict=True)}
    with pytest.raises(SplitRefusedError, match=words):
        load_split(make_split(samples, "odd"), packaged_protocol())


@pytest.mark.publishes_regions
def test_of_a_published_split_both_parts_are_public_and_nothing_says_that_they_are_withheld(
    life: "Life",
) -> None:
    life.make_phase()
    submission = life.submit("alpha", CAREFUL)
    life.work()
    withheld = "The hazard regions are withheld."
    assert withheld in life.get("/?phase=test").text
    assert "where its hazard lies" in life.get(f"/entries/{submission}").text
    context = life.context
    publish_split_file(
        life.database, context.files, context.splits, "parted", packaged_protocol(), while_open=True
    )
    life.submit("beta", PUBLIC_ONLY)
    life.work()
    assert life.json("/api/v1/phases/test")["split_is_public"]
    assert life.get("/api/v1/splits/parted").status_code == 200
    assert withheld not in life.get("/?phase=test").text
    assert "where its hazard lies" not in life.get(f"/entries/{submission}").text
    for part, counted in (("public", {"b", "d"}), ("private", {"a", "c", "e"})):
        with life.database.read() as session:
            key = (submission, find_protocol(session, "1.0").digest, life.revisions()[part])
            drawn = entry_drawings(session, *key)
        assert drawn is not None
        assert {each.drawing.sample_id for each in drawn.samples} == counted
        if part == "public":
            run = life.reveal()
            life.move(closes_at=life.now())
            life.apply(run)


def test_what_comes_within_a_later_deadline_that_a_reveal_ended_is_late(life: "Life") -> None:
    policy = {"frozen_scores": "hidden", "late_entries": "own_view"}
    life.make_phase(split="plain", closes_at=life.ahead(60), policy=policy)
    life.submit("beta", 9.0, "M", "plain")
    life.done("/phases/test/freeze")
    life.work()
    life.move(closes_at=life.now())
    grant = {"closes_at": life.ahead(60), "reason": "ill"}
    life.done("/teams/beta/allowances/test", grant, "PATCH")
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    after = life.submit("beta", 1.0, "M", "plain")
    life.work()
    assert life.json(f"/api/v1/submissions/{after}", "beta")["is_late"]
    assert after not in life.entry_ids()
    assert after in life.entry_ids("&view=late")


@pytest.mark.parametrize("action", ["unpublish", "withdraw"])
def test_a_reveal_shows_no_entry_that_its_team_took_back_before_it(
    life: "Life", action: str
) -> None:
    """Workers may have built no board since: what one shows once, it shows for ever."""
    policy = {"frozen_scores": "hidden", "entries_private": True}
    life.make_phase(split="plain", closes_at=life.ahead(60), policy=policy)
    life.work()
    life.done("/phases/test/freeze")
    own = life.submit("beta", 1.0, "M", "plain")
    life.work()
    assert life.request("POST", f"/api/v1/submissions/{own}/publish", "beta").status_code == 200
    life.work()
    assert life.request("POST", f"/api/v1/submissions/{own}/{action}", "beta").status_code == 200
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    assert life.entry_ids() == []
    life.work()
    boards = [line["address"] for line in life.json("/api/v1/boards?phase=test")]
    assert all(own not in life.get(address).text for address in boards)
