"""What an organizer's token may do: teams, tokens, phases, protocols, rescoring, splits, audit.

Answers are JSON objects as the page `/api` of the server and its `/api/v1/openapi.json` tell them (`organizers`);
runs, previews, verifications and what is alike are documents of these names.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from exceptiondrive.transport import Connection, Record, Transport, quoted, read_answer
from exceptiondrive_schemas.api.rescoring import PreviewView, RunView, VerificationView
from exceptiondrive_schemas.api.similarity import SimilarityReport
from exceptiondrive_schemas.base import Document

_Read = TypeVar("_Read", bound=Document)
MAX_ARCHIVE_BYTES = 2**36
"""Of every upload of a phase, which an organizer's own server packs."""


def _organizer_path(*parts: str) -> str:
    """Return the path of what only organizers may, whatever its parts hold."""
    return "/".join(["/organizer", *map(quoted, parts)])


class Organizer(Connection):
    """Speaks for an organizer to one server; server and token as in `Client`."""

    def _do(self, *where: str, **said: Any) -> Record:
        return self._transport.post_once(_organizer_path(*where), said)

    def _path_of(self, submission: str, *parts: str) -> str:
        """Return the path of a submission, of the address of its page too."""
        return _organizer_path("submissions", self.id_of(submission), *parts)

    def _do_with(self, submission: str, what: str, **said: Any) -> Record:
        return self._transport.post_once(self._path_of(submission, what), said)

    @property
    def rescoring(self) -> "Rescoring":
        """Protocol updates, each step with its reason."""
        return Rescoring(self._transport)

    def teams(self) -> list[Record]:
        """Return all teams."""
        return self._transport.records("/organizer/teams")

    def create_team(
        self,
        team_id: str,
        name: str,
        *,
        affiliation: str = "",
        email: str = "",
        is_reference: bool = False,
    ) -> Record:
        """Make a team; a reference team's entries are shown and never ranked."""
        known = {"affiliation": affiliation or None, "email": email or None}
        return self._do("teams", id=team_id, name=name, is_reference=is_reference, **known)

    def approve_team(self, team_id: str) -> Record:
        """Let a team that registered itself submit."""
        return self._do("teams", team_id, "approve")

    def refuse_team(self, team_id: str, reason: str) -> Record:
        """Refuse a team that registered itself: it goes, with its tokens."""
        return self._do("teams", team_id, "refuse", reason=reason)

    def participation(self, team_id: str) -> Record:
        """Return people, addresses, allowances, disqualifications and accepted terms of a team."""
        return self._transport.record(_organizer_path("teams", team_id, "participation"))

    def change_team(self, team_id: str, reason: str, **changes: str) -> Record:
        """Change `name` or `affiliation` of a team; what is left out stays."""
        return self._transport.patch(
            _organizer_path("teams", team_id), {"reason": reason, **changes}
        )

    def merge_teams(self, team_id: str, into: str, reason: str) -> Record:
        """Make a team part of another one, for good."""
        return self._do("teams", team_id, "merge", into=into, reason=reason)

    def forget_team(self, team_id: str, reason: str) -> Record:
        """Delete all personal data of a team; return its alias."""
        return self._do("teams", team_id, "forget", reason=reason)

    def import_teams(self, csv: str) -> Record:
        """Create the `teams` of a table, each with a token that is shown only here: all or none."""
        return self._do("team-imports", csv=csv)

    def set_allowance(
        self, team_id: str, phase_id: str, reason: str, allowance: Mapping[str, Any]
    ) -> Record:
        """Set `closes_at`, `quota_per_day`, `quota_total` of one team; None is as for all."""
        return self._transport.patch(
            _organizer_path("teams", team_id, "allowances", phase_id),
            {"reason": reason, **allowance},
        )

    def disqualify_team(
        self, team_id: str, reason: str, public_note: str | None = None, phase: str | None = None
    ) -> Record:
        """Take a team off the boards of a phase, or of all, until it is reinstated."""
        where = "teams", team_id, "disqualify"
        return self._do(*where, reason=reason, public_note=public_note, phase=phase)

    def disqualify_submission(
        self, submission_id: str, reason: str, public_note: str | None = None
    ) -> Record:
        """Take one submission off the boards; the same bytes are not taken again."""
        said = {"reason": reason, "public_note": public_note}
        return self._do_with(submission_id, "disqualify", **said)

    def disqualifications(self) -> list[Record]:
        """Return disqualifications, newest first; those that ended, too."""
        return self._transport.records("/organizer/disqualifications")

    def reinstate(self, disqualification_id: int, reason: str) -> Record:
        """End a disqualification."""
        return self._do("disqualifications", str(disqualification_id), "reinstate", reason=reason)

    def send_message(
        self,
        title: str,
        text: str,
        teams: Sequence[str] = (),
        phase: str | None = None,
        *,
        is_preview: bool = False,
    ) -> Record:
        """Write to these teams, or to all; of all, to those that submitted to a phase."""
        message = {"title": title, "text": text, "teams": list(teams), "phase": phase}
        return self._do("messages", **message, is_preview=is_preview)

    def news(self, phase_id: str | None = None) -> list[Record]:
        """Return the news of one phase or of all, withdrawn ones too, newest first."""
        return self._transport.records("/organizer/news", {"phase": phase_id})

    def publish_news(self, phase_id: str, title: str, text: str) -> Record:
        """Announce something of a phase: on its page, in its feed, in the inbox of every team."""
        return self._do("phases", phase_id, "news", title=title, text=text)

    def withdraw_news(self, news_id: str, reason: str) -> Record:
        """Take news from page and feed."""
        return self._do("news", news_id, "withdraw", reason=reason)

    def people(self) -> list[Record]:
        """Return everybody who signed in through the provider, with their roles."""
        return self._transport.records("/organizer/people")

    def set_role(self, person_id: str, role: str | None, phases: Sequence[str] = ()) -> Record:
        """Give a person a role of organizers, confined to phases where they are named; None: none."""
        confined = {"is_organizer": role is not None, "phases": list(phases)}
        return self._do("people", person_id, "organizer", **confined, role=role or None)

    def forget_person(self, person_id: str, reason: str) -> Record:
        """Take a person out of their teams and of the records, whose id alone stays."""
        return self._do("people", person_id, "forget", reason=reason)

    def questions(self, phase_id: str | None = None) -> list[Record]:
        """Return the questions of all teams, about one phase or all, those that wait first."""
        return self._transport.records("/organizer/questions", {"phase": phase_id})

    def answer_question(self, question_id: str, text: str, *, to_all: bool = False) -> Record:
        """Answer a question: to the team alone, or to all, without its name."""
        return self._do("questions", question_id, "answer", text=text, to_all=to_all)

    def retry_submission(self, submission_id: str, reason: str) -> Record:
        """Queue a failed submission again, with all its attempts."""
        return self._do_with(submission_id, "retry", reason=reason)

    def story(self, submission_id: str) -> Record:
        """Return a submission with its jobs, recomputations, edits, notices and audit lines."""
        return self._transport.record(self._path_of(submission_id))

    def verify_submission(self, submission_id: str, reason: str) -> VerificationView:
        """Ask for its score to be made again from the upload; follow it by `rescoring.verification`."""
        path, said = self._path_of(submission_id, "verify"), {"json": {"reason": reason}}
        return read_answer(VerificationView.read, self._transport.post(path, lambda: said, False))

    def restore_submission(self, submission_id: str, reason: str) -> Record:
        """Restore a withdrawn submission."""
        return self._do_with(submission_id, "restore", reason=reason)

    def write_about(self, submission_id: str, words: str) -> Record:
        """Tell a team something about its submission, in its inbox and at its confirmed addresses."""
        return self._do_with(submission_id, "note", words=words)

    def download_upload(self, submission_id: str) -> bytes:
        """Return the bytes that a team sent; the audit log says who had them."""
        return self._transport.get(self._path_of(submission_id, "file")).content

    def download_story(self, submission_id: str) -> bytes:
        """Return a tar for a committee: upload, receipt, story and a README."""
        return self._transport.get(self._path_of(submission_id, "folder")).content

    def download_archive(
        self, team: str | None = None, phase: str | None = None, status: str | None = None
    ) -> bytes:
        """Return a tar of the uploads that match, with `manifest.json` as its last member."""
        query = {"team": team, "phase": phase, "status": status}
        return self._transport.get(
            "/organizer/submissions/archive", query, max_bytes=MAX_ARCHIVE_BYTES
        ).content

    def tokens(self, team_id: str) -> list[Record]:
        """Return a team's tokens, without their secrets."""
        return self._transport.records(_organizer_path("teams", team_id, "tokens"))

    def issue_token(self, team_id: str, name: str, expires_at: str | None = None) -> Record:
        """Issue a token; its text is under `token`, and is shown this once."""
        return self._do("teams", team_id, "tokens", name=name, expires_at=expires_at)

    def revoke_token(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return self._do("tokens", token_id, "revoke")

    def splits(self) -> list[Record]:
        """Return the registered split revisions."""
        return self._transport.records("/organizer/splits")

    def create_phase(self, phase: Mapping[str, Any]) -> Record:
        """Make a phase: `id`, `challenge`, `title`, `split`, `protocol` and what may be set.

        What is left out has its default, which a withheld split makes stricter; None is no limit.
        """
        return self._transport.post_once("/organizer/phases", phase, with_none=True)

    def phase(self, phase_id: str) -> Record:
        """Return a phase: its settings and where it stands."""
        return self._transport.record(f"/phases/{quoted(phase_id)}")

    def change_phase(self, phase_id: str, changes: Mapping[str, Any]) -> Record:
        """Change settings of a phase; what is left out stays, None takes a limit or date away."""
        return self._transport.patch(_organizer_path("phases", phase_id), changes)

    def similar(self, phase_id: str) -> SimilarityReport:
        """Return which submissions of a phase are alike, and which teams may be probing."""
        answer = self._transport.get(_organizer_path("phases", phase_id, "similar"))
        return read_answer(SimilarityReport.read, answer)

    def site(self) -> Record:
        """Return the links of the site."""
        return self._transport.record("/site")

    def set_site(self, links: Record) -> Record:
        """Set links of the site; what is left out stays, an empty one is not shown."""
        return self._transport.patch("/organizer/site", links)

    def feature_phase(self, phase_id: str, reason: str) -> Record:
        """Put a phase before all others: in lists, and on the front page."""
        return self._do("phases", phase_id, "feature", reason=reason)

    def delete_phase(self, phase_id: str, reason: str) -> Record:
        """Delete a phase in which nothing was submitted or rescored."""
        return self._do("phases", phase_id, "delete", reason=reason)

    def export_phase(self, phase_id: str) -> bytes:
        """Return what readers may see of a phase as a tar; its `README.md` says what each file is."""
        return self._transport.get(
            _organizer_path("phases", phase_id, "export"), max_bytes=MAX_ARCHIVE_BYTES
        ).content

    def reported_boards(self, phase_id: str) -> list[Record]:
        """Return the external boards beside a phase, withdrawn ones too, newest first."""
        return self._transport.records(_organizer_path("phases", phase_id, "reported"))

    def import_reported(self, phase_id: str, file: str, title: str, cite: str) -> Record:
        """Put the rows of another board beside a phase, unranked: all of them, or none."""
        return self._do("phases", phase_id, "reported", title=title, cite=cite, file=file)

    def withdraw_reported(self, phase_id: str, reported_id: str, reason: str) -> Record:
        """Take the rows of another board away from a phase."""
        return self._do("phases", phase_id, "reported", reported_id, "withdraw", reason=reason)

    def freeze_phase(self, phase_id: str, reason: str) -> Record:
        """Freeze the public board now; scoring goes on."""
        return self._do("phases", phase_id, "freeze", reason=reason)

    def reveal_phase(self, phase_id: str, what: str, reason: str) -> Record:
        """Show the board behind a freeze, the names, or begin to score the revealed part."""
        return self._do("phases", phase_id, "reveal", what=what, reason=reason)

    def protocols(self) -> list[Record]:
        """Return all protocols, drafts too, oldest first."""
        return self._transport.records("/organizer/protocols")

    def delete_protocol(self, version: str, reason: str) -> Record:
        """Delete a protocol that nothing was made of."""
        return self._do("protocols", version, "delete", reason=reason)

    def add_protocol(self, toml: str) -> Record:
        """Add a protocol document; it is immutable from then on."""
        return self._transport.post_toml("/organizer/protocols", toml)

    def confirmations(self) -> list[Record]:
        """Return what organizers signed, newest first."""
        return self._transport.records("/organizer/confirmations")

    def confirm(self, confirmation: Record) -> Record:
        """Hand in what was signed: that a split may be scored under a protocol."""
        return self._transport.post_once("/organizer/confirmations", confirmation)

    def withdraw_confirmation(self, confirmation_id: str, reason: str) -> list[Record]:
        """Take a confirmation back; return those that stay."""
        path = _organizer_path("confirmations", confirmation_id, "withdraw")
        self._transport.post(path, lambda: {"json": {"reason": reason}}, False)
        return self.confirmations()

    def audit(
        self,
        limit: int = 100,
        *,
        actor: str | None = None,
        subject: str | None = None,
        since: str | None = None,
        action: str | None = None,
        before: int | None = None,
    ) -> list[Record]:
        """Return the newest lines of the audit log.

        At most 500 come at once: `before` is the id of a line, and asks for those that are older.
        `since` is a time such as `2027-01-31T00:00:00Z`, or a day.
        """
        query = {
            "limit": limit,
            "actor": actor,
            "subject": subject,
            "since": since,
            "action": action,
            "before": before,
        }
        return self._transport.records("/organizer/audit", query)

    def verify_audit(self, head: str | None = None) -> Record:
        """Recompute the chain of the audit log; look for the head that was kept earlier."""
        return self._transport.record("/organizer/audit/verify", {"head": head})


class Rescoring:
    """Protocol updates: speaks to `/organizer/rescoring` of one server; each step needs a reason.

    Args:
        transport: Of an `Organizer`.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def check_protocol(self, toml: str, phase: str | None = None) -> Record:
        """Validate a protocol document and return what it changes; nothing is kept."""
        return self._transport.post_toml("/organizer/protocols/check", toml, {"phase": phase})

    def runs(self, phase: str | None = None) -> tuple[RunView, ...]:
        """Return runs, newest first."""
        answer = self._transport.get("/organizer/rescoring", {"phase": phase})
        return read_answer(RunView.read_all, answer)

    def run(self, run_id: str) -> RunView:
        """Return one run."""
        return self._get(RunView, run_id)

    def draft(
        self, phase: str, protocol: str | None, split_revision: str | None, reason: str
    ) -> RunView:
        """Draft a run to a protocol, a split revision, or both."""
        wanted = {"protocol": protocol, "split_revision": split_revision}
        return self._do(RunView, phase=phase, **wanted, reason=reason)

    def step(self, run_id: str, step: str, reason: str, **more: str) -> RunView:
        """Take a step: start, pause, resume, apply, cancel, rollback or close."""
        return self._do(RunView, run_id, step, reason=reason, **more)

    def preview(self, run_id: str, seen: str | None = None) -> PreviewView:
        """Return the comparison that the next flip would make true."""
        return self._get(PreviewView, run_id, "preview", seen=seen)

    def preview_csv(self, run_id: str) -> str:
        """Return the comparison as CSV."""
        return self._transport.get(_organizer_path("rescoring", run_id, "preview.csv")).text

    def start_verification(self, phase: str, sample: int | None, reason: str) -> VerificationView:
        """Ask for sheets to be recomputed from their uploads."""
        return self._do(
            VerificationView, "verifications", phase=phase, sample=sample, reason=reason
        )

    def verification(self, verification_id: str) -> VerificationView:
        """Return what a verification has come to."""
        return self._get(VerificationView, "verifications", verification_id)

    def _get(self, kind: type[_Read], *where: str, **query: str | None) -> _Read:
        return read_answer(
            kind.read, self._transport.get(_organizer_path("rescoring", *where), query)
        )

    def _do(self, kind: type[_Read], *where: str, **said: Any) -> _Read:
        path = _organizer_path("rescoring", *where)
        return read_answer(kind.read, self._transport.post(path, lambda: {"json": said}, False))
