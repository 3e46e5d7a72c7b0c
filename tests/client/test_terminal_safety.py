"""What a server sends cannot steer the terminal: the table of `nasty_strings.py` in every view."""

import io
import json
from datetime import datetime

import pytest
from rich.progress import Progress
from tests.server.nasty_strings import ALL, steering_in
from tests.support.documents import make_sheet

from exceptiondrive.cli.output import be_sure, console, say, show, show_json
from exceptiondrive.cli.tables import (
    board_view,
    records_table,
    submission_view,
    submissions_view,
)
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

NOW = datetime(2026, 11, 22, tzinfo=UTC)
ROW: dict[str, float | None] = dict.fromkeys(PLANNING.metric_keys, 0.5)


def entry(text: str) -> BoardEntry:
    return BoardEntry(
        source="scored",
        rank=None,
        rank_interval=None,
        unranked_because=text,
        submission_id="s",
        method=text,
        team=text,
        description=text,
        submitted_at=NOW,
        metrics=ROW,
        micro=ROW,
        macro_family=ROW,
        intervals={},
        families={},
    )


def board() -> Board:
    return Board(
        challenge=PLANNING.id,
        phase="\x1b[2J",
        split=SplitRef(name="\x1b[2J", revision="r"),
        protocol=ProtocolRef(version="\x9b2J", digest="d"),
        headline="macro_family",
        board=1,
        published_at=NOW,
        n_samples=3,
        confidence=0.95,
        families=(),
        entries=tuple(entry(text) for text in ALL.values()),
    )


def submission(text: str) -> SubmissionView:
    return SubmissionView(
        id=text,
        phase=text,
        challenge=PLANNING.id,
        team=text,
        method=text,
        description=text,
        links=Links(),
        file_digest="d",
        size_bytes=1,
        status=SubmissionStatus.SCORED,
        received_at=NOW,
        status_at=NOW,
        sheet=make_sheet("d", ROW),
        unranked_because=text,
    )


def test_tables_and_sentences_hold_nothing_that_steers(capsys: pytest.CaptureFixture[str]) -> None:
    show(*board_view(board()))
    views = [submission(text) for text in ALL.values()]
    show(*submissions_view(views))
    for view in views:
        show(*submission_view(view, f"http://server/{view.id}"))
        say(f"error: {view.method}")
    show(records_table([{"a": text, "b": [text]} for text in ALL.values()], ("a", "b")))
    shown = capsys.readouterr()
    for text in (shown.out, shown.err):
        assert len(text) > 200
        assert steering_in(text) == []
    assert "[bold red]x[/]" in shown.out, "markup of a name was obeyed"


def test_on_a_terminal_only_our_own_colours_are_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.delenv("NO_COLOR", raising=False)
    out = console()
    with out.capture() as captured:
        for part in board_view(board()):
            out.print(part)
        with Progress(console=out) as progress:
            progress.add_task("\x1b]0;title\x07", total=1)
    text = captured.get()
    assert "\x1b[1m" in text, "our own styles are there"
    for theirs in ("\x1b[2J", "\x1b[31m", "\x1b]0;", "\x07", "\x9b"):
        assert theirs not in text


def test_json_is_the_same_document_without_what_steers(capsys: pytest.CaptureFixture[str]) -> None:
    show_json(ALL)
    text = capsys.readouterr().out
    assert json.loads(text) == ALL
    assert steering_in(text) == []


@pytest.mark.parametrize("text", ALL.values(), ids=ALL)
def test_a_question_before_what_nothing_brings_back_hides_none_of_its_words(
    text: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The licence of data and what a server asks to be confirmed stand in it."""
    monkeypatch.setattr("exceptiondrive.cli.output.can_ask", lambda: True)
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    be_sure(f"The licence is {text}.", False, "--accept-licence", question="Accept it?")
    shown = capsys.readouterr()
    asked = shown.out + shown.err
    assert steering_in(asked) == []
    assert "Accept it?" in asked
