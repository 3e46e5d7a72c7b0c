"""What the repository says about itself is in it: documents, their sections, their tables."""

import re
import subprocess
from pathlib import Path

import pytest
from tests.chaos.suite import FAULTS
from tests.hostile.rows import ROWS

from exceptiondrive_schemas.protocol import packaged_protocol

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
OUTSIDE = re.compile(
    r"(?<![\w./])(DESIGN|PROTOCOL|CONSTRUCTION)\.md|reliability\.md|(?<![\w./])research/|walks/"
    r"|\.\./shared(?!/realdata)|\bissue #?\d"
)
"""Documents and folders that a clone does not have; real planner files may be looked for."""
DOCUMENT = re.compile(r"docs/[\w./-]+\.md")
SECTION = re.compile(r"docs/protocol\.md sections? (\d)(?: and (\d))?")
FILE = re.compile(r"`(?:server/\.\.\./)?((?:[\w-]+/)*\w+\.(?:py|toml|html|conf))(?:::\w+)?`")
NO_NOUNS = {"migrations"}
OF_READERS = {
    "evaluate.py",
    "config.toml",
    "exceptiondrive/config.toml",
    "floors.toml",
    "my_planner.py",
    "secrets/broker.conf",
}
LINK = re.compile(r"\]\(([^)\s#:]+)(#[\w-]+)?\)")


def tracked() -> dict[str, str]:
    """Every tracked text file but this one, by its path."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    paths = [ROOT / name for name in listed.stdout.split("\0") if name]
    files = {path: path.read_bytes() for path in paths if path.is_file() and path != Path(__file__)}
    return {
        path.relative_to(ROOT).as_posix(): data.decode()
        for path, data in files.items()
        if b"\0" not in data
    }


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return tracked()


def test_nothing_points_outside_the_repository(texts: dict[str, str]) -> None:
    found = {name: match[0] for name, text in texts.items() if (match := OUTSIDE.search(text))}
    assert found == {}


def test_every_document_that_is_named_is_there(texts: dict[str, str]) -> None:
    named = {
        (name, path)
        for name, text in texts.items()
        if not name.startswith("docs/")
        for path in DOCUMENT.findall(text)
    }
    assert named
    assert {(name, path) for name, path in named if not (ROOT / path).is_file()} == set()


def test_every_section_of_the_protocol_that_is_named_is_there(texts: dict[str, str]) -> None:
    headings = set(
        re.findall(r"^## (\d)\. ", (DOCS / "protocol.md").read_text("utf-8"), re.MULTILINE)
    )
    named = {
        section
        for text in texts.values()
        for sections in SECTION.findall(text)
        for section in sections
        if section
    }
    assert named <= headings == set("123456789")


def test_every_file_that_a_document_names_is_there(texts: dict[str, str]) -> None:
    missing = {
        (name, file)
        for name, text in texts.items()
        if name.endswith(".md")
        for file in FILE.findall(text)
        if file not in OF_READERS and not any(f"/{known}".endswith(f"/{file}") for known in texts)
    }
    assert missing == set()


def test_links_between_documents_lead_somewhere(texts: dict[str, str]) -> None:
    broken = {
        (name, target)
        for name, text in texts.items()
        if name.endswith(".md")
        for target, _ in LINK.findall(re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL))
        if not (ROOT / name).parent.joinpath(target).exists()
    }
    assert broken == set()


def test_every_test_that_a_document_names_is_there() -> None:
    named = {
        (file, name)
        for page in sorted(DOCS.rglob("*.md"))
        for file, names in re.findall(
            r"`(tests/[\w/]+\.py)`((?:,? `[a-z0-9_]+`)+)", page.read_text("utf-8")
        )
        for name in re.findall(r"\w+", names)
    }
    assert len(named) > 50
    missing = [
        (file, name)
        for file, name in sorted(named)
        if f"def test_{name}(" not in (ROOT / file).read_text("utf-8")
    ]
    assert missing == []


def test_the_nouns_of_the_architecture_are_the_folders_of_both_sides() -> None:
    text = (DOCS / "architecture.md").read_text("utf-8")
    nouns = re.findall(r"^\| \*\*(\w+)\*\* \| (yes|no) \| (yes|no) \|", text, re.MULTILINE)
    sides = {"exceptiondrive_records": 1, "exceptiondrive_server": 2}
    for package, column in sides.items():
        others = set(re.findall(rf"`{package}\.(\w+)`", text))
        folders = {path.parent.name for path in (ROOT / "server" / package).glob("*/__init__.py")}
        assert folders - others - NO_NOUNS == {row[0] for row in nouns if row[column] == "yes"}


def test_the_page_of_faults_has_the_faults_and_inputs_that_are_tried() -> None:
    rows = re.findall(r"^\| ([FI]\d\d) \|", (DOCS / "faults.md").read_text("utf-8"), re.MULTILINE)
    assert rows == sorted({fault.id[:3] for fault in FAULTS}) + list(ROWS)


def test_the_taxonomy_of_the_page_is_that_of_the_protocol() -> None:
    rows = re.findall(
        r"^\| ([A-Z]{2}\d) \| (\w+) \| (.+) \| ([PK]) \| ([A-E ]+) \| ([\d.]+) \|$",
        (DOCS / "protocol.md").read_text("utf-8"),
        re.MULTILINE,
    )
    assert [tuple(row) for row in rows] == [
        (
            task.id,
            task.name,
            task.hazard,
            task.region.value[0].upper().replace("C", "K"),
            " ".join(strategy.value for strategy in task.acceptable),
            str(task.d_safe_m),
        )
        for task in packaged_protocol("1.0").tasks
    ]
