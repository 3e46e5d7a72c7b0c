"""What the lists look like in terminals of 80, 100 and 160 columns, as kept in `terminal/`.

`python -m tests.client.test_terminal_widths` writes the texts anew, to be looked at.
"""

import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console, RenderableType
from tests.support.documents import make_sheet

from exceptiondrive.cli.board_commands import phases_table
from exceptiondrive.cli.fitted_table import Column, FittedTable
from exceptiondrive.cli.tables import (
    board_view,
    queue_text,
    quota_table,
    records_table,
    submission_view,
    submissions_left,
    submissions_view,
)
from exceptiondrive_schemas.api.phase_settings import PhaseNow
from exceptiondrive_schemas.api.submission import (
    PhaseView,
    QueuePlace,
    Quota,
    SubmissionStatus,
    SubmissionView,
)
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.score_sheet import BreakdownRow, Flag, ProtocolRef
from exceptiondrive_schemas.split import SplitRef

TEXTS = Path(__file__).with_name("terminal")
WIDTHS = (80, 100, 160)
NOW = datetime(2026, 11, 22, 8, 58, 31, 123456, tzinfo=UTC)
SHIPPED = packaged_protocol()
PROTOCOL = ProtocolRef(version=SHIPPED.version, digest=SHIPPED.digest)
SPLIT = SplitRef(name="nuscenes-real", revision="sha256:5")

METHODS: tuple[tuple[str, str, float, float, tuple[str, ...]], ...] = (
    ("DriveVLM-Dual, risk aware decoding, 8 samples", "Vehicle Intelligence Lab Graz",
     0.7412, 0.1833, ()),
    ("gemini-2.5-pro-preview-06-05", "Foundation Models for Driving", 0.5548, 0.3912,
     ("blind_to_the_edit",)),
    ("Bypass Planner", "ExceptionDrive baselines", 0.3356, 0.4007, ()),
    ("Creep ahead", "my-team", 0.3232, 0.4569, ("hardly_moves", "impossible_motion")),
    ("谨慎的规划器", "清华大学车辆学院", 0.3135, 0.6021, ()),
)  # fmt: skip


def row(hcc: float, ur: float) -> dict[str, float | None]:
    return {"hcc": hcc, "ur": ur, "hpr": 0.19634, "cts": 2.99, "cts_x": 12.938, "cts_y": 0.33}


def entry(number: int, **changes: Any) -> BoardEntry:
    method, team, hcc, ur, flags = METHODS[number]
    known: dict[str, Any] = {
        "source": "scored",
        "rank": number + 1,
        "rank_interval": (max(1, number), number + 2),
        "unranked_because": None,
        "submission_id": f"2mjvnt33drhnasw{number}",
        "method": method,
        "team": team,
        "description": "",
        "submitted_at": NOW,
        "metrics": row(hcc, ur),
        "micro": row(hcc, ur),
        "macro_family": row(hcc, ur),
        "intervals": {},
        "families": {},
        "flags": tuple(Flag(code=code, label=FLAGS[code].label, detail="") for code in flags),
    }
    return BoardEntry(**{**known, **changes})


def board() -> Board:
    apart = {"rank": None, "rank_interval": None}
    reference = {"source": "reference", "team": "Reference", **apart}
    reference["unranked_because"] = "a reference, for comparison"
    reported = {"source": "reported", "team": "ExceptionDrive paper", **apart}
    reported["unranked_because"] = "reported in a paper, not scored here"
    entries = [entry(number) for number in range(len(METHODS))]
    entries += [entry(2, method=name, **reference) for name in ("FREEZE", "CONSTANT VELOCITY")]
    entries += [entry(2, method=name, **reported) for name in ("Impromptu VLA", "LightEMMA", "VAD")]
    entries.append(entry(3, method="Creep ahead, late", is_late=True, **apart))
    return Board(
        challenge=PLANNING.id,
        phase="nuscenes-real-2026",
        split=SPLIT,
        protocol=PROTOCOL,
        headline="macro_family",
        board=17,
        published_at=NOW,
        n_samples=3181,
        confidence=0.95,
        families=(),
        entries=tuple(entries),
    )


