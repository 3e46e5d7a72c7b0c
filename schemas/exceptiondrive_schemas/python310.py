"""Backports to Python 3.10, on which the client runs, beside older planners."""

import sys

__all__ = ["UTC", "Self", "StrEnum", "tomllib"]

if sys.version_info >= (3, 11):
    from datetime import UTC
    from enum import StrEnum
    from typing import Self

    import tomllib
else:
    from datetime import timezone
    from enum import Enum

    import tomli as tomllib
    from typing_extensions import Self

    UTC = timezone.utc

    class StrEnum(str, Enum):
        """Members equal their text, also in `str` and in format strings."""

        def __str__(self) -> str:
            return str.__str__(self)

        def __format__(self, format_spec: str) -> str:
            return str.__format__(self, format_spec)
