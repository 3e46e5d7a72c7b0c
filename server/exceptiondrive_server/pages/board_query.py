"""The state of the board page, all of it in the address."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar
from urllib.parse import urlencode

from exceptiondrive_schemas.board import EntrySource

Average = Literal["macro_family", "micro"]
Order = Literal["ascending", "descending"]
SOURCES: tuple[EntrySource, ...] = ("scored", "reference", "reported")
AVERAGES: tuple[Average, ...] = ("macro_family", "micro")
AVERAGE_TITLES: Mapping[Average, str] = {
    "macro_family": "over families",
    "micro": "over samples",
}
DEFAULT_SORT = "rank"
MAX_SEARCH = 80
T = TypeVar("T", bound=str)


@dataclass(frozen=True)
class BoardQuery:
    """What a visitor asked for; every field has a default that the address leaves out.

    `hidden` holds the optional columns that are switched off.
    """

    phase: str | None = None
    protocol: str | None = None
    board: int | None = None
    as_of: str | None = None
    view: Literal["late"] | None = None
    source: EntrySource | None = None
    average: Average | None = None
    search: str = ""
    sort: str = DEFAULT_SORT
    order: Order | None = None
    page: int = 1
    hidden: frozenset[str] = field(default_factory=frozenset)

    @classmethod
    def parse(cls, pairs: Iterable[tuple[str, str]]) -> "BoardQuery":
        """Read an address; what it does not understand falls back to the default."""
        many: dict[str, list[str]] = {}
        for key, value in pairs:
            many.setdefault(key, []).append(value.strip())
        one = {key: values[-1] for key, values in many.items()}
        return cls(
            phase=one.get("phase") or None,
            protocol=one.get("protocol") or None,
            board=_positive(one.get("board")),
            as_of=one.get("as_of") or None,
            view="late" if one.get("view") == "late" else None,
            source=_one_of(one.get("source"), SOURCES),
            average=_one_of(one.get("average"), AVERAGES),
            search=one.get("q", "")[:MAX_SEARCH],
            sort=one.get("sort") or DEFAULT_SORT,
            order=_one_of(one.get("order"), ("ascending", "descending")),
            page=_positive(one.get("page")) or 1,
            hidden=_hidden(many),
        )

    def pairs(self) -> list[tuple[str, str]]:
        """Return the query of this state, without what is at its default."""
        given = [
            ("phase", self.phase),
            ("protocol", self.protocol),
            ("board", self.board),
            ("as_of", self.as_of),
            ("view", self.view),
            ("source", self.source),
            ("average", self.average),
            ("q", self.search or None),
            ("sort", self.sort if self.sort != DEFAULT_SORT else None),
            ("order", self.order),
            ("page", self.page if self.page > 1 else None),
            ("hide", ",".join(sorted(self.hidden)) or None),
        ]
        return [(key, str(value)) for key, value in given if value is not None]

    def url(self, path: str = "/", anchor: str = "board", **changes: Any) -> str:
        """Return the address of this state with some fields changed; changes go to page 1."""
        changed = replace(self, **{"page": 1, **changes}) if changes else self
        query = urlencode(changed.pairs(), safe=",")
        return f"{path}{'?' + query if query else ''}{'#' + anchor if anchor else ''}"


def _hidden(many: Mapping[str, list[str]]) -> frozenset[str]:
    """Columns switched off: a `hide` list, or the form's checkboxes against all it offered."""
    if "offered" in many:
        offered = {name for text in many["offered"] for name in text.split(",") if name}
        return frozenset(offered - set(many.get("show", [])))
    return frozenset(name for text in many.get("hide", []) for name in text.split(",") if name)


def _one_of(value: str | None, allowed: tuple[T, ...]) -> T | None:
    return next((item for item in allowed if item == value), None)


def _positive(text: str | None) -> int | None:
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 9:
        return None
    return int(text) or None
