import subprocess
import sys
from pathlib import Path

import pytest

from exceptiondrive_agent.errors import AgentError
from exceptiondrive_agent.journal import Journal, JournalHeader, JournalLine, read_journal
from exceptiondrive_endpoints.errors import Reason

HEADER = JournalHeader(
    question="decide", model="m", settings={"--views": "sha256:1", "--temperature": "sha256:2"}
)
HOLDER = """
import sys, time
from pathlib import Path
from exceptiondrive_agent.journal import Journal, JournalHeader
header = JournalHeader(question="decide", model="m", settings={"--views": "sha256:1", "--temperature": "sha256:2"})
with Journal(Path(sys.argv[1]), header):
    print("held", flush=True)
    time.sleep(60)
"""


def test_lines_come_back_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "new" / "j.jsonl"
    line = JournalLine(sample_id="s1", reason=Reason.NOT_JSON, detail="no", raw="hm\n\u2028")
    with Journal(path, HEADER) as journal:
        journal.append(line)
    assert read_journal(path) == (HEADER, (line,))


def test_reopening_appends_and_never_rewrites(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, HEADER) as journal:
        journal.append(JournalLine(sample_id="s1"))
    before = path.read_bytes()
    with Journal(path, HEADER) as journal:
        journal.append(JournalLine(sample_id="s2"))
        assert [line.sample_id for line in journal.lines] == ["s1", "s2"]
    assert path.read_bytes().startswith(before)


@pytest.mark.parametrize("cut", [1, 2, 20])
def test_a_torn_last_line_is_as_good_as_not_asked(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, HEADER) as journal:
        journal.append(JournalLine(sample_id="s1"))
        journal.append(JournalLine(sample_id="s2"))
    path.write_bytes(path.read_bytes()[:-cut])
    with Journal(path, HEADER) as journal:
        journal.append(JournalLine(sample_id="s3"))
    known = [line.sample_id for line in read_journal(path)[1]]
    assert known == (["s1", "s2", "s3"] if cut == 1 else ["s1", "s3"])


def test_a_journal_of_other_settings_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    with Journal(path, HEADER):
        pass
    before = path.read_bytes()
    for now, said in (
        ({"model": "other"}, r"with model 'm'\. Ask as it was asked, or name another file\."),
        (
            {"settings": HEADER.settings | {"--views": "?"}},
            r"'m' and other settings: --views\. Ask",
        ),
    ):
        with pytest.raises(AgentError, match=said):
            Journal(path, HEADER.model_copy(update=now))
    assert path.read_bytes() == before


def test_a_file_that_is_no_journal_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("precious")
    with pytest.raises(AgentError, match="not a journal"):
        Journal(path, HEADER)
    assert path.read_text() == "precious"


def test_a_journal_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AgentError, match="directory"):
        Journal(tmp_path, HEADER)


def test_a_journal_in_use_by_another_process_is_refused_and_free_when_that_dies(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.jsonl"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    with holder, holder.stdout:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(AgentError, match="is writing this journal; wait for it or stop it"):
            Journal(path, HEADER)
        holder.kill()
        holder.wait()
    with Journal(path, HEADER) as journal:
        assert journal.lines == []


def test_a_journal_that_could_not_be_opened_is_not_left_locked(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    path.write_text("no journal\n")
    with pytest.raises(AgentError, match="not a journal"):
        Journal(path, HEADER)
    path.unlink()
    with Journal(path, HEADER):
        pass
