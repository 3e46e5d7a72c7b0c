"""Signed receipts: who gets one, what it says, and what is left when the key changes."""

import base64
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from tests.support.documents import digest_of

from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.receipt import Receipt, ReceiptKeys, altered_fields, signed_bytes
from exceptiondrive_server.submissions.receipts import read_or_make_key, write_new_key

if TYPE_CHECKING:
    from tests.support.application import Api

    from exceptiondrive_schemas.board import BoardEntry

Problem = Callable[[Any, int, str], dict[str, Any]]


def scored(api: "Api") -> str:
    submission_id: str = api.submit("a file").json()["id"]
    api.score(submission_id)
    return submission_id


def receipt_of(api: "Api", submission_id: str) -> Receipt:
    response = api.get(f"/submissions/{submission_id}/receipt", "alpha")
    assert response.status_code == 200, response.text
    return Receipt.model_validate_json(response.content)


def check(api: "Api", receipt: Receipt) -> None:
    keys = ReceiptKeys.model_validate_json(api.get("/receipt-keys").content).keys
    (key,) = [key for key in keys if key.key_id == receipt.key_id]
    public_key = Ed25519PublicKey.from_public_bytes(base64.b64decode(key.public_key))
    signature = base64.b64decode(receipt.signature)
    public_key.verify(signature, signed_bytes(receipt.key_id, receipt.digests))
    assert altered_fields(receipt) == ()


def test_a_receipt_states_what_was_published_and_is_signed(api_on_both: "Api") -> None:
    submission_id = scored(api_on_both)
    receipt = receipt_of(api_on_both, submission_id)
    check(api_on_both, receipt)
    view = api_on_both.get(f"/submissions/{submission_id}", "alpha").json()
    said = receipt.statement.model_dump(mode="json")
    assert said["file_digest"] == digest_of(b"a file")
    assert said["sheet_digest"] == content_digest(view["sheet"])
    for field in ("protocol", "split", "scorer_version", "micro", "macro_family", "n"):
        assert said[field] == view["sheet"][field]
    assert said["received_at"] == view["received_at"]
    assert (said["phase"], said["team"], said["method"]) == ("dev", "Alpha", "Planner")


def test_the_same_receipt_twice_has_the_same_bytes(api: "Api") -> None:
    submission_id = scored(api)
    assert receipt_of(api, submission_id) == receipt_of(api, submission_id)


def test_a_signature_does_not_fit_another_submission(api: "Api") -> None:
    receipt = receipt_of(api, scored(api))
    other = receipt.model_copy(update={"digests": {**receipt.digests, "n": "sha256:0"}})
    with pytest.raises(InvalidSignature):
        check(api, other)


@pytest.mark.row("I24")
@pytest.mark.parametrize("who", ["beta", None])
def test_another_teams_receipt_is_not_given(api: "Api", who: str | None) -> None:
    submission_id = scored(api)
    status = api.get(f"/submissions/{submission_id}/receipt", who).status_code
    assert status == (401 if who is None else 404)


def test_what_is_not_scored_has_no_receipt(api: "Api", as_problem: Problem) -> None:
    submission_id = api.submit("a file").json()["id"]
    response = api.get(f"/submissions/{submission_id}/receipt", "alpha")
    as_problem(response, 404, "not_found")


def test_an_entry_of_a_board_has_a_public_receipt(
    api: "Api", make_entry: Callable[..., "BoardEntry"], as_problem: Problem
) -> None:
    submission_id = scored(api)
    as_problem(api.get(f"/entries/{submission_id}/receipt"), 404, "not_found")
    api.publish(make_entry("Planner", submission_id=submission_id))
    public = Receipt.model_validate_json(api.get(f"/entries/{submission_id}/receipt").content)
    assert public == receipt_of(api, submission_id)


def test_what_was_published_has_a_public_receipt_after_its_entry_left(
    api: "Api", make_entry: Callable[..., "BoardEntry"], as_problem: Problem
) -> None:
    submission_id = scored(api)
    api.publish(make_entry("Planner", submission_id=submission_id))
    before = api.get(f"/entries/{submission_id}/receipt").content
    assert api.post(f"/submissions/{submission_id}/withdraw", "alpha").status_code == 200
    api.publish(make_entry("Other", submission_id=None))
    as_problem(api.get(f"/entries/{submission_id}/receipt"), 404, "not_found")
    for elsewhere in ("board=2", "phase=dev", "phase=other&board=1", "board=7"):
        for path in (f"/entries/{submission_id}", f"/entries/{submission_id}/receipt"):
            as_problem(api.get(f"{path}?{elsewhere}"), 404, "not_found")
    shown = api.get(f"/entries/{submission_id}?board=1").json()
    assert (shown["board"], shown["entry"]["method"]) == (1, "Planner")
    of_board = api.get(f"/entries/{submission_id}/receipt?phase=dev&board=1")
    assert of_board.content == before
    check(api, Receipt.model_validate_json(of_board.content))


def test_the_private_key_is_its_owners_alone(api: "Api", tmp_path: Path) -> None:
    scored_id = scored(api)
    assert not (tmp_path / "receipt-key.pem").exists()
    receipt_of(api, scored_id)
    mode = (tmp_path / "receipt-key.pem").stat().st_mode
    assert stat.S_IMODE(mode) == 0o600


def test_old_receipts_hold_after_the_key_was_changed(
    make_api: Callable[..., "Api"], sqlite_url: str, tmp_path: Path
) -> None:
    api = make_api(sqlite_url)
    submission_id = scored(api)
    old = receipt_of(api, submission_id)
    write_new_key(tmp_path / "receipt-key.pem", replace=True)
    api.app.state.services.signer._loaded = None  # as after a restart
    new = receipt_of(api, submission_id)
    assert new.key_id != old.key_id
    assert new.statement == old.statement
    check(api, old)
    check(api, new)
    keys = api.get("/receipt-keys").json()["keys"]
    assert [key["is_current"] for key in keys] == [False, True]


def test_a_key_that_is_there_is_not_replaced_by_a_racing_process(tmp_path: Path) -> None:
    path = tmp_path / "key.pem"
    first = read_or_make_key(path).private_bytes_raw()
    write_new_key(path, replace=False)
    assert read_or_make_key(path).private_bytes_raw() == first
    assert [file.name for file in tmp_path.iterdir()] == ["key.pem"]


def test_an_unreadable_key_is_an_outage_and_says_nothing_of_its_place(
    api: "Api", tmp_path: Path, as_problem: Problem
) -> None:
    (tmp_path / "receipt-key.pem").write_text("no key")
    response = api.get(f"/submissions/{scored(api)}/receipt", "alpha")
    as_problem(response, 503, "store_unavailable")
    assert str(tmp_path) not in response.text
