"""`receipt get` and `receipt verify`: offline, and a tampered field is named."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from exceptiondrive import Client
from exceptiondrive.cli import app
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.receipts import ReceiptError, keys_path, verify_receipt

if TYPE_CHECKING:
    from tests.client.servers import Running


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
    unknown = verify(receipt)
    assert unknown.exit_code == 2
    assert "not among the known keys" in unknown.stderr

    whole = json.loads(receipt.read_text())
    assert whole["statement"].keys() == FIELDS.keys()
    for field, value in FIELDS.items():
        changed = {**whole, "statement": {**whole["statement"], field: value}}
        receipt.write_text(json.dumps(changed))
        with pytest.raises(ReceiptError) as error:
            verify_receipt(receipt, keys=tmp_path / "keys.json")
        assert error.value.altered == (field,)
        assert field in error.value.sentence


def test_digests_that_were_altered_too_do_not_fit_the_signature(
    receipt: Path, tmp_path: Path
) -> None:
    from exceptiondrive_schemas.receipt import Receipt, field_digests

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


def test_a_receipt_of_a_former_key_holds_after_the_new_one_was_fetched(receipt: Path) -> None:
    from exceptiondrive.receipts import read_keys, remember_keys
    from exceptiondrive_schemas.receipt import ReceiptKeys

    (former,) = read_keys(keys_path())
    new = former.model_copy(update={"key_id": "f" * 16, "public_key": "AAAA"})
    forged = former.model_copy(update={"public_key": new.public_key})
    remember_keys(ReceiptKeys(keys=(forged, new)))
    assert read_keys(keys_path()) == (former, new), "a known key was replaced under its name"
    assert verify_receipt(receipt).key == former
