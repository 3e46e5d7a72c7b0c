"""The whole history of one submission, for the organizers' page and for a committee."""

from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime

from fastapi.responses import Response
from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.audit.log import audit, audit_page
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.notifications.inbox import notices_about
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.verification import rechecks_of
from exceptiondrive_records.submissions.edits import edits_of
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.jobs import jobs_of
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.notifications import NotificationView
from exceptiondrive_schemas.api.rescoring import VerifyItemView
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import SubmissionEditView
from exceptiondrive_schemas.receipt import Receipt
from exceptiondrive_schemas.score_sheet import metric_text
from exceptiondrive_server.audit.queries import AuditLineView, line_view
from exceptiondrive_server.boards.entry_facts import primary_metrics
from exceptiondrive_server.submissions.download import (
    read_upload,
    suffix_of,
    tar_answer,
    tar_stream,
)
from exceptiondrive_server.submissions.queries import ScoreTables, score_tables
from exceptiondrive_server.submissions.receipts_api import statement_of
from exceptiondrive_server.web.numbers import minute
from exceptiondrive_server.web.services import Services
from exceptiondrive_server.web.static_files import STATIC
from exceptiondrive_server.web.templating import render

MOST_LINES = 2000
"""Of the audit log; a submission has a few dozen."""


class JobView(BaseModel):
    """One scoring of the submission, under one protocol and split revision."""

    protocol: str
    split_revision: str
    lane: Lane | None
    is_first: bool
    """Whether it made the first score; else it is one of a rescoring run, in the background."""
    state: WorkState
    attempts: int
    created_at: datetime
    finished_at: datetime | None
    score: str = ""
    """What it came to, as a board would show it; empty: no sheet was made."""


class SubmissionStory(BaseModel):
    """A submission, and everything that the records say of it; newest first in each list but jobs."""

    submission: SubmissionView
    team: str
    """Id of its team."""
    jobs: tuple[JobView, ...]
    recomputed: tuple[VerifyItemView, ...]
    """Each time its score was made again from the upload: `equal` is bit for bit."""
    edits: tuple[SubmissionEditView, ...]
    notices: tuple[NotificationView, ...]
    """What its team was told of it."""
    audit: tuple[AuditLineView, ...]


def story_of(session: Session, submission_id: str) -> SubmissionStory:
    """Return the story of a submission.

    Raises:
        NotFound: There is no such submission.
    """
    found = find_submission(session, submission_id)
    return SubmissionStory(
        submission=view(session, found),
        team=session.get_one(Team, found.team_id).slug,
        jobs=tuple(
            JobView(
                protocol=find_protocol(session, job.protocol_digest).version,
                split_revision=job.split_revision,
                lane=job.lane,
                is_first=job.is_first,
                state=job.state,
                attempts=job.attempts,
                created_at=job.created_at,
                finished_at=job.finished_at,
                score=_score_of(session, found, job),
            )
            for job in jobs_of(session, submission_id)
        ),
        recomputed=rechecks_of(session, submission_id),
        edits=edits_of(session, submission_id),
        notices=tuple(notices_about(session, submission_id)),
        audit=tuple(map(line_view, audit_page(session, subject=submission_id, limit=MOST_LINES))),
    )


def _score_of(session: Session, submission: Submission, job: Job) -> str:
    """Say what a scoring came to: `HCC 10.56, UR 3.00`; nothing where no sheet was made."""
    key = (submission.id, job.protocol_digest, job.split_revision)
    row = session.get(ScoreSheetRow, key)
    if row is None:
        return ""
    protocol = find_protocol(session, job.protocol_digest)
    values = row.sheet.average(protocol.grading.headline)
    return ", ".join(
        f"{metric.label} {metric_text(metric, values.get(metric.key), protocol.publication)}"
        for metric in primary_metrics(CHALLENGES[row.sheet.challenge])
    )


