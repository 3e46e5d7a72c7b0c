"""`receipt get` and `receipt verify`: offline, and a tampered field is named."""

import base64
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.client.servers import submit
from typer.testing import CliRunner

from exceptiondrive import Client
from exceptiondrive.cli import app
from exceptiondrive.errors import InvalidArgumentError, NotFoundError
from exceptiondrive.receipts import (
    ReceiptError,
    keys_path,
    read_keys,
    remember_keys,
    verify_receipt,
)
from exceptiondrive_schemas.receipt import (
    Receipt,
    ReceiptKey,
    ReceiptKeys,
    field_digests,
    key_id_of,
    signed_bytes,
)

if TYPE_CHECKING:
    from tests.client.servers import CannedServer, Running


@pytest.fixture
def receipt(working: "Running", planning_file: Callable[..., Path], tmp_path: Path) -> Path:
    """A receipt fetched by the command, whose server is not needed any more."""
    with Client(working.url, working.token) as client:
        submission = client.submit(planning_file(), phase="dev", method="Planner")
        submission.wait(60)
    path = tmp_path / "receipt.json"
    environment = {"EXCEPTIONDRIVE_SERVER": working.url, "EXCEPTIONDRIVE_TOKEN": working.token}
    for command in (["get", submission.view.id], ["keys"]):
        target = path if command[0] == "get" else tmp_path / "keys.json"
        arguments = ["receipt", *command, "-o", str(target)]
        done = CliRunner().invoke(app, arguments, env=environment)
        assert done.exit_code == 0, done.stderr
    return path


def test_a_reader_gets_the_receipt_of_an_entry_without_a_token(
    working: "Running", receipt: Path
) -> None:
    own = Receipt.model_validate_json(receipt.read_bytes())
    with Client(working.url) as reader:
        page = f"{working.url}/entries/{own.statement.submission_id}"
        assert reader.receipt(page).statement == own.statement
        with pytest.raises(NotFoundError):  # no token would give it
            reader.receipt("none")


def verify(*arguments: object) -> Any:
    """Run the command with a server that does not exist."""
    words = ["receipt", "verify", *map(str, arguments)]
    return CliRunner().invoke(app, words, env={"EXCEPTIONDRIVE_SERVER": "http://127.0.0.1:9"})


def test_keys_that_cannot_be_written_are_refused_in_words(
    running: "Running", tmp_path: Path
) -> None:
    environment = {"EXCEPTIONDRIVE_SERVER": running.url}
    for output in (tmp_path / "nowhere" / "keys.json", tmp_path, Path()):
        asked = ["receipt", "keys", "-o", str(output)]
        done = CliRunner().invoke(app, asked, env=environment)
        assert (done.exit_code, f"{output} cannot be written" in done.stderr) == (2, True)


