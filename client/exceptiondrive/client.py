"""The SDK: a client of one server for a team, its submissions and its tokens."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import date, datetime
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Literal, TypeVar
from uuid import uuid4

from exceptiondrive.checking import check_file
from exceptiondrive.errors import (
    IT_IS_SAFE,
    SUBMIT_AGAIN,
    InvalidArgumentError,
    InvalidFileError,
    NetworkError,
    NotAllowedError,
    NotFoundError,
    NotSignedInError,
    QuotaError,
    ScoringFailedError,
    ServerError,
    WaitTimeoutError,
)
from exceptiondrive.facts import Facts, facts_of
from exceptiondrive.inputs import SubmissionLike, given_submission
from exceptiondrive.outlook import Outlook
from exceptiondrive.transport import (
    Connection,
    Progress,
    Record,
    quoted,
    read_answer,
    require_text,
    upload_body,
)
from exceptiondrive_schemas.api.own_entries import question_of, replaced_entry
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.submission import (
    Me,
    PhaseView,
    Quota,
    SubmissionPage,
    SubmissionStatus,
    SubmissionView,
)
from exceptiondrive_schemas.base import Document, bytes_digest
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.method_facts import SubmissionEditView
from exceptiondrive_schemas.printable import counted, shown_text
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import Manifest, Split

if TYPE_CHECKING:
    from exceptiondrive_schemas.api.notifications import NotificationView
    from exceptiondrive_schemas.api.phase_report import PhaseReport
    from exceptiondrive_schemas.board import Board
    from exceptiondrive_schemas.receipt import Receipt, ReceiptKeys

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
WAIT_FOR_RANK_S = 10.0
"""A board is built right after the score; longer than this is not waited for it."""
MAX_OUTAGES = 5
"""Requests in a row, each with its own retries, that may fail while waiting: about a minute."""

OnChange = Callable[[SubmissionView], None]
AnyDocument = TypeVar("AnyDocument", bound=Document)
PAGE_SIZE = 100
MAX_NAMES = 12
"""So many names are told where one was not found."""


class Submission:
    """One submission of the team, as last seen.

    Attributes:
        view: What the server said last.
    """

    def __init__(self, client: "Client", view: SubmissionView) -> None:
        self._client = client
        self.view = view
        self._outages = 0

    def __repr__(self) -> str:
        rank = f", rank {self.view.rank}" if self.view.rank else ""
        return f"<Submission {self.id}: {self.status.value}{rank}, {self.view.method!r}>"

    def _repr_html_(self) -> str:
        return self.view._repr_html_()

    @property
    def id(self) -> str:
        """Id, as `exceptiondrive status ID` takes it."""
        return self.view.id

    @property
    def status(self) -> SubmissionStatus:
        """Status, as last seen."""
        return self.view.status

    @property
    def page_url(self) -> str:
        """Address of its page, from upload to rank; for members of the team."""
        return self._client.page_url(self.id)

    def refresh(self) -> SubmissionView:
        """Ask the server again."""
        is_duplicate = self.view.is_duplicate
        view = self._client.status(self.id)
        self.view = view.model_copy(update={"is_duplicate": is_duplicate})
        return self.view

    def withdraw(self) -> SubmissionView:
        """Take it off the board."""
        self.view = self._client.withdraw(self.id)
        return self.view

    def wait(
        self, timeout_s: float | None = None, on_change: OnChange | None = None
    ) -> SubmissionView:
        """Wait until it is scored, and for its rank.

        Args:
            timeout_s: Give up after so long; None waits as long as it takes.
            on_change: Called with each new view.

        Returns:
            The scored submission, with score sheet and, unless it cannot be ranked, its rank.

        Raises:
            InvalidFileError: The file was rejected; the error carries every fault.
            ScoringFailedError: It failed, or was withdrawn meanwhile.
            WaitTimeoutError: It was not scored in time; it still will be.
            NetworkError: The server was away for about a minute; the submission is safe.
            NotSignedInError: The token was revoked or has expired; the submission is safe.
        """
        for pause_s in self.waiting(timeout_s, on_change):
            time.sleep(pause_s)
        return self.view

    def waiting(
        self, timeout_s: float | None = None, on_change: OnChange | None = None
    ) -> Iterator[float]:
        """Do what `wait` does, but leave each pause to the caller: yield its seconds."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause_s = FIRST_PAUSE_S
        while not self.status.is_terminal:
            if deadline is not None and time.monotonic() + pause_s > deadline:
                raise self._timed_out(timeout_s)
            yield pause_s
            pause_s = self._look_again(pause_s, on_change)
        self._raise_unless_scored()
        until = time.monotonic() + WAIT_FOR_RANK_S
        until = until if deadline is None else min(until, deadline)
        pause_s = FIRST_PAUSE_S
        while self.view.awaits_board and time.monotonic() < until:
            yield pause_s
            pause_s = self._look_again(pause_s, on_change)

    def _look_again(self, pause_s: float, on_change: OnChange | None) -> float:
        """Ask, and return the next pause; a short outage of the network is waited out."""
        before = self.view
        try:
            self.refresh()
        except (NetworkError, NotSignedInError) as error:
            self._outages += 1
            if self._outages > MAX_OUTAGES or isinstance(error, NotSignedInError):
                error.advice = f"Submission {self.id} is safe; look later with: exceptiondrive status {self.id}"
                raise
            return LONGEST_PAUSE_S
        self._outages = 0
        if on_change is not None and self.view != before:
            on_change(self.view)
        return min(pause_s * 1.3, LONGEST_PAUSE_S)

    def _raise_unless_scored(self) -> None:
        view = self.view
        if question := question_of(view):
            raise ScoringFailedError(
                "not_confirmed",
                f"Submission {view.id}: {question}",
                "To submit it all the same, send the file again, or confirm it on its page.",
                view,
            )
        if view.status is SubmissionStatus.REJECTED and view.report is not None:
            raise InvalidFileError(view.report, advice=SUBMIT_AGAIN)
        if view.status is SubmissionStatus.WITHDRAWN:
            raise ScoringFailedError(
                "withdrawn", f"Submission {view.id} was withdrawn.", "Submit again.", view
            )
        if view.status is not SubmissionStatus.SCORED:
            reason = view.failure.message if view.failure else "no reason was given."
            raise ScoringFailedError(
                view.failure.code if view.failure else "failed",
                f"Submission {view.id} could not be scored: {reason}",
                "This is a fault on our side; the organizers see it, and it cost no quota.",
                view,
            )

    def _timed_out(self, timeout_s: float | None) -> WaitTimeoutError:
        sentence = f"Submission {self.id} was not scored within {timeout_s:g} s."
        if self._outages:
            sentence = f"Whether submission {self.id} was scored within {timeout_s:g} s is not known: the server is away."
        return WaitTimeoutError(
            "wait_timed_out",
            sentence,
            IT_IS_SAFE.format(self.id),
            self.view,
        )


