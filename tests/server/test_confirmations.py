"""Confirmations by organizers: signed on their machine, kept here by API, page and command."""

import base64
import json
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from exceptiondrive.confirmations import confirm, make_key
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.split import SplitRef

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Problem = Callable[[Any, int, str], dict[str, Any]]
PATH = "/organizer/confirmations"


@pytest.fixture
def signed(api: "Api", tmp_path: Path) -> dict[str, Any]:
    """What an organizer signed of the sample split and the protocol of its phase."""
    with api.database.write() as session:
        protocol = add_protocol(session, packaged_protocol_toml("1.1"), "test")
    split = next(one for one in api.get("/organizer/splits", "organizer").json())
    ref = SplitRef(name=split["name"], revision=split["revision"])
    make_key(tmp_path / "key.pem")
    given = confirm(ref, protocol.digest, tmp_path / "key.pem")
    return given.model_dump(mode="json", by_alias=True)


def actions(api: "Api") -> list[str]:
    return [line["action"] for line in api.get("/organizer/audit", "organizer").json()]


def test_a_confirmation_is_kept_once_and_taken_back_with_a_reason(
    api: "Api", signed: dict[str, Any], as_problem: Problem
) -> None:
    made = api.post(PATH, "organizer", json=signed)
    assert made.status_code == 201
    assert made.json()["confirmation"] == signed
    assert api.post(PATH, "organizer", json=signed).json() == made.json()
    assert api.get(PATH, "organizer").json() == [made.json()]
    assert actions(api).count("protocol confirmed") == 1
    path = f"{PATH}/{made.json()['id']}/withdraw"
    as_problem(api.post(path, "organizer", json={"reason": ""}), 400, "bad_request")
    assert api.post(path, "organizer", json={"reason": "wrong document"}).json() == []
    as_problem(api.post(path, "organizer", json={"reason": "again"}), 404, "not_found")
    assert actions(api)[0] == "confirmation withdrawn"
    as_problem(api.post(PATH, "organizer", json=signed), 409, "conflict")
    assert api.get(PATH, "organizer").json() == []


def test_what_is_signed_are_the_bytes_that_the_document_tells(signed: dict[str, Any]) -> None:
    stated = {name: signed[name] for name in ("schema", "split", "protocol")}
    words = json.dumps(stated, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    key = Ed25519PublicKey.from_public_bytes(base64.b64decode(signed["public_key"]))
    key.verify(base64.b64decode(signed["signature"]), words.encode())  # raises where it is not


def test_what_is_not_signed_rightly_is_refused(
    api: "Api", signed: dict[str, Any], as_problem: Problem
) -> None:
    other = packaged_protocol("1.0").digest
    wrong = [
        (signed | {"protocol": other}, 400, "bad_request"),
        (signed | {"signature": "A" * 86 + "=="}, 400, "bad_request"),
        (signed | {"public_key": "A" * 43 + "="}, 400, "bad_request"),
        (signed | {"protocol": "sha256:none"}, 404, "not_found"),
        (signed | {"split": signed["split"] | {"revision": "sha256:none"}}, 404, "not_found"),
        (signed | {"signature": "short"}, 400, "bad_request"),
    ]
    for body, status, code in wrong:
        as_problem(api.post(PATH, "organizer", json=body), status, code)
    as_problem(api.post(PATH, "alpha", json=signed), 403, "not_allowed")
    assert api.get(PATH, "organizer").json() == []


def test_the_page_takes_what_the_command_wrote_and_lists_it(
    api: "Api", browse: Callable[..., "TeamBrowser"], signed: dict[str, Any]
) -> None:
    browser = browse(api, who="organizer")
    page = "/organize/protocols/confirm"
    refused = browser.post(page, {"confirmation": "{}"}, page=page)
    assert (refused.status_code, "This is not a confirmation" in refused.text) == (400, True)
    led = browser.post(page, {"confirmation": json.dumps(signed)}, page=page)
    assert led.headers["location"] == "/organize/protocols?done=protocol_confirmed"
    listed = browser.get("/organize/protocols").text
    assert signed["public_key"] in listed.replace("&#43;", "+")
    confirmation = Confirmation.model_validate(signed)
    withdraw = f"/organize/protocols/confirmations/{confirmation.id}/withdraw"
    assert withdraw in listed
    browser.post(withdraw, {"reason": "wrong document"}, page=withdraw)
    assert api.get(PATH, "organizer").json() == []


def test_a_private_key_is_its_owners_alone_and_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "new" / "key.pem"
    public_key = make_key(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert make_key(path) == public_key
    path.write_text("no key")
    with pytest.raises(InvalidArgumentError, match="no Ed25519 key"):
        make_key(path)
    assert path.read_text() == "no key"
