"""The query of a board, the same for page, API, exports, feed, badges and pictures.

The whole query is in the URL, and one parser reads it for all of them: an unknown value, or two that
contradict each other, are refused with the same message everywhere.
"""

from collections.abc import Iterable, Mapping
from datetime import UTC, date, datetime, time
from difflib import get_close_matches
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlencode

from fastapi import Depends, Query, Request
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.api.phase_settings import BoardView
from exceptiondrive_schemas.board import EntrySource
from exceptiondrive_schemas.challenges import CHALLENGES, KnownChallenge
from exceptiondrive_schemas.datetimes import Moment
from exceptiondrive_schemas.method_facts import LABELS
from exceptiondrive_server.web.browser_session import Elsewhere

Average = Literal["macro_family", "micro"]
SOURCES: tuple[EntrySource, ...] = ("scored", "reference", "reported")
"""In the order in which boards show them; rows of different sources are never mixed."""
AVERAGE_TITLES: Mapping[Average, str] = {
    "macro_family": "mean of families",
    "micro": "mean of samples",
}
OTHER_AVERAGE: Mapping[Average, Average] = {"macro_family": "micro", "micro": "macro_family"}
BY_RANK = "rank"
PageRows = Literal["20", "100", "all"]
PAGE_ROWS: Mapping[PageRows, int] = {"20": 20, "100": 100, "all": 1000}
"""Scored rows of a page; `all` has an end, so that no address makes a page without one."""
MAX_SEARCH = 80
MAX_CHOSEN = 5
_SIGNS = {"ascending": "", "descending": "-"}
_METRICS = dict.fromkeys(key for each in CHALLENGES.values() for key in each.metric_keys)
_SORTS = ", ".join((BY_RANK, "method", "date", "family.ID", *_METRICS))


