"""For every fault code a file with just this fault, and the page `docs/errors.md` about them.

The reports come from the checker itself.
"""

import gzip
import json
from collections.abc import Callable, Mapping
from typing import Any

from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.check.fault_list import MAX_FAULTS
from exceptiondrive_schemas.faults import MAX_EXAMPLES, MESSAGES, CheckReport, FaultCode
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.publish.examples import indented
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.split import Manifest

MAX_UPLOAD_BYTES, MAX_INFLATED_BYTES = 10_000, 100_000
"""Small limits that keep the examples small; the server's are larger."""
N_MOVING = 20


def _example_file(name: str) -> bytes:
    return json.dumps(json.loads(example_text(name)), separators=(",", ":")).encode()


PLANNING, STRATEGY = _example_file("planning"), _example_file("strategy")
MANIFEST = Manifest.model_validate_json(example_text("manifest"))
MANIFEST_OF_MOVING = MANIFEST.model_copy(
    update={"sample_ids": tuple(f"example-{number:04}" for number in range(1, N_MOVING + 1))}
)
"""Manifest of enough samples for the frame check."""


def _planning(old: bytes, new: bytes) -> Callable[[], bytes]:
    return lambda: PLANNING.replace(old, new, 1)


def _strategy(old: bytes, new: bytes) -> Callable[[], bytes]:
    return lambda: STRATEGY.replace(old, new, 1)


def _in_wrong_frame() -> bytes:
    document = json.loads(PLANNING)
    turned = [[-y_m, x_m] for x_m, y_m in document["predictions"][0]["source"]]
    predictions = [
        {"sample_id": sample_id, "source": turned, "edited": turned}
        for sample_id in MANIFEST_OF_MOVING.sample_ids
    ]
    return json.dumps({**document, "predictions": predictions}).encode()


def _first_prediction_twice() -> bytes:
    document = json.loads(PLANNING)
    document["predictions"].append(document["predictions"][0])
    return json.dumps(document).encode()


BROKEN_FILES: Mapping[FaultCode, Callable[[], bytes]] = {
    FaultCode.FILE_TOO_LARGE: lambda: PLANNING + b" " * MAX_UPLOAD_BYTES,
    FaultCode.EMPTY_FILE: lambda: b"",
    FaultCode.WRONG_FILE_KIND: lambda: b"PK\x03\x04" + PLANNING,
    FaultCode.DAMAGED_GZIP: lambda: gzip.compress(PLANNING, mtime=0)[:-20],
    FaultCode.INFLATES_TOO_LARGE: lambda: gzip.compress(b" " * 1_000_000, mtime=0),
    FaultCode.BYTE_ORDER_MARK: lambda: b"\xef\xbb\xbf" + PLANNING,
    FaultCode.NOT_UTF8: _planning(b"example-0002", b"ex\xe4mple-0002"),
    FaultCode.NOT_JSON: _planning(b"[6.0,0.0],", b"[6.0,0.0]"),
    FaultCode.NESTED_TOO_DEEPLY: _planning(b"[[3.0", b"[" * 200_000),
    FaultCode.VALUE_TOO_LONG: _planning(b"0.0", b"0." + b"0" * 2_000_000),
    FaultCode.TRAILING_DATA: lambda: PLANNING + b"\n" + PLANNING,
    FaultCode.DUPLICATE_KEY: _planning(b'"edited":null', b'"edited":null,"edited":null'),
    FaultCode.UNKNOWN_KEY: _planning(b'"split"', b'"method":"Braking planner","split"'),
    FaultCode.MISSING_KEY: _planning(b',"edited":null', b""),
    FaultCode.WRONG_TYPE: _planning(b"3.0", b'"3.0"'),
    FaultCode.WRONG_SCHEMA: _planning(b"planning/1", b"planning/2"),
    FaultCode.WRONG_SPLIT: _planning(b'"example"', b'"exmaple"'),
    FaultCode.UNKNOWN_SAMPLE: _planning(b"example-0002", b"example-002"),
    FaultCode.MISSING_SAMPLE: lambda: STRATEGY.replace(
        b',{"sample_id":"example-0003","strategy":null}', b""
    ),
    FaultCode.DUPLICATE_SAMPLE: _first_prediction_twice,
    FaultCode.WRONG_WAYPOINT_COUNT: _planning(b"[[3.0", b"[[0.0,0.0],[3.0"),
    FaultCode.WRONG_WAYPOINT_SHAPE: _planning(b"[3.0,0.0]", b"[3.0,0.0,1.57]"),
    FaultCode.NON_FINITE: _planning(b"3.0", b"NaN"),
    FaultCode.OUT_OF_BOUNDS: _planning(b"18.0", b"1018.0"),
    FaultCode.STEP_TOO_LONG: _planning(b"18.0", b"58.0"),
    FaultCode.WRONG_FRAME: _in_wrong_frame,
    FaultCode.UNKNOWN_STRATEGY: _strategy(b'"A"', b'"F"'),
    FaultCode.UNKNOWN_HAZARD_TYPE: _strategy(b'"LB1"', b'"lorry"'),
    FaultCode.UNKNOWN_RISK_LEVEL: _strategy(b'"high"', b'"very high"'),
    FaultCode.TEXT_TOO_LONG: _strategy(b"stop before it", b"stop " * 500),
    FaultCode.INVALID_TEXT: _strategy(b"stop before it", b"stop\\u0000"),
}


def report_of(code: FaultCode) -> CheckReport:
    """Return the report of the file with this fault."""
    manifest = MANIFEST_OF_MOVING if code is FaultCode.WRONG_FRAME else MANIFEST
    is_small = code in (FaultCode.FILE_TOO_LARGE, FaultCode.INFLATES_TOO_LARGE)
    limits: dict[str, Any] = (
        {"max_upload_bytes": MAX_UPLOAD_BYTES, "max_inflated_bytes": MAX_INFLATED_BYTES}
        if is_small
        else {}
    )
    return check(
        BROKEN_FILES[code](), protocol=packaged_protocol(), manifest=manifest, **limits
    ).report


HEAD = f"""# What can be wrong with a submission file

<!-- Written by `python -m exceptiondrive_schemas.publish`; do not edit. -->

`exceptiondrive check FILE --phase PHASE` (offline `--manifest M`) and the server run the same checker
and report the same faults. It reads the whole file in one pass and reports every fault: a code, the
place as a JSON path, the sample id, what was expected, what was found, and often what probably went
wrong. For each code the report gives the total and the first examples (at most {MAX_EXAMPLES}). At
{MAX_FAULTS:,} faults reading stops, and the report says so. A rejected file costs no quota.

Codes are stable: scripts may rely on them. Each one is shown here with the report of a file that has
exactly this fault.

"""


def errors_page() -> str:
    """Return the whole page."""
    index = "".join(f"- [`{code}`](#{code})\n" for code in FaultCode)
    return HEAD + index + "".join(_section(code) for code in FaultCode)


def _section(code: FaultCode) -> str:
    report = report_of(code)
    group = next(group for group in report.faults if group.code is code)
    notes = "".join(f"\nNote: {note}\n" for note in report.notes)
    shown = indented(group.model_dump_json(exclude_none=True))
    return f"\n## {code}\n\n{MESSAGES[code]}\n\n```json\n{shown}```\n{notes}"