def _no_team(why: str) -> NotSignedInError:
    return NotSignedInError(
        "no_team",
        f"{why}, and no token of a team was given.",
        "Run: exceptiondrive login (or set EXCEPTIONDRIVE_TOKEN).",
    )


def _require_limit(limit: object) -> None:
    """Refuse what is no limit of a list, whatever a caller without type checks gives."""
    if limit is not None and not (isinstance(limit, int) and limit >= 0):
        raise InvalidArgumentError(
            "wrong_argument", f"limit is a whole number, or None for all, not {limit!r}."
        )


def _quota_error(quota: Quota | None) -> QuotaError | None:
    """Return what the server would say to one submission more; None where it takes it."""
    if quota is None or quota.remaining_today > 0:
        return None
    if quota.total is not None and quota.is_bound_in_all:
        sentence = f"Your team has used its {counted(quota.total, 'submission')} of this phase."
        return QuotaError("quota_exceeded", sentence, None)
    sentence = f"Your team has used its {counted(quota.per_day, 'submission')} of today."
    return QuotaError("quota_exceeded", sentence, quota.resets_at)


RUN_RULES: Mapping[RunRule, str] = {
    "best": "Of this method the best run stands, as your team said.",
    "this": "Of this method the run stands that your team chose: this one will not take its place.",
}
SENT_ANEW = (SubmissionStatus.REJECTED, SubmissionStatus.FAILED, SubmissionStatus.WITHDRAWN)
"""Where the same bytes are another submission."""
BeforeUpload = Callable[[Outlook], None]