def submission(number: int, status: str, **changes: Any) -> SubmissionView:
    method, team, hcc, ur, _ = METHODS[number]
    sheet = make_sheet(SHIPPED.digest, row(hcc, ur))
    families = {each.id: BreakdownRow.of(530, row(hcc, ur)) for each in SHIPPED.families}
    is_scored = status == "scored"
    known: dict[str, Any] = {
        "id": f"2mjvnt33drhnasw{number}",
        "phase": "nuscenes-real-2026",
        "challenge": PLANNING.id,
        "team": team,
        "method": method,
        "description": "",
        "links": Links(),
        "file_digest": "d",
        "size_bytes": 1,
        "status": SubmissionStatus(status),
        "received_at": NOW,
        "status_at": NOW,
        "sheet": sheet.model_copy(update={"families": families, "protocol": PROTOCOL})
        if is_scored
        else None,
        "rank": number + 1 if is_scored else None,
    }
    return SubmissionView(**{**known, **changes})


def submissions() -> list[SubmissionView]:
    queue = QueuePlace(position=3, expected_wait_s=12.3, attempts=0, workers_alive=4)
    return [
        submission(0, "scored"),
        submission(1, "scored", rank=None, replaced_by="2mjvnt33drhnasw0"),
        submission(2, "queued", queue=queue),
        submission(3, "rejected"),
        submission(4, "withdrawn", phase="carla"),
    ]


def quota(**changes: Any) -> Quota:
    known = {"per_day": 3, "used_today": 1, "remaining_today": 2, "total": None, "used_total": 1}
    caps = {"rejected_per_day": 30, "rejected_today": 4}
    return Quota(**{**known, **caps, "resets_at": NOW + timedelta(hours=15), **changes})


def phase(phase_id: str, **changes: Any) -> PhaseView:
    known: dict[str, Any] = {
        "id": phase_id,
        "challenge": PLANNING.id,
        "title": "Hidden split of the 2026 challenge",
        "split": "nuscenes-real",
        "split_revision": "sha256:5",
        "split_is_public": False,
        "n_samples": 3181,
        "protocol": SHIPPED.version,
        "protocol_digest": SHIPPED.digest,
        "is_open": True,
        "max_upload_bytes": 1,
        "quota_per_day": 3,
        "quota": quota(),
    }
    return PhaseView(**{**known, **changes})


def shown() -> dict[str, list[RenderableType]]:
    one, *_ = submissions()
    quotas = {
        "nuscenes-real-2026": quota(),
        "carla-pairs-strategy": quota(total=40, concurrent=4, waiting=1),
    }
    phases = (
        phase("nuscenes-real-2026", closes_at=NOW + timedelta(days=40)),
        phase("carla-pairs-strategy", title="Strategy, development", quota=None,
              split="carla-pairs", split_is_public=True),
    )  # fmt: skip
    tokens = [
        {"id": "3f9qk2m1x0ab7cde", "name": "laptop of Anna", "scopes": ["submit", "read:own"],
         "created_at": "2026-11-22T08:58:31.123456Z", "expires_at": None},
    ]  # fmt: skip
    columns = ("id", "name", "scopes", "created_at", "expires_at")
    page = f"https://exceptiondrive.example.org/submissions/{one.id}"
    own = [view.model_copy(update={"team": one.team}) for view in submissions()]
    return {
        "leaderboard": [*board_view(board())],
        "submissions": [*submissions_view(own)],
        "status": [*submission_view(one, page)],
        "quota": [quota_table(quotas)],
        "phases": [phases_table(phases, datetime.now(UTC))],
        "tokens": [records_table(tokens, columns)],
    }