def story_folder(services: Services, principal: Principal, submission_id: str) -> Response:
    """Return the story as a tar: the upload, the receipt, the story itself twice, and a README.

    Raises:
        NotFound: There is no such submission.
    """
    story, receipt, sheet = _story_and_receipt(services, submission_id)
    with services.database.write() as session:
        audit(session, principal.actor, "story downloaded", submission_id)
    data, missing = read_upload(services, story.submission)
    style = (STATIC / "story.css").read_text("utf-8")
    page = _page(story, receipt, sheet, missing=missing, style=style)
    folder = f"submission-{submission_id}"
    files = _files(story, receipt, page, data, missing or "")
    members = ((f"{folder}/{name}", content) for name, content in files)
    return tar_answer(tar_stream(members), f"{folder}.tar")


def story_page(services: Services, submission_id: str) -> str:
    """Return the story as one page to read and to print.

    Raises:
        NotFound: There is no such submission.
    """
    return _page(*_story_and_receipt(services, submission_id))


def _page(
    story: SubmissionStory,
    receipt: Receipt | None,
    sheet: ScoreTables,
    *,
    missing: str | None = None,
    style: str | None = None,
) -> str:
    """Return the story as HTML that stands alone; without `style` it takes the site's own sheet."""
    return render(
        "submissions/story.html",
        one=story.submission,
        story=story,
        receipt=receipt,
        sheet=sheet,
        at=datetime.now(UTC),
        missing=missing,
        style=style,
    )


def _story_and_receipt(
    services: Services, submission_id: str
) -> tuple[SubmissionStory, Receipt | None, ScoreTables]:
    statement = None
    with services.database.read() as session:
        story = story_of(session, submission_id)
        with suppress(NotFound):  # no score is shown
            statement = statement_of(session, find_submission(session, submission_id))
        sheet = score_tables(session, story.submission)
    return story, None if statement is None else services.signer.sign(statement), sheet


def _files(
    story: SubmissionStory, receipt: Receipt | None, page: str, data: bytes | None, missing: str
) -> Iterator[tuple[str, bytes]]:
    upload = f"upload{suffix_of(data or b'')}"
    yield "README.md", _readme(story, receipt, upload, missing).encode()
    yield "story.html", page.encode()
    yield "story.json", story.model_dump_json(indent=2, by_alias=True).encode()
    if receipt is not None:
        yield "receipt.json", receipt.model_dump_json(indent=2, by_alias=True).encode()
    if data is not None:
        yield upload, data


def _readme(story: SubmissionStory, receipt: Receipt | None, upload: str, missing: str) -> str:
    one = story.submission
    n_equal = sum(item.state == "equal" for item in story.recomputed)
    signed = "There is no receipt: no score is shown under the protocol of its phase."
    if receipt is not None:
        signed = (
            "`receipt.json`: the score as the server signed it; `exceptiondrive receipt verify "
            "receipt.json` checks it."
        )
    return f"""# {one.method} of {one.team}

Submission `{one.id}` to the phase `{one.phase}`, received {minute(one.received_at)}: {one.status.value}.

- `{upload}`: {missing or "the bytes that the team sent"} ({one.size_bytes} bytes, `{one.file_digest}`).
- {signed}
- `story.html`: all of it to read, and to print as a PDF.
- `story.json`: all that the records say, newest first.
  - `submission`: as its team sees it, with score sheet, rank, and faults of the file.
  - `jobs`: each scoring under one protocol and split revision ({len(story.jobs)}).
  - `recomputed`: each time the score was made again from the upload ({len(story.recomputed)},
    {n_equal} equal bit for bit).
  - `edits`: what the team changed of its words about the method ({len(story.edits)}).
  - `notices`: what the team was told of it ({len(story.notices)}).
  - `audit`: its lines of the audit log ({len(story.audit)}), each with the hash that chains it;
    `exceptiondrive organizer audit verify` recomputes the chain.

It holds what organizers may see: no region of a withheld split, and no value of a sample.
"""