class Client(Connection):
    """Submits files of one team and reads boards.

    >>> with Client() as client:
    ...     submission = client.submit("planner.json", phase="dev", method="Planner")
    ...     print(submission.wait().rank)

    Args:
        server: Address; else EXCEPTIONDRIVE_SERVER, else what `config` or `login` kept, else this machine.
        token: Team token; else EXCEPTIONDRIVE_TOKEN, else what `login` kept for the server.
        attempts: How often a request is sent at most.
        timeout_s: Longest time without a byte, per request.
        on_retry: Told of each pause before a further attempt, in seconds; nothing is ever printed.
    """

    def me(self) -> Me:
        """Return who the token speaks for."""
        return self._get(Me, "/me")

    def phases(self) -> tuple[PhaseView, ...]:
        """Return all phases, with the team's own quota when a token was given."""
        return read_answer(PhaseView.read_all, self._transport.get("/phases"))

    def phase(self, phase: str) -> PhaseView:
        """Return one phase.

        Raises:
            NotFoundError: There is no such phase; the advice names those that there are.
        """
        with self._suggesting_names(phase, self._phase_ids, "phases"):
            return self._get(PhaseView, f"/phases/{quoted(phase)}")

    def report(self, phase: str) -> "PhaseReport":
        """Return how a phase ended: winners, what a reveal changed, flags and counts.

        Raises:
            NotFoundError: There is no such phase, or it has not ended.
        """
        from exceptiondrive_schemas.api.phase_report import PhaseReport

        with self._suggesting_names(phase, self._phase_ids, "phases"):
            return self._get(PhaseReport, f"/phases/{quoted(phase)}/report")

    def _phase_ids(self) -> list[str]:
        return [view.id for view in self.phases()]

    def accept_terms(self, phase: str, version: str) -> Record:
        """Accept the terms of a phase for the team, in the version that was read.

        Raises:
            NotAllowedError: The terms are others by now, or none need be accepted.
        """
        path = f"/phases/{quoted(phase)}/terms"
        return self._transport.post_once(path, {"version": version})

    def quota(self, phase: str | None = None) -> dict[str, Quota]:
        """Return what the team may still submit, by phase; of one, or of all that take files now.

        Raises:
            NotSignedInError: No token was given, or it is an organizer's.
        """
        views = self.phases() if phase is None else (self.phase(phase),)
        if views and all(view.quota is None for view in views):
            raise _no_team("Only teams have a quota")
        asked = (view for view in views if phase is not None or view.takes_files)
        return {view.id: view.quota for view in asked if view.quota is not None}

    def manifest(self, phase: str) -> Manifest:
        """Return the sample ids of a phase's split."""
        with self._suggesting_names(phase, self._phase_ids, "phases"):
            return self._get(Manifest, f"/phases/{quoted(phase)}/manifest")

    def protocol(self, version: str) -> ProtocolDocument:
        """Return a protocol by its version."""
        with self._suggesting_names(version, self._protocol_versions, "protocols"):
            return self._get(ProtocolDocument, f"/protocols/{quoted(version)}")

    def _protocol_versions(self) -> list[str]:
        return [one["version"] for one in self._transport.get("/protocols").json()]

    def split(
        self, name: str, *, revision: str | None = None, on_progress: Progress | None = None
    ) -> Split:
        """Return a development split with its hazard regions; withheld splits are not found.

        Args:
            name: Of the split.
            revision: Which; by default the one in force.
            on_progress: Called with bytes come and bytes in all.

        Raises:
            NotFoundError: There is none, or its regions are withheld; the advice says which.
        """
        path, query = f"/splits/{quoted(name)}", {"revision": revision}
        with self._suggesting_names(name, lambda: self._public_splits(name), "public splits"):
            return read_answer(Split.read, self._transport.get(path, query, on_progress))

    def _public_splits(self, wanted: str) -> list[str]:
        phases = self.phases()
        if any(view.split == wanted and not view.split_is_public for view in phases):
            raise NotFoundError(
                "split_withheld",
                f"The regions of the split {wanted!r} are withheld: it is scored on the server.",
                "Its sample ids: exceptiondrive manifest PHASE",
            )
        return list(dict.fromkeys(view.split for view in phases if view.split_is_public))

    @contextmanager
    def _suggesting_names(
        self, name: str, known: Callable[[], list[str]], what: str
    ) -> Iterator[None]:
        """Add to the error of a name that is not found what was probably meant."""
        require_text(name)
        try:
            yield
        except NotFoundError as error:
            names = known() if name else [name]
            if name in names:  # something of it is not there
                raise
            near = get_close_matches(name.lower(), names, n=1)
            meant = f"Did you mean {near[0]!r}? " if near else ""
            listed = ", ".join(names[:MAX_NAMES]) + (" ..." if len(names) > MAX_NAMES else "")
            advice = f"{meant}There are the {what} {listed}." if names else f"There are no {what}."
            raise NotFoundError(error.code, error.sentence, advice) from None

    def check(self, file: SubmissionLike, *, phase: str) -> CheckReport:
        """Check a file on this machine against the samples and the protocol of a phase."""
        return self._check_for_phase(file, self.phase(phase))

    def _check_for_phase(self, file: SubmissionLike, phase: PhaseView) -> CheckReport:
        report = check_file(
            file,
            manifest=self.manifest(phase.id),
            protocol=self.protocol_of(phase),
            challenge=phase.challenge,
            max_upload_bytes=phase.max_upload_bytes,
        )
        if report.faults:
            return report
        return report.model_copy(update={"notes": (*report.notes, *phase.not_checked)})

    def outlook(self, file: SubmissionLike, *, phase: str, method: str | None = None) -> Outlook:
        """Check a file as `check` does, and say what an upload of it will do.

        Args:
            file: The submission: a path, bytes, an open file, a mapping, arrays or a data frame.
            phase: Id of the phase.
            method: Name of the method, as the board shows it; None: a new one.
        """
        return self._outlook(file, self.phase(phase), method)

    def _outlook(self, file: SubmissionLike, phase: PhaseView, method: str | None) -> Outlook:
        if method is not None:
            method = require_text(method, "The name of a method")
            try:
                method = shown_text("method name", method, max_length=80)
            except ValueError as error:
                advice = "Name it as the board shall show it."
                raise InvalidArgumentError("wrong_method", str(error), advice) from None
        report = self._check_for_phase(file, phase)
        if not report.is_valid:
            return Outlook(report, None)
        if phase.disqualified_at is not None:
            return Outlook(report, None, disqualified_at=phase.disqualified_at)
        own: tuple[SubmissionView, ...] = ()
        is_own_told = False
        with suppress(NotAllowedError):
            own, is_own_told = self.submissions(phase=phase.id, limit=None), True
        same = (each for each in own if each.file_digest == report.digest)
        first = next((each for each in same if each.status not in SENT_ANEW), None)
        if first is not None and first.disqualified_at is not None:
            return Outlook(report, None, first=first, disqualified_at=first.disqualified_at)
        scored = [each for each in own if each.status is SubmissionStatus.SCORED]
        replaces = stays = None
        if first is None:
            replaces = replaced_entry(own, method, phase.policy, is_open=phase.is_open)
        shows_one = phase.policy.entries_shown == "chosen"
        if first is None and phase.is_open:
            chosen = (each for each in scored if each.is_chosen and each.is_published)
            stays = next((each for each in chosen if shows_one or each.method == method), None)
        names = {each.method for each in own if each.status not in SENT_ANEW} - {method}
        alike = (name for name in names if method and name.casefold() == method.casefold())
        said: RunRule = next((each.run_rule for each in scored if each.method == method), "newest")
        rule = RUN_RULES.get(said) or phase.policy.run_rule(
            has_deadline=phase.closes_at is not None
        )
        if shows_one or phase.policy.run_choice == "team":
            rule += " To say otherwise: exceptiondrive choose."
        is_late = phase.takes_late_entries
        if is_late:
            rule = "What comes after the deadline takes no place on the board, and nothing is chosen any more."
        is_closed = not (phase.is_open or is_late)
        return Outlook(
            report,
            replaces,
            rule,
            first,
            is_closed=is_closed,
            is_late=is_late,
            owes_terms=phase.terms_version is not None and phase.terms_accepted_at is None,
            is_private=phase.policy.entries_private,
            quota_error=_quota_error(phase.quota) if first is None and phase.is_open else None,
            is_own_told=is_own_told,
            stays=stays,
            alike=next(alike, None),
        )

    def submit(
        self,
        file: SubmissionLike,
        *,
        phase: str,
        method: str,
        description: str = "",
        paper: str | None = None,
        code: str | None = None,
        facts: Facts | None = None,
        without_reminder: str | None = None,
        replace: bool = False,
        allow_unranked: bool = False,
        on_progress: Progress | None = None,
        before_upload: BeforeUpload | None = None,
    ) -> Submission:
        """Check a file on this machine, then upload it.

        A file that would replace another entry of the team, or be scored but not ranked, is sent only if
        you say so; bytes that were submitted before always are. Retries after a network failure carry
        the same `Idempotency-Key`, so that they never count twice.

        Args:
            file: The submission: a path, bytes, an open file, a mapping, arrays or a data frame.
            phase: Id of the phase.
            method: Name of the method, as the board shows it.
            description: One or two sentences about it.
            paper: https link.
            code: https link.
            facts: Facts of the method: a document, a mapping, or the path of a JSON file; without
                any, those of the team's last run of the method.
            without_reminder: Id of your submission of the same agent without reminder, in this
                strategy phase: the board then shows what the reminder changed.
            replace: Take the place of the team's entry that stands for the method.
            allow_unranked: Send what will be scored but not ranked.
            on_progress: Called with bytes sent and bytes in all.
            before_upload: Called with what the upload will do, in place of `replace` and
                `allow_unranked`; what it raises ends the submission before anything is sent.

        Returns:
            The submission; `is_duplicate` in its view says that the same bytes were there before.

        Raises:
            InvalidFileError: The file cannot be scored; nothing was sent.
            InvalidArgumentError: It replaces an entry, or will not be ranked; nothing was sent.
            QuotaError: Enough submitted for now.
            NotAllowedError: The phase is closed, or the token may not submit.
            NotSignedInError: No token of a team was given; nothing was read or asked.
            NetworkError: The server cannot be reached.
        """
        view = self.phase(phase)
        if view.quota is None:
            raise _no_team("Only teams submit")
        given = given_submission(file, view.split)
        require_text(method, "The name of a method")
        outlook = self._outlook(given, view, method)
        if not outlook.report.is_valid:
            raise InvalidFileError(outlook.report, advice=SUBMIT_AGAIN)
        if outlook.quota_error is not None:
            raise outlook.quota_error
        if before_upload is not None:
            before_upload(outlook)
        else:
            said = {"replace": replace, "allow_unranked": allow_unranked}
            asked = {name: words for name, words in outlook.to_confirm.items() if not said[name]}
            if asked:
                raise InvalidArgumentError(
                    "not_confirmed",
                    " ".join([*asked.values(), "Nothing was sent."]),
                    f"To send it, say {' and '.join(f'{name}=True' for name in asked)}.",
                )
        fields = {
            "phase": phase,
            "method": method,
            "description": description,
            "paper_url": paper,
            "code_url": code,
            "linked_to": without_reminder and self.id_of(without_reminder),
            "facts": None if facts is None else facts_of(facts).model_dump_json(),
        }
        body = upload_body(given.name, given.data, fields, uuid4().hex, on_progress)
        answer = self._transport.post("/submissions", body)
        return Submission(self, read_answer(SubmissionView.read, answer))

    def submission(self, submission_id: str) -> Submission:
        """Return a submission to follow."""
        return Submission(self, self.status(submission_id))

    def status(self, submission_id: str, *, profile: bool = False) -> SubmissionView:
        """Return where a submission stands, by its id or the address of its page.

        Args:
            submission_id: Id or address.
            profile: Ask, too, what its scored planning file looks like: `report.profile`, which
                `awaits_profile` until it is worked out.
        """
        query = {"profile": True} if profile else None
        return self._get(SubmissionView, self._path_of(submission_id), query)

    def _path_of(self, submission: str) -> str:
        return f"/submissions/{quoted(self.id_of(submission))}"

    def submissions(
        self,
        *,
        phase: str | None = None,
        status: SubmissionStatus | str | None = None,
        limit: int | None = 100,
    ) -> tuple[SubmissionView, ...]:
        """Return the team's submissions, newest first.

        Args:
            phase: Only of this phase.
            status: Only in this status, such as `scored`.
            limit: At most so many; None: all.

        Raises:
            NotFoundError: There is no such phase; the advice names those that there are.
        """
        _require_limit(limit)
        found: list[SubmissionView] = []
        after: str | None = None
        while limit is None or len(found) < limit:
            query = {"phase": phase, "status": status and str(status), "after": after}
            size = PAGE_SIZE if limit is None else min(limit - len(found), PAGE_SIZE)
            page = self._get(SubmissionPage, "/submissions", {**query, "limit": size})
            found.extend(page.submissions)
            after = page.next
            if after is None:
                break
        if phase is not None and not found:
            self.phase(phase)  # a mistyped one has no submissions either: say what was meant
        return tuple(found)

    def edit(
        self,
        submission_id: str,
        *,
        method: str | None = None,
        description: str | None = None,
        paper: str | None = None,
        code: str | None = None,
        facts: Facts | None = None,
        replace: bool = False,
    ) -> SubmissionView:
        """Change what is said of a submission; score, time and quota stay as they are.

        Args:
            submission_id: Which.
            method: New name; all runs of the method in the phase take it.
            description: New words; empty takes them away.
            paper: https link; empty takes it away.
            code: https link; empty takes it away.
            facts: Those to change: a document, a mapping, or the path of a JSON file. What is not
                named stays.
            replace: Take another method's name, and an entry of the team off the board: both become
                one method, of which one run stands.

        Raises:
            InvalidArgumentError: It replaces an entry, and may not; nothing was changed.
        """
        said = {
            "method": method,
            "description": description,
            "paper_url": paper,
            "code_url": code,
            "facts": None
            if facts is None
            else facts_of(facts).model_dump(mode="json", exclude_unset=True),
            "replace": replace or None,
        }
        change = {name: value for name, value in said.items() if value is not None}
        path = self._path_of(submission_id)
        return read_answer(SubmissionView.read, self._transport.send_patch(path, change))

    def edits(self, submission_id: str) -> tuple[SubmissionEditView, ...]:
        """Return what was changed of a submission, newest first: who, when, before and after."""
        answer = self._transport.get(f"{self._path_of(submission_id)}/edits")
        return read_answer(SubmissionEditView.read_all, answer)

    def download(self, submission_id: str) -> bytes:
        """Return the team's own upload, bit by bit.

        Raises:
            NotFoundError: It is another team's, or the server keeps it no longer.
            ServerError: What came is not what was sent.
        """
        view = self.status(submission_id)
        data = self._transport.get(f"{self._path_of(submission_id)}/file").content
        if bytes_digest(data) != view.file_digest:
            raise ServerError("damaged", "The file that came has another digest than the upload.")
        return data

    def ask(self, text: str, phase: str) -> Record:
        """Ask the organizers about a phase; the answer comes into the team's notices."""
        return self._transport.post_once(f"/phases/{quoted(phase)}/questions", {"text": text})

    def questions(self, phase: str) -> list[Record]:
        """Return what the team asked about a phase, with the answers, newest first."""
        return self._transport.records(f"/phases/{quoted(phase)}/questions")

    def news(self, phase: str) -> list[Record]:
        """Return the news of a phase, newest first."""
        return self._transport.records(f"/phases/{quoted(phase)}/news")

    def notices(
        self, *, unread: bool = False, limit: int | None = 100
    ) -> "tuple[NotificationView, ...]":
        """Return the team's notices, newest first.

        Args:
            unread: Only what was not read yet.
            limit: At most so many; None: all.
        """
        from exceptiondrive_schemas.api.notifications import NotificationView

        _require_limit(limit)
        found: list[NotificationView] = []
        page_size = PAGE_SIZE
        while page_size == PAGE_SIZE and (limit is None or len(found) < limit):
            query: dict[str, str | int | None] = {
                "unread": str(unread).lower(),
                "limit": PAGE_SIZE if limit is None else min(limit - len(found), PAGE_SIZE),
                "after": found[-1].id if found else None,
            }
            answer = self._transport.get("/notifications", query)
            page = read_answer(NotificationView.read_all, answer)
            page_size = len(page)
            found.extend(page)
        return tuple(found)

    def mark_read(self, notice_id: str) -> "NotificationView":
        """Mark a message as read."""
        from exceptiondrive_schemas.api.notifications import NotificationView

        answer = self._transport.post(f"/notifications/{quoted(notice_id)}/read", dict)
        return read_answer(NotificationView.read, answer)

    def contacts(self) -> list[Record]:
        """Return the team's addresses for notices, besides its inbox."""
        return self._transport.records("/contacts")

    def add_contact(self, address: str, wishes: Sequence[str] = ("updates",)) -> Record:
        """Add an address for notices; a webhook's secret is under `secret`, only in this response.

        Args:
            address: E-mail address, which has to be confirmed by who reads there, or https address.
            wishes: What it subscribes to: `updates`, `scored`, `failed`, `overtaken`, `phase_ends`.
        """
        channel = "webhook" if "://" in require_text(address, "An address") else "email"
        wanted = {"channel": channel, "address": address, "wishes": _subscription_list(wishes)}
        return self._transport.post_once("/contacts", wanted)

    def set_wishes(self, contact_id: str, wishes: Sequence[str]) -> Record:
        """Set what an address subscribes to."""
        return self._transport.patch(
            f"/contacts/{quoted(contact_id)}", {"wishes": _subscription_list(wishes)}
        )

    def remove_contact(self, contact_id: str) -> Record:
        """Remove an address for notices."""
        return self._transport.post_once(f"/contacts/{quoted(contact_id)}/remove", {})

    def withdraw(self, submission_id: str) -> SubmissionView:
        """Take a submission off the board; it keeps its place in the team's own list."""
        return self._post_action(submission_id, "withdraw")

    def choose(self, submission_id: str, rule: RunRule = "this") -> SubmissionView:
        """Choose which run counts on the board; the last choice before the deadline holds.

        Args:
            submission_id: What stands for the team, in a phase that shows one entry of each; a run of
                the method, in one that lets teams choose the run of a method.
            rule: This run, or the method's best or newest one.
        """
        return self._post_action(
            submission_id, "choose" if rule == "this" else f"choose?rule={rule}"
        )

    def publish(self, submission_id: str, *, replace: bool = False) -> SubmissionView:
        """Put an entry on the board of a phase that keeps entries private.

        Args:
            submission_id: Which.
            replace: Take the place of the public run of its method.

        Raises:
            InvalidArgumentError: It replaces one, and may not; nothing was changed.
        """
        return self._post_action(submission_id, "publish?replace=true" if replace else "publish")

    def unpublish(self, submission_id: str) -> SubmissionView:
        """Make an entry private again; earlier boards keep what they showed."""
        return self._post_action(submission_id, "unpublish")

    def _post_action(self, submission_id: str, what: str) -> SubmissionView:
        path = f"{self._path_of(submission_id)}/{what}"
        return read_answer(SubmissionView.read, self._transport.post(path, dict))

    def receipt(self, submission_id: str) -> "Receipt":
        """Return the signed receipt of a scored submission, or of anybody's entry on a board."""
        from exceptiondrive_schemas.receipt import Receipt

        of_entry = f"/entries/{quoted(self.id_of(submission_id))}/receipt"
        try:
            return self._get(Receipt, f"{self._path_of(submission_id)}/receipt")
        except NotSignedInError:
            return self._get(Receipt, of_entry)
        except NotFoundError:
            with suppress(NotFoundError):
                return self._get(Receipt, of_entry)
            raise

    def receipt_keys(self) -> "ReceiptKeys":
        """Return the public keys of the server's receipts.

        Raises:
            InvalidArgumentError: A key does not fit its id.
        """
        from exceptiondrive.receipts import require_true_ids
        from exceptiondrive_schemas.receipt import ReceiptKeys

        keys = self._get(ReceiptKeys, "/receipt-keys")
        require_true_ids(keys, self.server)
        return keys.model_copy(update={"server": self.server})

    def leaderboard(
        self,
        *,
        phase: str | None = None,
        challenge: str | None = None,
        protocol: str | None = None,
        as_of: datetime | date | str | None = None,
        board: int | None = None,
        sort: str | None = None,
        view: Literal["main", "late"] | None = None,
    ) -> "Board":
        """Return a board.

        Args:
            phase: Id of the phase.
            challenge: `planning` or `strategy`.
            protocol: Version; else the one in force.
            as_of: The board as it stood then; a time without a zone is in UTC, of a day it is the end.
            board: Its permanent number, as a citation names it; it has its own protocol and date.
            sort: Key of a metric, lowest first; with `-` in front highest first. Ranks stay what they are.
            view: `late`: with the entries that came after the deadline, ranked among all.
        """
        from exceptiondrive_schemas.board import Board

        moment = as_of.isoformat() if isinstance(as_of, date) else as_of
        query = {
            "phase": phase,
            "as_of": moment,
            "board": board,
            "challenge": challenge,
            "protocol": protocol,
            "sort": sort,
            "view": view,
        }
        with (
            self._suggesting_names(phase or "", self._phase_ids, "phases"),
            self._suggesting_names(protocol or "", self._protocol_versions, "protocols"),
        ):
            return self._get(Board, "/leaderboard", query)

    def protocol_of(self, phase: PhaseView) -> ProtocolDocument:
        """Return the phase's protocol, from this package where it is the same."""
        try:
            shipped = packaged_protocol(phase.protocol)
        except FileNotFoundError:
            return self.protocol(phase.protocol)
        is_same = shipped.digest == phase.protocol_digest
        return shipped if is_same else self.protocol(phase.protocol)

    def _get(
        self, kind: type[AnyDocument], path: str, query: dict[str, Any] | None = None
    ) -> AnyDocument:
        return read_answer(kind.read, self._transport.get(path, query))


