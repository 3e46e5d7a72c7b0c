"""From `--protocol P` to a protocol: a TOML file, or a version that ships with the client."""

from pathlib import Path

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.protocol import (
    Protocol,
    ProtocolError,
    packaged_protocol,
    parse_protocol,
)


def chosen_protocol(choice: str | None) -> Protocol:
    """Return the chosen protocol; without a choice the one that ships.

    Raises:
        InvalidArgumentError: Neither a file nor a version, or a file that is no protocol.
    """
    if choice is None:
        return packaged_protocol()
    path = Path(choice)
    try:
        if path.is_file():
            return parse_protocol(path.read_text(encoding="utf-8-sig"))
        return packaged_protocol(choice)
    except ProtocolError as error:
        raise InvalidArgumentError("wrong_protocol", f"{choice}: {error}") from None
    except UnicodeDecodeError:
        raise InvalidArgumentError(
            "wrong_protocol", f"{choice} is not UTF-8 text; a protocol is a TOML file."
        ) from None
    except OSError:
        raise InvalidArgumentError(
            "wrong_protocol",
            f"{choice!r} is neither a protocol file nor a version that ships with this client.",
            "The server gives every version as a file at /api/v1/protocols/VERSION?format=toml.",
        ) from None
