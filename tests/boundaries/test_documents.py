"""What the repository says about itself is in it: documents, their sections, their tables."""

import re
import subprocess
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import tomllib
from tests.chaos.suite import FAULTS
from tests.hostile.rows import ROWS
from typer.main import get_command

from exceptiondrive import transport
from exceptiondrive.cli import app as client
from exceptiondrive_build.cli import app as build
from exceptiondrive_records.accounts import people, sessions
from exceptiondrive_records.entries import selection
from exceptiondrive_records.news import questions
from exceptiondrive_records.notifications import channels, contacts, events
from exceptiondrive_records.teams import teams
from exceptiondrive_records.work import heartbeats, jobs
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_server.accounts import oidc
from exceptiondrive_server.operations.cli import app as server
from exceptiondrive_worker.operator_cli import app as worker

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
OF_READERS = {
    "evaluate.py",
    "config.toml",
    "exceptiondrive/config.toml",
    "floors.toml",
    "my_planner.py",
    "secrets/broker.conf",
}
NAME = re.compile(r"`([a-z_]\w*_\w*(?:\.\w+)*)`", re.IGNORECASE)
OF_OTHERS = {"final_traj", "lidar2ego", "map_pointcloud_to_image", "pid_metadata", "view_points"}
"""Names of other people's code that ours reads or is compared with."""
LINK = re.compile(r"\]\(([^)\s#:]*)(?:#([\w-]+))?\)")
FENCED, SPAN = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL), re.compile(r"`([^`]+)`")
CALL = re.compile(
    r"(?<!--entrypoint )\bexceptiondrive(-server|-worker|-build|) (?!exceptiondrive)([a-z][^|#;&\n]*)"
)
PROGRAMS = {"": client, "-server": server, "-worker": worker, "-build": build}


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


def test_nobody_is_told_to_install_what_an_index_has_under_the_name(texts: dict[str, str]) -> None:
    bare = re.compile(
        r"(?:pip install|uvx|pipx run|client:)(?: --?quiet)? [\\'\"]*exceptiondrive"
        r"(?!-|\.|(?:\[[\w,]+\])? @)"
    )
    told = [
        name
        for name, text in texts.items()
        if name.endswith((".md", ".yml", ".ipynb"))
        for _ in bare.findall(text)
    ]
    assert told == ["docs/client.md"], "which warns of it"


@pytest.mark.parametrize(
    ("name", "promise"),
    [
        ("README.md", "every fault at once, before"),
        ("client/README.md", "every fault at once; offline"),
        ("docs/client.md", "says every fault, counted"),
        ("docs/errors.md", "and the server run the same checker"),
        ("docs/submission-format.md", "says everything that is wrong"),
        ("server/exceptiondrive_server/web/problem_vocabulary.py", 'finds " "the same faults'),
    ],
)
def test_a_check_that_promises_every_fault_knows_the_samples(
    texts: dict[str, str], name: str, promise: str
) -> None:
    text = " ".join(texts[name].split())
    command = text[: text.index(promise)].rpartition("check ")[2]
    assert "--phase" in command, "without phase or manifest unknown and missing samples pass"


def test_who_hears_that_the_same_bytes_are_free_hears_when_they_are_not(
    texts: dict[str, str],
) -> None:
    """A withdrawn submission is not given back: its bytes are a new one (tests/records)."""
    said = re.compile(r"same (?:bytes|file) (?:sent )?again (?:give|return|costs?)\b[^.]*")
    found = [
        sentence
        for name, text in texts.items()
        if not name.startswith("tests/")
        for sentence in said.findall(" ".join(text.split()))
    ]
    assert len(found) >= 7
    assert [sentence for sentence in found if "withdrawn" not in sentence] == []


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


def test_every_name_that_a_module_speaks_of_is_there(texts: dict[str, str]) -> None:
    """What is renamed is renamed in sentences, too: names with an underline, which no word has."""
    modules = {name: text for name, text in texts.items() if name.endswith(".py")}
    code = " ".join(NAME.sub("", text) for name, text in texts.items() if name[-3:] != ".md")
    known = OF_OTHERS.union(re.findall(r"\w+", code), (Path(name).stem for name in texts))
    named = {(name, each) for name, text in modules.items() for each in NAME.findall(text)}
    assert len(named) > 200
    assert {(name, each) for name, each in named if not known.issuperset(each.split("."))} == set()


def test_links_between_documents_lead_somewhere(texts: dict[str, str]) -> None:
    broken = set()
    for name, text in texts.items():
        for target, section in LINK.findall(SPAN.sub("", FENCED.sub("", text))):
            path = (ROOT / name).parent / target if target else ROOT / name
            is_there = path.exists() and (
                not section or section in sections(path.read_text("utf-8"))
            )
            if name.endswith(".md") and not is_there:
                broken.add((name, target, section))
    assert broken == set()


def sections(text: str) -> set[str]:
    """The anchors of the headings of a document, as they are made by who shows it."""
    headings = re.findall(r"^#+ (.+)$", FENCED.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in headings}


def test_every_command_and_option_that_a_document_names_is_there(texts: dict[str, str]) -> None:
    calls = [
        (name, program, call.split())
        for name, text in texts.items()
        if name.endswith(".md")
        for code in (
            *(block for language, block in FENCED.findall(text) if language == "sh"),
            *(" ".join(span.split()) for span in SPAN.findall(FENCED.sub("", text))),
            *re.findall(r"^ {4}(exceptiondrive.*)$", text, re.MULTILINE),
        )
        for program, call in CALL.findall(code.replace("\\\n", " "))
    ]
    assert len(calls) > 200
    assert [call for call in calls if not is_known(*call[1:])] == []