def test_a_folder_where_no_keys_can_be_remembered_is_told_in_words(
    running: "Running", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file"))
    with (
        Client(running.url) as client,
        pytest.raises(InvalidArgumentError, match="cannot be written"),
    ):
        remember_keys(client.receipt_keys())


def test_a_receipt_is_written_where_its_keys_cannot_be_remembered(
    working: "Running", planning_file: Callable[..., Path], tmp_path: Path
) -> None:
    sent = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    (tmp_path / "file").write_text("no folder")
    environment = {"EXCEPTIONDRIVE_SERVER": working.url, "XDG_CONFIG_HOME": str(tmp_path / "file")}
    output = tmp_path / "r.json"
    asked = ["receipt", "get", sent["id"], "-o", str(output)]
    done = CliRunner().invoke(app, asked, env=environment)
    assert done.exit_code == 0, done.stderr
    assert "warning: the keys are not remembered" in done.stderr
    assert "exceptiondrive receipt keys -o FILE" in done.stderr
    assert json.loads(output.read_text())["statement"]["submission_id"] == sent["id"]


FIELDS: dict[str, Any] = {
    "submission_id": "another",
    "file_digest": "sha256:" + "0" * 64,
    "size_bytes": 1,
    "phase": "other",
    "challenge": "strategy",
    "team": "Mallory",
    "method": "Better",
    "protocol": {"version": "1.0", "digest": "sha256:0"},
    "split": {"name": "tiny", "revision": "sha256:0"},
    "scorer_version": "99",
    "n": 1,
    "micro": {"hcc": 1.0},
    "macro_family": {"ur": 0.0},
    "families": {},
    "sheet_digest": "sha256:1",
    "received_at": "2020-01-01T00:00:00Z",
    "scored_at": "2020-01-01T00:00:00Z",
}


@pytest.mark.row("I30")
def test_a_receipt_holds_and_every_tampered_field_is_named(receipt: Path, tmp_path: Path) -> None:
    done = verify(receipt)
    assert done.exit_code == 0, done.stderr
    assert "the receipt holds" in done.stdout
    keys_path().unlink()
    assert verify(receipt, "--key", tmp_path / "keys.json").exit_code == 0
    missing = verify(receipt, "--key", tmp_path / "nowhere.json")
    assert missing.exit_code == 2
    assert "nowhere.json cannot be read" in " ".join(missing.stderr.split())
    unknown = verify(receipt)
    assert unknown.exit_code == 2
    assert "not among the known keys" in unknown.stderr
    assert "exceptiondrive receipt keys -o keys.json; then add --key" in unknown.stderr

    whole = json.loads(receipt.read_text())
    assert whole["statement"].keys() == FIELDS.keys()
    for field, value in FIELDS.items():
        changed = {**whole, "statement": {**whole["statement"], field: value}}
        receipt.write_text(json.dumps(changed))
        with pytest.raises(ReceiptError) as error:
            verify_receipt(receipt, keys=tmp_path / "keys.json")
        assert error.value.altered == (field,)
        assert field in error.value.sentence


def test_a_name_that_stands_twice_is_refused_whichever_comes_first(
    receipt: Path, tmp_path: Path
) -> None:
    """Readers differ in which of the two they take."""
    true = receipt.read_text()
    forged = json.dumps({**json.loads(true)["statement"], "method": "Better"})
    values = {"hcc": "0.9991", "n": "1", "method": '"Better"', "statement": forged}
    for field, value in values.items():
        receipt.write_text(true.replace(f'"{field}":', f'"{field}": {value}, "{field}":', 1))
        done = verify(receipt, "--key", tmp_path / "keys.json")
        assert (done.exit_code, done.stdout) == (2, "")
        assert f"receipt.json: {field} occurs twice in one object." in done.stderr


def test_a_check_says_the_scores_that_were_signed(receipt: Path) -> None:
    said = Receipt.model_validate_json(receipt.read_bytes()).statement
    told = " ".join(verify(receipt).stdout.split())
    assert f"{said.n} samples, mean of families: " in told
    assert f"hcc {said.macro_family['hcc']}" in told
    assert f"{said.n} samples, mean of samples: " in told
    assert f"hcc {said.micro['hcc']}" in told


def test_digests_that_were_altered_too_do_not_fit_the_signature(
    receipt: Path, tmp_path: Path
) -> None:
    whole = Receipt.model_validate_json(receipt.read_bytes())
    statement = whole.statement.model_copy(update={"team": "Mallory"})
    forged = whole.model_copy(update={"statement": statement, "digests": field_digests(statement)})
    receipt.write_text(forged.model_dump_json(by_alias=True))
    done = verify(receipt, "--key", tmp_path / "keys.json")
    assert done.exit_code == 2
    assert "signature does not fit" in done.stderr


def test_without_the_extra_it_says_what_to_install(
    receipt: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [key for key in sys.modules if key.startswith("cryptography")]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InvalidArgumentError, match=r"exceptiondrive\[receipts\]"):
        verify_receipt(receipt)


def test_something_else_is_no_receipt(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    path.write_text("{}")
    assert verify(path).exit_code == 2


WRAPPING: dict[str, tuple[Any, str]] = {
    "schema": ("exceptiondrive.receipt/2", "no receipt"),
    "algorithm": ("none", "no receipt"),
    "signature": ("", "signature does not fit"),
    "key_id": ("0" * 16, "not among the known keys"),
    "digests": ({}, "was altered"),
}


def test_nothing_around_the_statement_can_be_changed_either(receipt: Path, tmp_path: Path) -> None:
    whole = json.loads(receipt.read_text())
    assert whole.keys() == {"statement", *WRAPPING}
    for field, (value, words) in WRAPPING.items():
        receipt.write_text(json.dumps({**whole, field: value}))
        with pytest.raises(ReceiptError, match=words):
            verify_receipt(receipt, keys=tmp_path / "keys.json")


def another_key(like: ReceiptKey) -> tuple[Ed25519PrivateKey, ReceiptKey]:
    """A new key, and its public half under its own id."""
    private = Ed25519PrivateKey.generate()
    public = private.public_key().public_bytes_raw()
    text = base64.b64encode(public).decode()
    return private, like.model_copy(update={"key_id": key_id_of(public), "public_key": text})


def signed_by(private: Ed25519PrivateKey, key_id: str, receipt: Receipt, team: str) -> str:
    """A receipt that says something else, soundly signed."""
    statement = receipt.statement.model_copy(update={"team": team})
    digests = field_digests(statement)
    signature = base64.b64encode(private.sign(signed_bytes(key_id, digests))).decode()
    forged = {"statement": statement, "digests": digests, "key_id": key_id, "signature": signature}
    return receipt.model_copy(update=forged).model_dump_json(by_alias=True)


def test_a_receipt_of_a_former_key_holds_after_the_new_one_was_fetched(receipt: Path) -> None:
    (former,) = read_keys(keys_path())
    _, new = another_key(former)
    remember_keys(ReceiptKeys(server=former.server, keys=(former, new)))
    assert [key.key_id for key in read_keys(keys_path())] == [former.key_id, new.key_id]
    assert verify_receipt(receipt).key == former


def test_a_key_under_the_id_of_another_is_refused_wherever_keys_are_read(
    receipt: Path, tmp_path: Path
) -> None:
    (true,) = read_keys(keys_path())
    private, own = another_key(true)
    posing = own.model_copy(update={"key_id": true.key_id})
    rogue = ReceiptKeys(server="https://rogue.example", keys=(posing,))
    with pytest.raises(
        InvalidArgumentError, match=r"https://rogue.example gives a key under the id"
    ):
        remember_keys(rogue)
    assert read_keys(keys_path()) == (true,)

    whole = Receipt.model_validate_json(receipt.read_bytes())
    receipt.write_text(signed_by(private, true.key_id, whole, "Mallory"))
    given = tmp_path / "rogue.json"
    for file, arguments in ((given, ("--key", given)), (keys_path(), ())):
        for key in (posing, posing.model_copy(update={"public_key": "?"})):
            file.write_text(
                rogue.model_copy(update={"keys": (key,)}).model_dump_json(by_alias=True)
            )
            done = verify(receipt, *arguments)
            assert done.exit_code == 2
            assert f"{file} gives a key under the id" in done.stderr


def test_a_server_that_names_its_key_like_anothers_is_refused(
    receipt: Path, canned_server: "CannedServer"
) -> None:
    (true,) = read_keys(keys_path())
    posing = another_key(true)[1].model_dump(mode="json", exclude={"server"})
    keys = {"keys": [{**posing, "key_id": true.key_id}]}
    canned_server.answer("GET /receipt-keys", 200, keys)
    done = CliRunner().invoke(app, ["receipt", "keys", "--server", canned_server.url])
    assert done.exit_code == 2
    assert f"{canned_server.url} gives a key under the id" in done.stderr


def test_a_check_says_which_server_the_key_is_of(receipt: Path, working: "Running") -> None:
    whole = Receipt.model_validate_json(receipt.read_bytes())
    (true,) = read_keys(keys_path())
    private, own = another_key(true)
    remember_keys(ReceiptKeys(server="https://rogue.example", keys=(own, true)))

    assert verify_receipt(receipt).servers == (working.url, "https://rogue.example")
    assert f"key {true.key_id} of {working.url}" in verify(receipt).stdout
    receipt.write_text(signed_by(private, own.key_id, whole, "Mallory"))
    done = verify(receipt)
    assert f"key {own.key_id} of https://rogue.example\n" in done.stdout
    assert json.loads(verify(receipt, "--json").stdout)["servers"] == ["https://rogue.example"]


def test_keys_that_are_kept_without_their_server_check_too(receipt: Path) -> None:
    whole = json.loads(keys_path().read_text())
    for key in whole["keys"]:
        del key["server"]
    keys_path().write_text(json.dumps(whole))
    assert "of a server that is not noted beside it" in verify(receipt).stdout
