"""The settings of a phase: dates, limits, and what is shown when and to whom.

Each setting is one field here, with its title, a sentence, its bounds and its default. API, form,
command line and the table in `docs/phase-settings.md` are generated from these models; the records
reject inconsistent settings. A new setting is a field of `PhasePolicy`, which is stored as one
document, and code that obeys it. Fields of `PhaseSettings` are columns, as queries read them.
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import KnownChallenge
from exceptiondrive_schemas.datetimes import Time

SplitPart = Literal["public", "private"]
LivePart = Literal["public", "whole"]
RunRule = Literal["newest", "best", "this"]
"""A team's choice among the runs of a method: which one of them counts."""
BoardView = Literal["main", "late"]
Visibility = Literal["shown", "archived", "hidden"]
Title = Annotated[str, Field(min_length=1, max_length=120)]


class PhasePage(Document):
    """What the page of a phase tells besides its description. Texts are Markdown."""

    rules: str = Field(
        default="",
        max_length=20_000,
        title="Rules",
        description="What planners and teams may do, in Markdown.",
    )
    terms: str = Field(
        default="",
        max_length=20_000,
        title="Terms",
        description="What a team agrees to by submitting, in Markdown.",
    )
    prize: str = Field(
        default="", max_length=4000, title="Prize", description="What can be won, in Markdown."
    )
    contact: str = Field(
        default="",
        max_length=500,
        title="Contact",
        description="Whom to ask about the phase, in Markdown, such as `[Ada](mailto:ada@x.org)`.",
    )
    data_url: str = Field(
        default="",
        max_length=500,
        title="Data",
        description="https address of the page that offers scenes and edited images.",
    )
    data_licence: str = Field(
        default="",
        max_length=200,
        title="Licence of the data",
        description="Name of the licence, such as CC BY-NC-SA 4.0; shown before anything is downloaded.",
    )
    data_manifest_url: str = Field(
        default="",
        max_length=500,
        title="Data manifest",
        description="https address of the list of files, with sizes and digests, that "
        "`exceptiondrive data` downloads.",
    )


class PhasePolicy(Document):
    """What is shown of a phase, when, and to whom. The defaults show everything at once."""

    live_part: LivePart = Field(
        default="public",
        title="Live board on",
        description="For a split with parts: which samples the board counts until the reveal. A "
        "split without parts is always whole. Fixed once there are submissions.",
    )
    revealed_part: Literal["private", "whole"] = Field(
        default="private",
        title="Revealed board on",
        description="For a split with parts: which samples count after the reveal. Fixed once revealed.",
    )
    late_entries: Literal["refused", "own_view"] = Field(
        default="refused",
        title="Late entries",
        description="After the deadline: refused, or scored and ranked on a separate view "
        "that changes no rank on the board.",
    )
    freezes_at: Time | None = Field(
        default=None,
        title="Board freezes at",
        description="From then on the public board does not change until it is revealed.",
    )
    frozen_scores: Literal["shown", "hidden"] = Field(
        default="shown",
        title="Own scores while frozen",
        description="Whether a team sees the scores of what it submits after the freeze.",
    )
    families_from: Time | None = Field(
        default=None,
        title="Families shown from",
        description="Until then no family or task is shown anywhere; without a time they are shown.",
    )
    entries_shown: Literal["all", "chosen"] = Field(
        default="all",
        title="Entries on the board",
        description="All methods, or one entry per team: its choice, else its latest. Fixed at the "
        "deadline, and by a reveal.",
    )
    run_choice: Literal["newest", "team"] = Field(
        default="newest",
        title="Run of a method",
        description="Which run of a method counts if all methods are shown: always its newest, or "
        "the one that its team chooses until the deadline: newest, best or a run that it names. "
        "Changing back to newest discards what teams chose, and no team is told: write to them. Fixed "
        "at the deadline, and by a reveal.",
    )
    anonymous: bool = Field(
        default=False,
        title="Anonymous until revealed",
        description="Teams and methods appear under pseudonyms until the organizers reveal them. "
        "Fixed once there are submissions.",
    )
    entries_private: bool = Field(
        default=False,
        title="Private until published",
        description="An entry appears on the board when its team publishes it. Fixed once there "
        "are submissions.",
    )
    terms_required: bool = Field(
        default=False,
        title="Terms are accepted first",
        description="A team can submit only after accepting the current terms of the phase; if they "
        "change, it must accept them again. No team is told of a change: write to them.",
    )

    def run_rule(self, *, has_deadline: bool) -> str:
        """Say, before any upload, which run counts on the board."""
        private = "An entry is private, and ranks nowhere, until its team publishes it. "
        said = private if self.entries_private else ""
        if self.entries_shown == "chosen":
            return f"{said}One entry of each team counts: the one that it chose, else its newest."
        said += "The newest run of each method counts, even if it is worse"
        if self.run_choice == "team":
            return f"{said}, unless the team chooses before the deadline: the best, or one that it names."
        if has_deadline:
            return (
                f"{said}; withdraw it before the deadline, and the previous one counts again; later "
                "its place stays empty."
            )
        return f"{said}; withdraw it, and the previous one counts again."


