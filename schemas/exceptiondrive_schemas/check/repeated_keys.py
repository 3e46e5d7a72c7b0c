"""Every place in a decoded value where a key stood more than once."""

from typing import Any

from exceptiondrive_schemas.check.findings import Findings, Path
from exceptiondrive_schemas.check.json_stream import RepeatedKeys
from exceptiondrive_schemas.check.shown import quoted
from exceptiondrive_schemas.faults import FaultCode


def report_repeated_keys(value: Any, path: Path, findings: Findings) -> None:
    """Report the repeated keys of a value, however deep; escaped spellings are equal."""
    places: list[tuple[Path, Any]] = [(path, value)]
    while places:
        path, value = places.pop()
        if isinstance(value, RepeatedKeys):
            for key in value.repeated:
                got = f"{quoted(key)} more than once"
                findings.add(FaultCode.DUPLICATE_KEY, path, expected="every key once", got=got)
        if isinstance(value, dict):
            places += [((*path, key), each) for key, each in value.items()]
        elif isinstance(value, list):
            places += [((*path, index), each) for index, each in enumerate(value)]
