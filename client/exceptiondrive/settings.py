"""Default server and phase: from an option, then the environment, then `config.toml`.

    server = "https://board.example.org"
    phase = "dev"

The file lies where the system keeps settings of a user (`$XDG_CONFIG_HOME/exceptiondrive/` on
Linux); `exceptiondrive config` says where, and which value comes from whence. Tokens are never in
it.
"""

import json
import os
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from exceptiondrive.errors import InvalidArgumentError

VARIABLES = {"server": "EXCEPTIONDRIVE_SERVER", "phase": "EXCEPTIONDRIVE_PHASE"}
"""The settings, and the variable of each."""


class Setting(NamedTuple):
    """A value and where it was found; None and nowhere."""

    value: str | None
    found_in: str


def config_folder() -> Path:
    """Where `config.toml` and the tokens of `login` lie; for a user without a home, where nothing can."""
    import platformdirs

    try:
        return Path(platformdirs.user_config_dir("exceptiondrive"))
    except RuntimeError:
        return Path(os.devnull)


def config_path() -> Path:
    """Where the settings lie."""
    return config_folder() / "config.toml"


def find_setting(name: str, option: str | None = None) -> Setting:
    """Return a setting: as an option says, else the environment, else the file.

    Raises:
        InvalidArgumentError: The file is no such file.
    """
    if option:
        return Setting(option, f"--{name}")
    if value := os.environ.get(VARIABLES[name], "").strip():
        return Setting(value, VARIABLES[name])
    kept = _read_file().get(name)
    return Setting(kept, str(config_path())) if kept else Setting(None, "")


def default_phase(option: str | None = None) -> str:
    """Return the phase that is meant.

    Raises:
        InvalidArgumentError: No phase was named anywhere.
    """
    phase = find_setting("phase", option).value
    if phase is None:
        raise InvalidArgumentError(
            "no_phase",
            "No phase was named.",
            "Add --phase PHASE, or keep one: exceptiondrive config phase PHASE. "
            "`exceptiondrive phases` lists them.",
        )
    return phase


def keep_setting(name: str, value: str | None) -> Path:
    """Write a setting into the file, or take it out; return the file.

    Raises:
        InvalidArgumentError: There is no such setting, or the file cannot be written.
    """
    require_known(name)
    settings = _read_file()
    settings.pop(name, None)
    settings |= {} if value is None else {name: value}
    lines = (f"{key} = {json.dumps(each, ensure_ascii=False)}\n" for key, each in settings.items())
    return write_settings_file(config_path(), "".join(sorted(lines, reverse=True)))


def write_settings_file(path: Path, text: str, *, mode: int = 0o666, advice: str = "") -> Path:
    """Write a file of the user's settings, whole or not at all; return it.

    Args:
        path: The file.
        text: What it holds from now on.
        mode: Of the file from its first moment on; the umask takes away from it.
        advice: What to do where it cannot be written.

    Raises:
        InvalidArgumentError: It cannot be written.
    """
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        part.unlink(missing_ok=True)
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.replace(part, path)
    except OSError as error:
        raise InvalidArgumentError(
            "unwritable_file", f"{path} cannot be written: {error.strerror}.", advice
        ) from None
    return path


def require_known(name: str, place: str = "") -> None:
    """Refuse a setting that there is not.

    Raises:
        InvalidArgumentError: It is none; `place` says where it stands.
    """
    if name in VARIABLES:
        return
    near = get_close_matches(name, VARIABLES, n=1)
    hint = f"Did you mean {near[0]!r}?" if near else f"There are {' and '.join(VARIABLES)}."
    raise InvalidArgumentError("wrong_setting", f"{place}There is no setting {name!r}.", hint)


def _read_file() -> dict[str, str]:
    from exceptiondrive_schemas.python310 import tomllib

    path = config_path()
    try:
        settings = tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (ValueError, OSError) as error:
        raise InvalidArgumentError(
            "wrong_config", f"{path} cannot be read: {error}.", 'Its lines are like: phase = "dev"'
        ) from None
    for name, value in settings.items():
        require_known(name, f"{path}: ")
        if not isinstance(value, str):
            raise InvalidArgumentError(
                "wrong_config", f"{path}: {name} is a text.", f'Write it like: {name} = "dev"'
            )
    return settings