def _subscription_list(wishes: Sequence[str]) -> list[str]:
    """Return subscriptions as a list; a single one may be given by itself."""
    if isinstance(wishes, str) or not isinstance(wishes, Iterable):
        return [require_text(wishes, "A subscription")]
    return [require_text(each, "A subscription") for each in wishes]


class TeamTokens(Connection):
    """Lists, issues, rotates and revokes the tokens of one's team; needs the scope `tokens`."""

    def all(self) -> list[Record]:
        """Return the team's tokens, newest first, without their secrets."""
        return self._transport.records("/tokens")

    def create(
        self, name: str, scopes: Sequence[str] | None = None, expires_at: str | None = None
    ) -> Record:
        """Issue a token; its text is under `token`, and is shown this once.

        Args:
            name: What it is for.
            scopes: None more than one's own token has; by default `submit` and `read:own`.
            expires_at: ISO 8601 with zone; else it ends with one's own token, if that ends.
        """
        wanted = {"name": name, "scopes": scopes and list(scopes), "expires_at": expires_at}
        return self._transport.post_once("/tokens", wanted)

    def rotate(self, token_id: str, *, keep_days: int = 7) -> Record:
        """Issue the successor of a token; the old one works on for `keep_days`."""
        path = f"/tokens/{quoted(token_id)}/rotate"
        return self._transport.post_once(path, {"keep_days": keep_days})

    def revoke(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return self._transport.post_once(f"/tokens/{quoted(token_id)}/revoke", {})
