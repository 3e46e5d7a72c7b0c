"""The check command: find samples and protocol, then check."""

from pathlib import Path

from pydantic import ValidationError

from exceptiondrive.checking import check_file, manifest_of, read_file
from exceptiondrive.cli.protocol_choice import chosen_protocol
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Manifest


def checked_report(
    file: Path,
    split: Path | None,
    manifest: Path | None,
    phase: str | None,
    protocol: str | None,
    server: str | None,
) -> CheckReport:
    """Check a file against at most one of split, manifest and phase.

    Raises:
        InvalidArgumentError: More than one of them, or one that cannot be used.
    """
    if sum(choice is not None for choice in (split, manifest, phase)) > 1:
        raise InvalidArgumentError(
            "too_many_choices", "Give only one of --split, --manifest and --phase."
        )
    if phase is not None:
        return _against_phase(file, phase, protocol, server)
    rules = chosen_protocol(protocol)
    return check_file(file, manifest=_manifest(split, manifest, rules), protocol=rules)


def _against_phase(file: Path, phase: str, protocol: str | None, server: str | None) -> CheckReport:
    from exceptiondrive.cli.session import open_client

    with open_client(server) as client:
        if protocol is None:
            return client.check(file, phase=phase)
        return check_file(file, manifest=client.manifest(phase), protocol=chosen_protocol(protocol))


def _manifest(split: Path | None, manifest: Path | None, protocol: Protocol) -> Manifest | None:
    if split is not None:
        from exceptiondrive.evaluation import read_split

        return manifest_of(read_split(split), protocol)
    if manifest is None:
        return None
    try:
        return Manifest.read(read_file(manifest))
    except ValidationError:
        raise InvalidArgumentError(
            "wrong_manifest",
            f"{manifest.name} is not a manifest.",
            "Take it from the server: exceptiondrive manifest PHASE -o FILE",
        ) from None
