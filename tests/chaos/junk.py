"""What may lie in a queue and is none of ours: from another program's data to one wrong field."""

import base64
import json
from typing import Any

from exceptiondrive_schemas.jobs import JobName

MARK = "do-not-log-me"
"""In every kind that has room for it: no log line may quote junk."""
_NO_MORE: dict[str, Any] = {"callbacks": None, "errbacks": None, "chain": None, "chord": None}
_SOUND: tuple[list[str], dict[str, Any], dict[str, Any]] = (["live"], {}, _NO_MORE)
_SOUND_BODY = base64.b64encode(json.dumps(_SOUND).encode())


def message(
    body: object = _SOUND,
    headers: dict[str, Any] | None = None,
    properties: dict[str, Any] | None = None,
    **envelope: object,
) -> bytes:
    """Return a message as the dispatcher sends it, but for the fields that are given."""
    usual: dict[str, Any] = {
        "body": base64.b64encode(json.dumps(body).encode()).decode(),
        "content-encoding": "utf-8",
        "content-type": "application/json",
        "headers": {
            "lang": "py",
            "task": JobName.WAKE.value,
            "id": MARK,
            "shadow": None,
            "eta": None,
            "expires": None,
            "retries": 0,
            "timelimit": [None, None],
            "origin": MARK,
            **(headers or {}),
        },
        "properties": {
            "correlation_id": MARK,
            "reply_to": "",
            "delivery_mode": 2,
            "delivery_info": {"exchange": "", "routing_key": "live"},
            "priority": 0,
            "body_encoding": "base64",
            "delivery_tag": MARK,
            **(properties or {}),
        },
    }
    return json.dumps({**usual, **envelope}).encode()


JUNK: dict[str, bytes] = {
    "no JSON": f"junk {MARK}".encode(),
    "half a letter": message(headers={"id": "\ud800"}),
    "nothing": b"",
    "no UTF-8": b"\xff\xfe\x00 " + MARK.encode(),
    "half a message": message()[:200],
    "a list": json.dumps([MARK]).encode(),
    "a number": b"7",
    "a number of 5,000 digits": b"9" * 5000,
    "nested 5,000 deep": b"[" * 5000,
    "no value": b"null",
    "no envelope": json.dumps({"body": MARK}).encode(),
    "a type that nobody knows": json.dumps({"__type__": MARK, "__value__": 1}).encode(),
    "a date that is none": json.dumps({"__type__": "datetime", "__value__": 1}).encode(),
    "a megabyte": message(padding="x" * 2**20),
    "another program's job": message(headers={"task": MARK}),
    "no job": message(headers={"task": None}),
    "no id": message(headers={"id": None}),
    "no headers": message().replace(b'"headers":', b'"was":'),
    "a job for later": message(headers={"eta": "2099-01-01T00:00:00"}),
    "a time that is none": message(headers={"expires": MARK}),
    "limits of its own": message(headers={"timelimit": [90000, 90000]}),
    "compressed": message(headers={"compression": "application/x-gzip"}),
    "a pickle": message().replace(b"application/json", b"application/x-python-serialize"),
    "another alphabet": message().replace(b'"utf-8"', b'"utf-16"'),
    "no tag": message(properties={"delivery_tag": None}),
    "from nowhere": message(properties={"delivery_info": {}}),
    "no properties": message(properties={"body_encoding": None}),
    "a body that is no base64": message().replace(_SOUND_BODY, b"%" + MARK.encode()),
    "a body that is no JSON": message().replace(_SOUND_BODY, base64.b64encode(b"junk")),
    "a body without ids": message(body=([], {}, _NO_MORE)),
    "more than a lane": message(body=(["live", MARK], {}, _NO_MORE)),
    "numbers for ids": message(body=([1], {}, _NO_MORE)),
    "named arguments": message(body=(["live"], {"x": MARK}, _NO_MORE)),
    "a job that is to follow": message(body=(["live"], {}, {**_NO_MORE, "chain": [MARK]})),
}
"""Name to message; each ended or disturbed a worker of plain Celery, or would have misled one."""
