"""Predict the effect of an upload before anything is sent."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

from exceptiondrive.errors import QuotaError
from exceptiondrive_schemas.faults import CheckReport

if TYPE_CHECKING:
    from exceptiondrive_schemas.api.submission import SubmissionView


REPLACES_UNKNOWN = (
    "which entry of your team it replaces cannot be told without a token with the scope read:own"
)


@dataclass(frozen=True)
class Outlook:
    """What an upload will do.

    Attributes:
        report: Of the check, with what the file looks like and why it would not be ranked.
        replaces: The team's entry that it takes the place of; None where there is none.
        rule: Which run of a method stands, in a sentence.
        first: The team's submission of the same bytes, which stands; None where there is none.
        disqualified_at: Since when the team, or these very bytes of it, are disqualified: then the
            upload will be refused; None: they are not.
        is_closed: Whether the phase takes nothing now, early or late: the upload will be refused.
        is_late: Whether its deadline has passed, and it takes files for its late view alone.
        owes_terms: Whether the phase has terms that nobody accepted for the team: until then the
            upload will be refused.
        is_private: Whether it ranks nowhere until the team publishes it.
        quota_error: What says that the team's quota is used up: until its reset the upload will be
            refused; None: something is left.
        is_own_told: Whether the team's submissions could be read: else neither `replaces` nor `first`
            is known.
        stays: The entry that the team chose, which stands though this one comes; None: there is none.
        alike: A method of the team whose name differs from the one given in its letters' case alone.
    """

    report: CheckReport
    replaces: "SubmissionView | None"
    rule: str = ""
    first: "SubmissionView | None" = None
    disqualified_at: datetime | None = None
    is_closed: bool = False
    is_late: bool = False
    owes_terms: bool = False
    is_private: bool = False
    quota_error: QuotaError | None = None
    is_own_told: bool = True
    stays: "SubmissionView | None" = None
    alike: str | None = None

    @property
    def to_confirm(self) -> Mapping[str, str]:
        """What nobody may be surprised by, in a sentence; by the argument of `submit` that says yes."""
        is_out = self.disqualified_at is not None or self.quota_error is not None
        will_be_refused = self.is_closed or self.owes_terms or is_out
        if self.first is not None or will_be_refused:
            return {}
        from exceptiondrive_schemas.api.own_entries import to_confirm

        unknown = (
            {"replace": f"{REPLACES_UNKNOWN.capitalize()}."} if self.may_replace_unseen else {}
        )
        return {**unknown, **to_confirm(self.report.unranked_because, self.replaces)}

    @property
    def may_replace_unseen(self) -> bool:
        """Whether it may take the place of an entry that nobody here can name."""
        return not self.is_own_told and not self.is_private
