"""Edit, history and download from the command line and the SDK, against the real application."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.client.servers import run, submit

from exceptiondrive import Client, InvalidArgumentError, NotFoundError
from exceptiondrive.facts import facts_of, facts_of_pairs
from exceptiondrive_schemas.method_facts import MethodFacts

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]


def ok(done: Any) -> str:
    assert done.exit_code == 0, done.stderr
    return str(done.stdout)


def submitted(working: "Running", path: Path, *more: object, method: str = "Planer") -> str:
    return str(json.loads(ok(submit(working, path, "--json", *more, method=method)))["id"])


def test_facts_travel_with_a_submission_and_are_edited(
    working: "Running", planning_file: MakeFile, tmp_path: Path
) -> None:
    file = tmp_path / "facts.json"
    file.write_text(json.dumps({"type": "vla", "map": "hd", "sensors": ["radar"]}))
    told = ("--facts", file, "--fact", "sensors=lidar, front_camera", "--fact", "type=rule")
    one = submitted(working, planning_file(), *told)
    with Client(working.url, working.token) as client:
        assert client.status(one).facts == MethodFacts(
            type="rule", map="hd", sensors=("front_camera", "lidar")
        )
        assert client.edits(one) == ()
    ok(run(working, "edit", one, "--method", "Planner", "--fact", "map=", "--fact", "hardware=GPU"))
    listed = ok(run(working, "edit", one))
    assert all(word in listed for word in ("Planer", "Planner", "map", "hd", "hardware", "GPU"))
    assert "type" not in listed
    with Client(working.url, working.token) as client:
        seen = client.edit(one, paper="https://example.org/p", facts={"parameters_millions": 7000})
        assert (seen.method, seen.links.paper) == ("Planner", "https://example.org/p")
        assert (seen.facts.map, seen.facts.hardware, seen.facts.parameters_millions) == (
            None,
            "GPU",
            7000,
        )
        assert client.edit(one, paper="").links.paper is None


def test_a_new_name_that_replaces_an_entry_needs_a_yes(
    working: "Running", planning_file: MakeFile
) -> None:
    one = submitted(working, planning_file(), "--wait")
    path = planning_file("two.json")
    path.write_text(path.read_text() + "\n")
    two = submitted(working, path, "--wait", method="Planner")
    asked = run(working, "edit", two, "--method", "Planer")
    assert (asked.exit_code, "add --replace" in asked.stderr) == (2, True)
    assert f"It replaces {one} (HCC " in asked.stderr
    with Client(working.url, working.token) as client:
        assert client.status(two).method == "Planner"
        with pytest.raises(InvalidArgumentError, match="replace=True"):
            client.edit(two, method="Planer")
    ok(run(working, "edit", two, "--method", "Planer", "--replace"))
    with Client(working.url, working.token) as client:
        assert client.status(one).replaced_by == two


def test_the_same_bytes_under_another_name_say_how_to_rename(
    working: "Running", planning_file: MakeFile
) -> None:
    path = planning_file()
    one = submitted(working, path)
    again = submit(working, path, method="Planner")
    assert again.exit_code != 0
    assert f"exceptiondrive edit {one}" in again.stderr
    for said in (
        f"as {one} (Planer): that submission stands",
        f"as '{one}', a run of 'Planer': that",
    ):
        assert said in again.stderr
    assert ok(submit(working, path, method="Planer")).count("no quota was spent") == 1


def test_what_was_sent_is_downloaded_bit_by_bit_and_never_over_a_file(
    working: "Running", planning_file: MakeFile, tmp_path: Path
) -> None:
    path = planning_file()
    one = submitted(working, path)
    target = tmp_path / "again.json"
    ok(run(working, "download", one, "-o", target))
    assert target.read_bytes() == path.read_bytes()
    refused = run(working, "download", one, "-o", target)
    assert refused.exit_code == 2
    assert "again.json is there already; nothing was overwritten." in refused.stderr
    assert "--output FILE" in refused.stderr
    assert target.read_bytes() == path.read_bytes()
    with Client(working.url, working.token) as client, pytest.raises(NotFoundError):
        client.download("nobody")


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ("colour=red", "the keys are type, "),
        ("type", "Write key=value"),
        ("type=magic", "type is end_to_end, modular, vla"),
        ("sensors=lidar,eyes", "sensors is front_camera"),
        ("parameters_millions=many", "is a number, not 'many'"),
        ("parameters_millions=-1", "parameters_millions: "),
        (f"hardware={'x' * 121}", "hardware: "),
    ],
)
def test_a_wrong_fact_is_named_before_anything_is_sent(pair: str, words: str) -> None:
    with pytest.raises(InvalidArgumentError, match=words):
        facts_of_pairs([pair])


def test_a_file_of_facts_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    file = tmp_path / "facts.json"
    for text in ("{", "[1]", '{"type": 3}', "[" * 100_000):
        file.write_text(text)
        with pytest.raises(InvalidArgumentError) as caught:
            facts_of(file)
    assert "nested too deeply" in caught.value.sentence
    with pytest.raises(InvalidArgumentError):
        facts_of(tmp_path / "nowhere.json")


def test_notices_and_contacts_have_their_commands(working: "Running") -> None:
    assert ok(run(working, "notices")) == "no notices\n"
    for command in ("news", "questions"):
        assert ok(run(working, command, "--phase", "dev")) == f"no {command}\n"
    asked = ok(run(working, "ask", "How long?", "--phase", "dev"))
    assert asked == "asked; `exceptiondrive questions --phase dev` shows the answer\n"
    assert "not answered yet" in ok(run(working, "questions", "--phase", "dev"))
    assert "inbox alone" in ok(run(working, "contacts", "list"))
    told = ("--tell", "scored", "--tell", "failed", "--json")
    made = json.loads(ok(run(working, "contacts", "add", "a@example.org", *told)))
    assert (made["is_confirmed"], made["wishes"]) == (False, ["scored", "failed"])
    assert "a@example.org" in ok(run(working, "contacts", "list"))
    assert "told of: phase_ends" in ok(run(working, "contacts", "tell", made["id"], "phase_ends"))
    assert "told of: nothing" in ok(run(working, "contacts", "tell", made["id"], "none"))
    wrong = run(working, "contacts", "tell", made["id"], "everything")
    assert (wrong.exit_code, "is none of updates, scored" in wrong.stderr) == (2, True)
    assert "nothing more" in ok(run(working, "contacts", "remove", made["id"]))
    assert json.loads(ok(run(working, "contacts", "list", "--json"))) == []


def test_an_address_that_no_mail_reaches_is_told_of(working: "Running") -> None:
    from exceptiondrive_records.notifications.channels import NoticeSettings
    from exceptiondrive_records.notifications.outbox import run_outbox

    stop = threading.Event()
    outbox = threading.Thread(
        target=run_outbox,
        args=(working.context.database, NoticeSettings(deliver_every_s=0.1), stop),
    )
    outbox.start()
    told = run(working, "contacts", "add", "b@example.org").stdout
    stop.set()
    outbox.join()
    assert "could not be sent: this server may have no mail server" in told
    listed = ok(run(working, "contacts", "list")).splitlines()
    assert ["last message" in listed[0], "waiting" in listed[1]] == [True, True]
