"""The key `schema`: which challenge is the file for?"""

from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId, challenge_of_file
from exceptiondrive_schemas.check.findings import Findings
from exceptiondrive_schemas.check.json_stream import JsonStream, JsonStreamError, members, skip
from exceptiondrive_schemas.check.shown import kind, quoted
from exceptiondrive_schemas.faults import FaultCode


def check_schema(
    value: object, wanted: ChallengeId | None, findings: Findings
) -> ChallengeId | None:
    """Check what stands under `schema`.

    Args:
        value: What stands there.
        wanted: The challenge that the file must be for; any, if None.
        findings: Takes the fault.

    Returns:
        The challenge that the file names, None where there is no such challenge.
    """
    named = _challenge_of(value)
    if named is not None and wanted in (None, named):
        return named
    schemas = [each.file_schema for key, each in CHALLENGES.items() if wanted in (None, key)]
    is_mixed_up = named is not None and wanted is not None
    findings.add(
        FaultCode.WRONG_SCHEMA if isinstance(value, str) else FaultCode.WRONG_TYPE,
        ("schema",),
        expected=" or ".join(quoted(schema) for schema in schemas),
        got=quoted(value) if isinstance(value, str) else kind(value),
        hint=f"this is a {named} file, and a {wanted} file is wanted" if is_mixed_up else None,
    )
    return named


def find_challenge(stream: JsonStream) -> ChallengeId | None:
    """Look for `schema` behind the predictions, whose rules depend on it."""
    try:
        for key in members(stream):
            if key == "schema":
                return _challenge_of(stream.value())
            skip(stream)
    except JsonStreamError:
        return None
    return None


def _challenge_of(value: object) -> ChallengeId | None:
    named = challenge_of_file(value) if isinstance(value, str) else None
    return named.id if named else None