class BoardQuery(BaseModel):
    """What a visitor asked for; every field has a default that the address leaves out.

    `hidden` holds the optional columns that are switched off, `added` those that are off unless
    they are asked for.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    challenge: KnownChallenge | None = Field(None, description="the challenge of the phase")
    phase: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="id; else the first phase, of the challenge where one is named",
    )
    protocol: str | None = Field(
        None, min_length=1, max_length=100, description="version or digest; else the one in force"
    )
    as_of: Moment | None = Field(
        None, description="the board that was current then; of a date, at its end (UTC)"
    )
    board: int | None = Field(None, ge=1, lt=2**31, description="its permanent number")
    view: BoardView = Field(
        "main",
        description="`late`: with the entries that came after the deadline, ranked among all",
    )
    sort: str = Field(
        BY_RANK,
        max_length=64,
        pattern=r"^-?[a-z][a-z0-9_.-]*$",
        description="what to sort by, `-` in front for descending; ranks stay, and entries without "
        f"a value come last. One of: {_SORTS}",
        examples=["ur", "-hcc"],
    )
    source: EntrySource | None = Field(None, description="entries of this source alone")
    average: Average | None = None
    search: str = Field("", description="entries whose method, team or words hold all these words")
    page: int = Field(1, ge=1, lt=2**31)
    rows: PageRows = "20"
    facts: frozenset[str] = Field(
        frozenset(),
        description="entries of these facts, as `type:vla,open_code:yes`: of one field any, of "
        "several fields each",
    )
    hidden: frozenset[str] = frozenset()
    added: frozenset[str] = frozenset()
    chosen: tuple[str, ...] = ()
    """Entries that the charts draw beside the leader; one that is not on the board is left out."""

    @field_validator("facts")
    @classmethod
    def _are_known_facts(cls, facts: frozenset[str]) -> frozenset[str]:
        for fact in facts:
            name, _, value = fact.partition(":")
            if value not in LABELS.get(name, {}):
                raise ValueError(f"FIELD:VALUE, of the fields {', '.join(LABELS)}")
        return facts

    @model_validator(mode="after")
    def _is_one_board(self) -> Self:
        if self.as_of is not None and self.protocol is not None:
            raise ValueError("Ask for a date or for a protocol, not for both: a date has its own.")
        named = [name for name in ("as_of", "protocol", "board") if getattr(self, name) is not None]
        if self.view == "late" and named:
            raise ValueError(
                "The late view is the present one: ask for it without date, protocol or number."
            )
        if len(named) > 1:
            raise ValueError("Ask for the number of a board alone: it has its date and protocol.")
        return self

    @classmethod
    def parse(cls, pairs: Iterable[tuple[str, str]]) -> Self:
        """Read an address.

        Raises:
            InvalidRecord: A value is not understood, or two of them contradict each other.
        """
        many: dict[str, list[str]] = {}
        for key, value in pairs:
            many.setdefault(key, []).append(value.strip())
        given: dict[str, Any] = {key: values[-1] for key, values in many.items()}
        if "apply" in given:  # a form sends its empty fields too
            given = {key: value for key, value in given.items() if value}
        if "sort" in given and "order" in given:
            given["sort"] = _SIGNS.get(given["order"], "?") + given["sort"].removeprefix("-")
        given["search"] = given.get("q", "")[:MAX_SEARCH]
        given["hidden"] = _hidden_columns(many)
        given["added"] = _comma_names(many.get("add", []))
        given["facts"] = _comma_names(many.get("fact", []))
        given["chosen"] = tuple(dict.fromkeys(key for key in many.get("more", []) if key))[
            :MAX_CHOSEN
        ]
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            raise _refusal_of(error) from None

    @property
    def until(self) -> datetime | None:
        """The moment that is asked for; of a date, its end."""
        if self.as_of is None or isinstance(self.as_of, datetime):
            return self.as_of
        return datetime.combine(self.as_of, time.max, UTC)

    @property
    def as_of_text(self) -> str:
        """The date or time that is asked for, as an address has it."""
        if isinstance(self.as_of, datetime):
            return self.as_of.isoformat().replace("+00:00", "Z")
        return self.as_of.isoformat() if isinstance(self.as_of, date) else ""

    @property
    def sort_key(self) -> str:
        """What is sorted by, in whatever direction."""
        return self.sort.removeprefix("-")

    def pairs(self) -> list[tuple[str, str]]:
        """Return the query of this state, without what is at its default."""
        given = [
            ("challenge", self.challenge),
            ("phase", self.phase),
            ("protocol", self.protocol),
            ("board", self.board),
            ("as_of", self.as_of_text or None),
            ("view", self.view if self.view != "main" else None),
            ("source", self.source),
            ("average", self.average),
            ("q", self.search or None),
            ("sort", self.sort if self.sort != BY_RANK else None),
            ("page", self.page if self.page > 1 else None),
            ("rows", self.rows if self.rows != "20" else None),
            ("fact", ",".join(sorted(self.facts)) or None),
            ("hide", ",".join(sorted(self.hidden)) or None),
            ("add", ",".join(sorted(self.added)) or None),
            *(("more", key) for key in self.chosen),
        ]
        return [(key, str(value)) for key, value in given if value is not None]

    def url(self, path: str = "/", anchor: str = "board", **changes: Any) -> str:
        """Return the address of this state with some fields changed; changes go to page 1."""
        changed = self.model_copy(update={"page": 1, **changes}) if changes else self
        query = urlencode(changed.pairs(), safe=",:")
        return f"{path}{'?' + query if query else ''}{'#' + anchor if anchor else ''}"


def board_query_of(request: Request) -> BoardQuery:
    """Read the address of a request.

    Raises:
        InvalidRecord: A value is not understood, or two of them contradict each other.
    """
    return BoardQuery.parse(request.query_params.multi_items())


_ASKED_AS = {"search": "q", "facts": "fact", "hidden": "hide", "added": "add", "chosen": "more"}
"""Fields that an address names otherwise."""
_KEYS = frozenset(
    [
        *(_ASKED_AS.get(name, name) for name in BoardQuery.model_fields),
        *("apply", "order", "offered", "show"),  # of forms
    ]
)
"""What `BoardQuery.parse` reads of an address."""


def require_known(request: Request, *further: str) -> None:
    """Redirect to the URL without unknown parameters, if there are any.

    Each would be a page of its own to be kept. `further` is what the page reads besides a board.
    """
    known = _KEYS.union(further)
    if not known.issuperset(request.query_params):
        kept = [(key, value) for key, value in request.query_params.multi_items() if key in known]
        query = urlencode(kept, safe=",:")
        raise Elsewhere(f"{request.url.path}{'?' + query if query else ''}", status=308)


BoardQueryOf = Annotated[BoardQuery, Depends(board_query_of)]
"""What the address of a request asks for."""


def _named_board(
    phase: Annotated[
        str | None, Query(min_length=1, max_length=64, description="id of the entry's phase")
    ] = None,
    board: Annotated[
        int | None,
        Query(ge=1, lt=2**31, description="as on the board of this number; else as it stands now"),
    ] = None,
) -> BoardQuery:
    return BoardQuery(phase=phase, board=board)


NamedBoard = Annotated[BoardQuery, Depends(_named_board)]
"""What names the board on which the API shows an entry."""


def documented() -> dict[str, Any]:
    """Return what OpenAPI says of the fields that name a board, its entries and their order."""
    properties = BoardQuery.model_json_schema()["properties"]
    names = ("challenge", "phase", "protocol", "as_of", "board", "sort", "view", "source")
    fact = "|".join(f"{field}:{value}" for field, values in LABELS.items() for value in values)
    forms = {"facts": {"pattern": f"^({fact})(,({fact}))*$"}}
    return {
        "parameters": [
            *(_parameter(name, properties[name]) for name in names),
            *(
                _parameter(
                    _ASKED_AS[name],
                    {
                        "type": "string",
                        "description": properties[name]["description"],
                        **forms.get(name, {}),
                    },
                )
                for name in ("search", "facts")
            ),
        ]
    }


def _parameter(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    kinds = [kind for kind in schema.get("anyOf", [schema]) if kind["type"] != "null"]
    shown = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    plain = {key: shown[key] for key in shown if key not in ("title", "description")}
    described = {"name": name, "in": "query", "required": False}
    return {**described, "description": schema["description"], "schema": plain}


def _refusal_of(error: ValidationError) -> InvalidRecord:
    """Say what is wrong and why, without echoing what was sent."""
    fields: dict[str, str] = {}
    for found in error.errors():
        words = str(found["msg"]).removeprefix("Value error, ")
        if found["loc"] == ("sort",):
            words = sort_words(str(found["input"]), _METRICS)
        given = found["loc"] or [key for key in ("as_of", "board", "view") if key in found["input"]]
        name = str(given[0])
        fields.setdefault(_ASKED_AS.get(name, name), words.removesuffix("."))
    return InvalidRecord(
        f"These parts of the request are missing or wrong: {', '.join(fields)}.", fields
    )


def sort_words(asked: str, metrics: Iterable[str]) -> str:
    """Say what a board can be sorted by, and suggest the nearest match."""
    names = (BY_RANK, "method", "date", *metrics)
    near = get_close_matches(asked[:64].lower().removeprefix("-"), names, n=1)
    meant = f"did you mean {near[0]}? " if near else ""
    return (
        f"{meant}sort by {BY_RANK}, method, date, a family, or one of {', '.join(metrics)}, with - in "
        "front for descending"
    )


def _hidden_columns(many: Mapping[str, list[str]]) -> frozenset[str]:
    """Columns switched off: a `hide` list, or the form's checkboxes against all it offered."""
    if "offered" in many:
        return _comma_names(many["offered"]) - set(many.get("show", []))
    return _comma_names(many.get("hide", []))


def _comma_names(texts: Iterable[str]) -> frozenset[str]:
    return frozenset([name for text in texts for name in text.split(",") if name])
