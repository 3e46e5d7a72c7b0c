"""What a row of the table holds, and the replacements that several rows share."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Protection:
    """What is replaced by what, and one test that notices."""

    name: str
    target: str
    """`module:attribute`, or `module:Class.attribute`."""
    instead: Callable[[Any], Any]
    """Given what is there, returns what stands there instead."""
    test: str
    is_short: bool = False
    """Part of the short form that `make test` runs."""

    def take_away(self) -> None:
        """Replace it in this process."""
        module, _, path = self.target.partition(":")
        owner: Any = importlib.import_module(module)
        *classes, attribute = path.split(".")
        for name in classes:
            owner = getattr(owner, name)
        setattr(owner, attribute, self.instead(getattr(owner, attribute)))


def nothing(_: Any) -> Callable[..., None]:
    return lambda *arguments, **keywords: None


def same(_: Any) -> Callable[..., Any]:
    return lambda first, *arguments, **keywords: first


def always(value: Any) -> Callable[[Any], Callable[..., Any]]:
    return lambda _: lambda *arguments, **keywords: value
