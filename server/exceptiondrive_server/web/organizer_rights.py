"""Which organizer may use which route: one table for the API and for pages.

Reading needs the role read-only, changing anything the role owner, except for the actions of helpers
below. A route whose path names a phase, a run, a submission, news, a question or an entry's
disqualification is a phase's, unless it moves other phases, too; so are lists that are narrowed to a
phase. A role that is confined to that phase counts there. Every other route is the whole site's.
"""

from collections.abc import Mapping

from fastapi import Request
from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.db.errors import NotAllowed
from exceptiondrive_records.news.tables import News, Question
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.middleware import route_of
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.services import Services

_READING = frozenset({"/protocols/check"})
"""What is sent by POST and changes nothing."""
HELPER_ACTIONS = frozenset(
    {
        "/submissions/{submission_id}/note",
        "/submissions/{submission_id}/retry",
        "/submissions/{submission_id}/verify",
        "/teams/{team_id}/approve",
        "/teams/{team_id}/refuse",
    }
)
"""What a helper may do: none lets anybody act for a team, or moves a score or a board."""
_OF_THE_SITE = frozenset({"/phases/{phase_id}/feature"})
"""Paths that name a phase and move all others."""
_NARROWED = frozenset({"/news", "/questions", "/submissions", "/submissions/archive"})
"""Lists that hold what is of the phase `?phase=` alone."""


_Owned = RescoringRun | Submission | News | Question
_OWNED: Mapping[str, type[_Owned]] = {
    "run_id": RescoringRun,
    "submission_id": Submission,
    "news_id": News,
    "question_id": Question,
}
"""Parameters of paths that name what belongs to one phase."""


def role_needed(method: str, path: str) -> OrganizerRole:
    """Return the role that a route asks for; its path is that of the tables."""
    if method in ("GET", "HEAD") or path in _READING:
        return OrganizerRole.READ_ONLY
    return OrganizerRole.HELPER if path in HELPER_ACTIONS else OrganizerRole.OWNER


def require_right(request: Request, services: Services, principal: Principal) -> None:
    """Refuse what an organizer may not do.

    Raises:
        ApiProblem: Whoever asks is no organizer, or has too small a role for this, or one that is
            confined to other phases.
    """
    role = principal.role
    if role is None:
        detail = "This is for organizers."
        if principal.person_id is None:
            detail += f" It needs a token with the scope {Scope.ORGANIZE.value!r}."
        elif principal.team_id is not None:
            detail += (
                " You are acting for a team: first choose to act as an organizer on the page Team."
            )
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    needed = role_needed(request.method, _path_of(request))
    if not role.includes(needed):
        detail = f"This needs an organizer with the role {needed}; yours is {role}."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    if principal.is_organizer:
        return
    with services.database.read() as session:
        phase_id = _phase_of(session, request)
    if not principal.organizes(phase_id):
        confined = ", ".join(sorted(principal.phases))
        detail = (  # the same words of what is not there
            f"Your role is confined to {confined}; this is for organizers of the phase that it "
            "belongs to, if any, or of the whole site."
        )
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)


def what_lacks(request: Request, principal: Principal) -> str | None:
    """Say why an organizer who may see a page may not send its form; None: they may."""
    needed = role_needed("POST", _path_of(request))
    role = principal.role
    if role is not None and role.includes(needed):
        return None
    return f"This needs an organizer with the role {needed}; yours is {role}."


def may_change(principal: Principal, path: str, phase_id: str | None = None) -> bool:
    """Whether an organizer may send the form of a page; what they may not is not offered.

    The path is that of the route, with the names of its parameters; `phase_id` is the phase that it
    names, if any.
    """
    role, path = principal.role, _as_in_tables(path)
    is_theirs = principal.organizes(None if path in _OF_THE_SITE else phase_id)
    return role is not None and role.includes(role_needed("POST", path)) and is_theirs


def require_order_right(principal: Principal, change: PhaseChange) -> None:
    """Refuse a change of where a phase stands among all, to who organizes some of them.

    Raises:
        NotAllowed: It is one, and the role is confined to phases.
    """
    if "position" in change.model_fields_set and not principal.is_organizer:
        raise NotAllowed("Only organizers of the whole site can change the order of phases.")


def _as_in_tables(path: str) -> str:
    """Return a path without the prefix of API or pages: an action is the same in both."""
    return path.removeprefix("/api/v1/organizer").removeprefix("/organize")


def _path_of(request: Request) -> str:
    """Return the path of the route, as in the tables; a parameter that names the action stands for it."""
    path = _as_in_tables(route_of(request.scope))
    for name in ("action", "step"):
        path = path.replace(f"{{{name}}}", str(request.path_params.get(name)))
    return path


def _phase_of(session: Session, request: Request) -> str | None:
    """Return the phase that a request belongs to; None: to the whole site."""
    path, named = _path_of(request), request.path_params
    if path in _OF_THE_SITE:
        return None
    if path in _NARROWED:
        return request.query_params.get("phase")
    if "phase_id" in named:
        return str(named["phase_id"])
    for name, table in _OWNED.items():
        if name in named:
            return session.scalar(select(table.phase_id).where(table.id == named[name]))
    number = str(named.get("disqualification_id", ""))
    if number.isdecimal() and int(number) < 2**31:  # else there is none, as the route says
        row = session.get(Disqualification, int(number))
        return None if row is None or row.submission_id is None else row.phase_id
    return None
