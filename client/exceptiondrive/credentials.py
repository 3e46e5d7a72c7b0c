"""Which server, and which token for it.

Server: argument, then EXCEPTIONDRIVE_SERVER, then `config.toml`, then what `login` kept, then this
machine.
Token: argument of the SDK, then EXCEPTIONDRIVE_TOKEN, then what `login` kept for that server.
Tokens lie in one file that only its owner can read; they are never a command-line flag.
"""

import ipaddress
import json
import os
import stat
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from exceptiondrive.errors import InvalidArgumentError, NotAllowedError
from exceptiondrive.settings import Setting, config_folder, find_setting, write_settings_file

DEFAULT_SERVER = "http://127.0.0.1:8000"
TOKEN_VARIABLE = "EXCEPTIONDRIVE_TOKEN"


def credentials_path() -> Path:
    """Where `login` keeps tokens."""
    return config_folder() / "credentials.json"


def server_setting(server: str | None = None) -> Setting:
    """Return which server is meant, and where that is said."""
    found = find_setting("server", server)
    if found.value is not None:
        return found
    kept = _read_file().get("server")
    return Setting(kept, "login") if kept else Setting(DEFAULT_SERVER, "default")


def find_server(server: str | None = None) -> str:
    """Return the address of the server, without a slash at the end.

    Raises:
        InvalidArgumentError: Not an http or https address.
    """
    return normal_server(str(server_setting(server).value))


def normal_server(server: str) -> str:
    """Return an address in its one form: scheme and host in small letters, no slash at the end."""
    try:
        parts = urlsplit(server.strip())
        is_address = bool(parts.hostname) and not parts.username and parts.port != 0
    except ValueError:  # of a port or an IPv6 address that is none
        is_address = False
    if not is_address or parts.scheme.lower() not in ("http", "https"):
        raise InvalidArgumentError(
            "wrong_server",
            f"{server!r} is not the address of a server.",
            f"Write it like {DEFAULT_SERVER}.",
        )
    return f"{parts.scheme.lower()}://{parts.netloc.lower()}{parts.path.rstrip('/')}"


def find_token(server: str) -> str | None:
    """Return the token for this server, or None.

    Raises:
        NotAllowedError: Others can read the file of tokens.
    """
    token = os.environ.get(TOKEN_VARIABLE, "").strip()
    return token or _read_file().get("tokens", {}).get(server)


def keep_token(server: str, token: str) -> Path:
    """Keep a token for this server, and make the server the usual one; return the file.

    Raises:
        NotAllowedError: Others can read the file of tokens.
        InvalidArgumentError: It cannot be written.
    """
    content = _read_file()
    tokens = {**content.get("tokens", {}), server: token}
    return _write_file({"server": server, "tokens": tokens})


def forget_token(server: str) -> bool:
    """Forget the token of this server; return whether there was one."""
    content = _read_file()
    tokens = dict(content.get("tokens", {}))
    was_there = tokens.pop(server, None) is not None
    if was_there:
        _write_file({**content, "tokens": tokens})
    return was_there


def is_sent_in_clear(server: str) -> bool:
    """Whether a token would cross a network unencrypted."""
    parts = urlsplit(server)
    return parts.scheme == "http" and not is_this_machine(parts.hostname or "")


def is_this_machine(host: str) -> bool:
    """Whether the host of an address is this very machine."""
    try:
        return ipaddress.ip_address(host.rstrip(".")).is_loopback
    except ValueError:
        return host.rstrip(".") == "localhost"


def _read_file() -> dict[str, Any]:
    path = credentials_path()
    try:
        with path.open(encoding="utf-8") as stream:
            mode = os.fstat(stream.fileno()).st_mode
            if os.name == "posix" and stat.S_IMODE(mode) & 0o077:
                raise NotAllowedError(
                    "token_file_open",
                    f"Others can read the tokens in {path}.",
                    f"Run: chmod 600 '{path}' (and have a new token made if it was read).",
                )
            content = json.load(stream)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise InvalidArgumentError(
            "unreadable_file", f"{path} cannot be read: {error.strerror}."
        ) from None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or not isinstance(content.get("tokens", {}), dict):
        raise InvalidArgumentError(
            "token_file_damaged", f"{path} is damaged.", "Remove it and run: exceptiondrive login"
        )
    return content


def _write_file(content: dict[str, Any]) -> Path:
    advice = f"Without it a token is taken from {TOKEN_VARIABLE}."
    text = json.dumps(content, indent=1)
    return write_settings_file(credentials_path(), text, mode=0o600, advice=advice)