@pytest.mark.parametrize(
    ("opens_in", "closes_in", "is_open", "words"),
    [
        (1, 40, False, "opens "),
        (1, None, False, "opens "),
        (-1, 40, True, "until "),
        (None, None, True, "open"),
        (-40, -1, False, "closed 2"),
        (-40, 1, False, "closed"),
        (-40, None, False, "closed"),
    ],
)
def test_a_phase_that_is_ahead_is_told_by_its_opening(
    opens_in: int | None, closes_in: int | None, is_open: bool, words: str
) -> None:
    """One that is archived takes no files before its deadline."""
    opens_at, closes_at = (
        None if days is None else datetime.now(UTC) + timedelta(days=days)
        for days in (opens_in, closes_in)
    )
    dates = {"opens_at": opens_at, "closes_at": closes_at, "is_open": is_open}
    told = phases_table((phase("dev", **dates),), datetime.now(UTC)).rows[0][0][-2].plain
    assert told.startswith(words) if words.endswith((" ", "2")) else told == words


def test_the_samples_of_a_phase_are_those_that_its_board_counts() -> None:
    now = PhaseNow(part="public", n_counted=150, is_anonymous=False, takes_late_entries=False)
    told = phases_table((phase("dev", n_samples=300, now=now),), NOW).rows[0][0]
    assert "150" in [cell.plain for cell in told]


def test_a_phase_is_open_to_a_team_until_its_own_deadline() -> None:
    closed, own = NOW - timedelta(days=1), NOW + timedelta(days=2)
    for is_open, words in ((True, f"until {own:%Y-%m-%d}"), (False, f"closed {closed:%Y-%m-%d}")):
        view = phase("dev", closes_at=closed, quota=quota(closes_at=own), is_open=is_open)
        assert phases_table((view,), NOW).rows[0][0][-2].plain.startswith(words)


def test_whether_a_phase_is_ahead_follows_the_clock_of_the_server() -> None:
    now = datetime.now(UTC)
    dates = {"opens_at": now - timedelta(days=1), "closes_at": now + timedelta(days=1)}
    view = phase("dev", **dates, is_open=False)
    told = phases_table((view,), now - timedelta(days=2)).rows[0][0]
    assert told[-2].plain.startswith("opens ")


def text_of(parts: list[RenderableType], width: int) -> str:
    console = Console(width=width, color_system=None, highlight=False, markup=False, emoji=False)
    with console.capture() as captured:
        for part in parts:
            console.print(part)
    return "".join(f"{line.rstrip()}\n" for line in captured.get().splitlines())


IDS = {
    "leaderboard": (),
    "submissions": tuple(view.id for view in submissions()),
    "status": ("2mjvnt33drhnasw0",),
    "quota": ("nuscenes-real-2026", "carla-pairs-strategy"),
    "phases": ("nuscenes-real-2026", "carla-pairs-strategy"),
    "tokens": ("3f9qk2m1x0ab7cde",),
}
"""What somebody copies out of a terminal."""


