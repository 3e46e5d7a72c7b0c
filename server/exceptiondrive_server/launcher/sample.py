"""Fills a new site: phases on the sample split, and files submitted with the real client."""

import os
import subprocess
import time
from pathlib import Path

from pydantic import TypeAdapter
from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import issue_token, verify_token
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.operations.site import say_preparing
from exceptiondrive_records.phases.phases import create_phase, find_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team, find_team
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, ChallengeId
from exceptiondrive_schemas.protocol import NEWEST, packaged_protocol_toml
from exceptiondrive_server.launcher.child import LaunchError, Say, run_step
from exceptiondrive_server.launcher.layout import Layout, find_command, worker_environment

SPLIT = "sample"
ACTOR = "operator:sample"
_AT_ONCE = 2


class Planner(Document):
    """One line of `planners.json`: a file, and the method that wrote it.

    `without_reminder` is the method of the same agent without reminder, submitted before it.
    """

    file: str
    challenge: ChallengeId = PLANNING.id
    method: str
    description: str = ""
    without_reminder: str = ""

    @property
    def phase(self) -> str:
        """Id of the phase that it is submitted to."""
        return PHASES[self.challenge].id


def _phase(challenge: ChallengeId, phase_id: str, title: str, description: str) -> NewPhase:
    return NewPhase(
        id=phase_id,
        challenge=challenge,
        title=title,
        description=description,
        split=SPLIT,
        protocol=NEWEST,
        quota_per_day=200,
        rejected_per_day=500,
        shows_reported=True,
    )


PHASES = {
    PLANNING.id: _phase(
        PLANNING.id,
        "sample",
        "Development",
        "Synthetic samples whose regions are public: try your files here. "
        "`exceptiondrive evaluate` gives the same scores on your machine.",
    ),
    STRATEGY.id: _phase(
        STRATEGY.id,
        "sample-strategy",
        "Strategy development",
        "The same synthetic samples for agents that answer A to E, with or without a reminder. "
        "Link two submissions with `--without-reminder`, and the board shows the effect.",
    ),
}
TEAM, TEAM_NAME = "exceptiondrive-baselines", "ExceptionDrive baselines"
TOKEN_FILE = "sample-token"


def seed_sample(database: Database, layout: Layout) -> None:
    """Make protocol, phases, the team and its token file, so far as they are missing.

    Raises:
        NotFound: The sample split is not registered yet.
    """
    with database.write() as session:
        add_protocol(session, packaged_protocol_toml(NEWEST), ACTOR)
        for phase in PHASES.values():
            _make_phase(session, phase)
        _make_team(session, layout.data / TOKEN_FILE)


def fill_sample(database: Database, layout: Layout, server_url: str, say: Say) -> None:
    """Register the sample split, seed, and submit every planner that is not on the records yet.

    Raises:
        LaunchError: A step failed; its own words are part of the text.
    """
    try:
        _fill(database, layout, server_url, say)
    finally:
        tell_page(database, "")


def _fill(database: Database, layout: Layout, server_url: str, say: Say) -> None:
    def tell(doing: str) -> None:
        say(f"sample: {doing}")
        tell_page(database, doing)

    worker = find_command("exceptiondrive-worker")
    environment = worker_environment(layout, {**os.environ, **layout.environment(os.environ)})
    tell("making its scenes and their hazards")
    run_step([worker, "seed-sample"], environment)
    seed_sample(database, layout)
    listing = layout.planners / "planners.json"
    if not listing.exists():
        layout.planners.mkdir(parents=True, exist_ok=True)
        tell("making the files of the synthetic planners")
        run_step([worker, "make-planners", str(layout.planners)], environment)
    planners = TypeAdapter(tuple[Planner, ...]).validate_json(listing.read_bytes())
    missing = [it for it in planners if _submission_of(database, it, it.method) is None]
    if missing:
        tell(f"{len(missing)} synthetic planners are submitted and scored")
        _submit_all(database, missing, layout, server_url, say)


def tell_page(database: Database, doing: str) -> None:
    """Show on the page what is being prepared, until the first board is there; an empty text ends it."""
    with database.write() as session:
        say_preparing(session, f"The sample is being made: {doing}." if doing else "")


def _make_phase(session: Session, phase: NewPhase) -> None:
    try:
        find_phase(session, phase.id)
    except NotFound:
        create_phase(session, phase, actor=ACTOR)


def _make_team(session: Session, token_file: Path) -> None:
    """Make the team that submits synthetic planners; its token lies in a 0600 file."""
    try:
        team = find_team(session, TEAM)
    except NotFound:
        team = create_team(session, TEAM, TEAM_NAME, actor=ACTOR)
    if token_file.exists():
        principal = verify_token(session, token_file.read_text().strip())
        if principal is not None and principal.team_id == team.id:
            return
    text, _ = issue_token(session, team.id, "sample planners", actor=ACTOR)
    write_secret(token_file, text)


def write_secret(path: Path, text: str) -> None:
    """Write a file that only its owner may read, from the first byte on."""
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(text + "\n")


def _submission_of(database: Database, planner: Planner, method: str) -> str | None:
    """Id of what the team submitted to the phase of a planner by a method, if it ended well."""
    ended_well = (SubmissionStatus.SCORED, SubmissionStatus.WITHDRAWN)
    with database.read() as session:
        query = (
            select(Submission.id)
            .join(Team, Team.id == Submission.team_id)
            .where(
                Team.slug == TEAM,
                Submission.phase_id == planner.phase,
                Submission.method == method,
                Submission.status.in_(ended_well),
            )
        )
        return session.scalars(query).first()


def _submit_all(
    database: Database, planners: list[Planner], layout: Layout, server_url: str, say: Say
) -> None:
    waiting = sorted(planners, key=lambda planner: planner.without_reminder != "")
    running: dict[str, subprocess.Popen[str]] = {}
    n_done = 0
    while waiting or running:
        while waiting and len(running) < _AT_ONCE and waiting[0].without_reminder not in running:
            planner = waiting.pop(0)
            linked_to = None
            if planner.without_reminder:
                linked_to = _submission_of(database, planner, planner.without_reminder)
            running[planner.method] = _submit(planner, layout, server_url, linked_to)
        for method, process in list(running.items()):
            if process.poll() is None:
                continue
            del running[method]
            n_done += 1
            _, errors = process.communicate()
            if process.returncode != 0:
                raise LaunchError(f"submitting {method} failed:\n{errors}")
            say(f"sample: {n_done} of {len(planners)} scored ({method})")
        time.sleep(0.05)


def _submit(
    planner: Planner, layout: Layout, server_url: str, linked_to: str | None
) -> subprocess.Popen[str]:
    command = [
        find_command("exceptiondrive"),
        *("submit", str(layout.planners / planner.file)),
        *("--phase", planner.phase, "--method", planner.method, "--wait"),
    ]
    if planner.description:
        command += ["--description", planner.description]
    if linked_to:
        command += ["--without-reminder", linked_to]
    environment = {
        **os.environ,
        "EXCEPTIONDRIVE_SERVER": server_url,
        "EXCEPTIONDRIVE_TOKEN": (layout.data / TOKEN_FILE).read_text().strip(),
    }
    return subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