def is_known(program: str, words: list[str]) -> bool:
    """Whether these words begin with a command and have none but its options."""
    command: Any = get_command(PROGRAMS[program])
    while words and (inner := getattr(command, "get_command", lambda *_: None)(None, words[0])):
        command, words = inner, words[1:]
    is_group = hasattr(command, "get_command")
    options = {option for each in command.params for option in each.opts + each.secondary_opts}
    given = {option for each in words for option in re.findall(r"^\[?(--?[a-z][a-z-]*)", each)}
    return given <= options | {"--help"} and not (is_group and words and not given)


def test_the_commands_that_ask_are_named(texts: dict[str, str]) -> None:
    program: Any = get_command(client)
    organizer = program.get_command(None, "organizer")
    commands = {name: organizer.get_command(None, name) for name in organizer.list_commands(None)}
    for group in [name for name, command in commands.items() if hasattr(command, "commands")]:
        inner = commands.pop(group).commands
        commands |= {f"{group} {name}": command for name, command in inner.items()}
    asking = {
        name
        for name, command in commands.items()
        if any("--yes" in one.opts for one in command.params)
    }
    assert asking == {"teams merge", "teams forget", "people forget", "message", "phases reveal"}
    for name in ("CHANGELOG.md", "docs/client.md", "docs/organizing.md"):
        said = re.search(r"`teams merge`, .*?`--yes`", " ".join(texts[name].split()))
        assert said is not None
        assert set(SPAN.findall(said[0])) == asking | {"--yes"}, name


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
        assert folders - others == {row[0] for row in nouns if row[column] == "yes"}


def test_the_nouns_of_the_records_stand_as_the_architecture_says() -> None:
    text = (DOCS / "architecture.md").read_text("utf-8")
    (line,) = re.findall(r"^The nouns of the records form layers.*: (.+)\.$", text, re.MULTILINE)
    said = [re.findall(r"`(\w+)`", floor) for floor in line.split(" < ")]
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    (layers,) = (
        each["layers"]
        for each in contracts["contracts"]
        if each.get("containers") == ["exceptiondrive_records"]
    )
    assert said == [layer.split(" | ") for layer in reversed(layers)]


def test_documents_of_the_api_lie_where_the_architecture_says(texts: dict[str, str]) -> None:
    code = {name: text for name, text in texts.items() if name.endswith(".py")}
    shared = [
        Path(name).stem
        for name, text in code.items()
        if name.startswith("schemas/exceptiondrive_schemas/api/") and "(Document):" in text
    ]
    beside_the_server = "".join(
        text
        for name, text in code.items()
        if name.startswith(("client/", "worker/", "server/exceptiondrive_records/"))
    )
    assert "submission" in shared
    assert [
        name for name in shared if f"exceptiondrive_schemas.api.{name} " not in beside_the_server
    ] == []
    bodies = {
        name
        for name, text in code.items()
        if name.startswith("server/")
        and re.search(r"^class \w+\((Form|Action)\):", text, re.MULTILINE)
    }
    assert {Path(name).name for name in bodies - {"server/exceptiondrive_server/web/forms.py"}} == {
        "api.py",
        "organizer_api.py",
    }


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


@pytest.mark.parametrize(
    ("document", "words", "limit", "value"),
    [
        ("access", "opens a session of twelve hours", sessions.LIFETIME, timedelta(hours=12)),
        ("access", "once, within seven days", people.INVITATION_LIFETIME, timedelta(days=7)),
        ("access", "ends within ten minutes", oidc.FLOW_S, 600),
        ("access", "signs in 200 times in 24 hours at most", sessions.MAX_SIGN_INS_A_DAY, 200),
        ("access", "nobody looked at for three days", teams.PLACE_LASTS, timedelta(days=3)),
        ("client", "longer than 30 s the command ends", transport.LONGEST_RETRY_AFTER_S, 30),
        ("client", "*Confirm it*, for 24 hours", jobs.CONFIRM_WITHIN, timedelta(hours=24)),
        ("operating", "silent for two minutes has no line", heartbeats.MISSED_FOR_S, 120),
        ("operating", "one above 15 s: see *lost worker*", heartbeats.HEARTBEAT_TTL_S, 15),
        ("phases", "At most five questions of a team", questions.MAX_OPEN, 5),
        ("phases", "50 times in 24 hours at most", selection.MAX_CHOICES_A_DAY, 50),
        ("rescoring", "may add up to five addresses", contacts.MAX_CONTACTS, 5),
        ("rescoring", "can change at most 50 times in 24 hours", contacts.MAX_CHANGED_A_DAY, 50),
        ("rescoring", "ends within a day", events._ENDS_SOON, timedelta(days=1)),
        ("rescoring", "most once an hour and phase", events._PASSED_WITHIN, timedelta(hours=1)),
        ("rescoring", "redirects not followed), for 20 s", channels._LONGEST_S, 20),
        ("trust", "three a day at most to one mailbox", contacts.MAX_ASKED_A_DAY, 3),
        ("trust", "two of them of one team", contacts.MAX_ASKED_BY_ONE, 2),
    ],
)
def test_a_limit_is_what_a_document_says(
    document: str, words: str, limit: object, value: object
) -> None:
    assert words in " ".join((DOCS / f"{document}.md").read_text("utf-8").split())
    assert limit == value