def test_the_average_that_ranks_is_shown() -> None:
    one, *_ = submissions()
    assert one.sheet is not None
    own_protocol = ProtocolRef(version="1.0-own", digest="sha256:0")
    sheet = one.sheet.model_copy(update={"micro": row(0.66, 0.1), "protocol": own_protocol})
    for headline, hcc, words in (
        ("micro", "66.00", "mean of samples"),
        ("macro_family", "74.12", "mean of families"),
    ):
        view = one.model_copy(update={"sheet": sheet, "headline": headline})
        assert hcc in text_of([*submissions_view([view])], 160)
        status = text_of([*submission_view(view, "page")], 160)
        first = next(line for line in status.splitlines() if "mean of" in line)
        assert words in first
        assert hcc in first


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", sorted(shown()))
def test_it_looks_as_it_was_looked_at(name: str, width: int) -> None:
    text = text_of(shown()[name], width)
    assert text == (TEXTS / f"{name}.{width}.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize("width", [40, 60, 79, 80, 81, 100, 132, 160, 200])
@pytest.mark.parametrize("name", sorted(IDS))
def test_no_line_is_wider_than_the_terminal_and_ids_stay_whole(name: str, width: int) -> None:
    text = text_of(shown()[name], width)
    longest = max(text.splitlines(), key=cell_len)
    assert cell_len(longest) <= width or longest.startswith("https://")
    assert [each for each in IDS[name] if each not in text] == []


def test_what_is_left_out_is_named_and_the_least_important_leaves_first() -> None:
    table = FittedTable.of(
        Column("id", "id"),
        Column("never mind", left_out=2),
        Column("nice", left_out=1),
        Column("empty", left_out=1),
    )
    table.add_row("0123456789abcdef", "aaaaaaaaaaaaaaaa", "bbbbbbbbbbbbbbbb", "")
    assert text_of([table], 60).splitlines()[0].split() == ["id", "never", "mind", "nice"]
    narrow = text_of([table], 40).splitlines()
    assert narrow == [
        "id                nice",
        "0123456789abcdef  bbbbbbbbbbbbbbbb",
        "wider, or with --json: never mind",
    ]
    assert text_of([table], 15).splitlines()[0] == "id:"


def test_in_a_terminal_too_narrow_for_any_table_a_row_is_a_few_lines() -> None:
    table = FittedTable.of("", Column("a number", "number"))
    table.add_row("mean of families", "1.00")
    table.add_gap()
    table.add_row("Lane Blockage", "2.00")
    assert text_of([table], 20).splitlines() == [
        "mean of families",
        "a number: 1.00",
        "",
        "Lane Blockage",
        "a number: 2.00",
    ]


def test_a_row_has_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        FittedTable.of("a", "b").add_row("x")


if __name__ == "__main__":
    TEXTS.mkdir(exist_ok=True)
    for name, parts in shown().items():
        for width in WIDTHS:
            path = TEXTS / f"{name}.{width}.txt"
            path.write_text(text_of(parts, width), encoding="utf-8")


def test_of_a_private_entry_it_is_said_what_can_be_done_now() -> None:
    one = submissions()[0].model_copy(update={"is_published": False, "rank": None})
    why = "it was private when hidden scores were revealed, and stays so"
    later = one.model_copy(update={"unranked_because": why})
    before, after = (text_of([*submission_view(each, "page")], 200) for each in (one, later))
    assert f"it is private: exceptiondrive publish {one.id} shows it" in before
    assert (f": {why}\n" in after, "publish" in after) == (True, False)


def test_what_is_left_is_told_by_the_limit_that_binds() -> None:
    """A phase with 20 in all has no 30 left because a day allows 30, and no midnight brings more."""
    of_the_day = "2 of 3 submissions left today; the count resets at "
    assert submissions_left(quota()).startswith(of_the_day)
    assert not submissions_left(quota()).endswith("in all")
    enough, little = quota(total=20), quota(per_day=30, used_total=18, remaining_today=2, total=20)
    assert submissions_left(enough).startswith(of_the_day)
    assert submissions_left(enough).endswith("; 19 of 20 left in all")
    assert submissions_left(little) == "2 of 20 submissions left in all"
    told = [each.left_words() for each in (quota(), enough, little)]
    assert told == ["2 of 3 today", "2 of 3 today", "2 of 20 in all"]


def test_limits_that_were_lowered_after_use_leave_nothing_and_never_less() -> None:
    changes: Any = {
        "per_day": 1,
        "used_today": 2,
        "remaining_today": 0,
        "total": 1,
        "used_total": 2,
    }
    lowered = quota(**changes, rejected_per_day=3, concurrent=1, waiting=2)
    printed = text_of([quota_table({"dev": lowered})], 160)
    assert re.findall(r"\S+ of \d+", printed) == ["0 of 1", "0 of 1", "0 of 3", "0 of 1"]


HELD_UNTIL = datetime(2026, 11, 26, 14, 4, 10, tzinfo=UTC)


@pytest.mark.parametrize(
    ("queue", "text"),
    [
        ({"position": 3}, "3 ahead, about 12 s"),
        ({"position": 0, "attempts": 1}, "next, about 12 s, attempt 2"),
        ({"workers_alive": 0}, "next, no worker can score it now: it waits until one can"),
        (
            {"attempts": 1, "lease_until": HELD_UNTIL},
            "again from 14:04:10 UTC if its worker is lost",
        ),
        (
            {"attempts": 2, "lease_until": HELD_UNTIL},
            "attempt 2, again from 14:04:10 UTC if its worker is lost",
        ),
    ],
    ids=["waits", "again", "nobody", "in work", "in work again"],
)
def test_a_file_that_waits_says_for_how_long_and_one_in_work_until_when(
    queue: dict[str, Any], text: str
) -> None:
    usual = {"position": 0, "expected_wait_s": 12.3, "attempts": 0, "workers_alive": 4}
    assert queue_text(QueuePlace(**(usual | queue))) == text


def test_a_score_that_is_kept_back_is_not_called_unranked() -> None:
    one = submission(0, "scored", sheet=None, rank=None, score_kept_back_since=NOW)
    said = " ".join(str(part) for part in submission_view(one, "http://server/x"))
    assert "not ranked" not in said
    assert f"kept back in phase {one.phase}: its board is frozen since" in said


def test_a_late_entry_is_told_why_it_takes_no_rank() -> None:
    one = submission(0, "scored", rank=None, is_late=True)
    said = " ".join(str(part) for part in submission_view(one, "http://server/x"))
    assert "came after the deadline, so it holds no rank" in said


def test_no_rank_is_awaited_that_the_file_will_not_get() -> None:
    coming = submission(0, "scored", rank=None, awaits_board=True)
    assert "rank awaited" in " ".join(map(str, submission_view(coming, "http://server/x")))
    because = "66.96% of the samples are answered; a rank needs 99%"
    report = CheckReport(
        challenge=None,
        split=None,
        n_predictions=1,
        digest="d",
        size_bytes=1,
        unranked_because=because,
    )
    told = submission(0, "scored", rank=None, awaits_board=True, report=report)
    assert f"not ranked in phase {told.phase}: {because}" in " ".join(
        map(str, submission_view(told, "http://server/x"))
    )


def test_a_replaced_run_that_the_board_still_shows_has_its_rank() -> None:
    """A frozen board shows it, and so does one that is being built."""
    shown = submission(0, "scored", rank=2, replaced_by="2mjvnt33drhnasw9")
    assert "rank 2 in phase" in " ".join(map(str, submission_view(shown, "http://server/x")))
    gone = submission(0, "scored", rank=None, replaced_by="2mjvnt33drhnasw9")
    assert "not on the board" in " ".join(map(str, submission_view(gone, "http://server/x")))


def test_what_was_confirmed_is_not_listed_as_withdrawn() -> None:
    asked = submission(1, "withdrawn", confirmed_as="2mjvnt33drhnasw0")
    text = text_of([*submissions_view([asked])], 160)
    assert f"{asked.id} was confirmed or sent again as 2mjvnt33drhnasw0" in text
    assert "withdrawn" not in text


def test_a_phase_that_takes_nothing_more_has_nothing_left() -> None:
    over = {"closes_at": datetime.now(UTC) - timedelta(days=1), "is_open": False}
    archived = {"visibility": "archived", "is_open": False}
    ahead = {"opens_at": datetime.now(UTC) + timedelta(days=1), "is_open": False}
    phases = phase("a", **over), phase("b", **archived), phase("d", **ahead), phase("c")
    table = phases_table(phases, datetime.now(UTC))
    said = [tuple(cell.plain for cell in row[-2:]) for row, *_ in table.rows]
    assert [(when.split()[0], left) for when, left in said[:2]] == [
        ("closed", "nothing"),
        ("archived", "nothing"),
    ]
    assert said[2][1] == f"then {phases[2].quota_per_day} a day"
    assert said[3][1].endswith(" today")
