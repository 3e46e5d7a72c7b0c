"""Is the file for this split?"""

import re

from exceptiondrive_schemas.check.findings import Findings
from exceptiondrive_schemas.check.shown import kind, quoted
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.split import SPLIT_NAME_PATTERN, Manifest


def check_split_name(value: object, manifest: Manifest | None, findings: Findings) -> None:
    """Check what stands under `split`: the manifest's name, or any legal name without one."""
    expected = quoted(manifest.name) if manifest else "a split name such as nuscenes-test"
    if not isinstance(value, str):
        findings.add(FaultCode.WRONG_TYPE, ("split",), expected=expected, got=kind(value))
        return
    if manifest is not None:
        is_right = value == manifest.name
    else:
        is_right = re.fullmatch(SPLIT_NAME_PATTERN, value) is not None
    if not is_right:
        findings.add(FaultCode.WRONG_SPLIT, ("split",), expected=expected, got=quoted(value))