class PhaseSettings(Document):
    """What organizers set for a phase, when they make it or later."""

    title: Title = Field(title="Title", description="Shown to readers.")
    description: str = Field(
        default="",
        max_length=4000,
        title="Description",
        description="What the phase asks, in Markdown; the board shows its first paragraph.",
    )
    visibility: Visibility = Field(
        default="shown",
        title="Visibility",
        description="Shown to everybody; archived: listed among past phases, takes no files; "
        "hidden: only organizers see it, and it is on no page, API, export or feed.",
    )
    position: int | None = Field(
        default=None,
        ge=1,
        le=100_000,
        title="Position",
        description="Phases are listed in this order, those without a position last; the first shown "
        "phase is the front page.",
    )
    opens_at: Time | None = Field(
        default=None, title="Opens at", description="Without it the phase is open from the start."
    )
    closes_at: Time | None = Field(
        default=None,
        title="Closes at",
        description="The deadline; without it the phase never closes.",
    )
    quota_per_day: int = Field(
        default=3,
        ge=1,
        le=10_000,
        title="Submissions per day",
        description="Per team and UTC day. A new phase on a withheld split has 1 by default.",
    )
    quota_total: int | None = Field(
        default=None,
        ge=1,
        le=1_000_000,
        title="Submissions in total",
        description="Per team; without it there is no limit. A new phase on a withheld split has 20 "
        "by default.",
    )
    quota_concurrent: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        title="Waiting at once",
        description="Submissions of one team that wait for a score; without it there is no limit.",
    )
    rejected_per_day: int = Field(
        default=20,
        ge=1,
        le=10_000,
        title="Faulty files per day",
        description="Per team and UTC day: files that are rejected, or that the server fails to score.",
    )
    shows_reported: bool = Field(
        default=False,
        title="Show the paper's results",
        description="Whether the board links to a page with the paper's results, and its "
        "document contains the paper's rows, marked as reported.",
    )
    page: PhasePage = PhasePage()
    policy: PhasePolicy = PhasePolicy()


class PhaseChange(PhaseSettings):
    """Settings to be changed: what is left out stays, null takes a limit or date away.

    Of the fields of `page` and `policy`, too, only those that are sent are changed.
    """

    title: Title = Field(default="", title="Title", description="Shown to readers.")


WITHHELD_DEFAULTS: Mapping[str, int] = {"quota_per_day": 1, "quota_total": 20}
"""Defaults of a new phase on a withheld split (docs/leakage.md)."""


class NewPhase(PhaseSettings):
    """A phase to be made: its settings, and what it is made of for good."""

    id: str = Field(
        max_length=64,
        description="Used in addresses.",
        json_schema_extra={"pattern": "^[a-z0-9][a-z0-9-]{0,63}$"},
    )
    challenge: KnownChallenge
    split: str = Field(max_length=64, description="Name of a registered split.")
    split_revision: str | None = Field(
        default=None, max_length=100, description="By default the one registered last."
    )
    protocol: str | None = Field(
        default=None,
        max_length=100,
        description="Version or digest. By default the one added last, on a withheld split 1.1-withheld.",
    )


class PhaseNow(Document):
    """Where a phase stands in its life."""

    part: SplitPart | None = None
    """Which part of the split the board counts; None: all samples."""
    n_counted: int
    """How many samples that are."""
    frozen_since: datetime | None = None
    families_shown_from: datetime | None = None
    is_anonymous: bool = False
    takes_late_entries: bool = False
    """Closed, and what comes now stands on the late view."""
